"""An evaluator returns the same scores as `evaluate`, call after call."""

import gzip
import io
import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reverie_eval as rv
from reverie_eval.ground_truth import DEMO_BUNDLES
from reverie_eval.submissions import Submission
from reverie_eval.submissions._fast import convert_official
from tests.conftest import SAMPLES
from tests.support.forms import FORMS, Form

SPLIT = "val_unseen"
HEAVY = (
    "fastapi",
    "httpx",
    "matplotlib",
    "pandas",
    "pydantic",
    "rich",
    "scipy",
    "shapely",
    "sqlalchemy",
)
SAMPLE_FILES = [SAMPLES / f"{name}.json" for name in ("good", "mediocre", "drawn")]
Record = Mapping[str, Any]
Number = Callable[[float], object]

every_sample = pytest.mark.parametrize("sample", SAMPLE_FILES, ids=lambda file: file.stem)


@pytest.fixture(scope="module")
def evaluator() -> rv.Evaluator:
    """Create the evaluator for all calls of this module."""
    return rv.Evaluator(split=SPLIT)


def values_of(scores: rv.Scores) -> dict[str, list[float]]:
    """Return the value of every metric and episode."""
    return {key: column.tolist() for key, column in scores.episodes.items()}


# The same scores as `evaluate`.


@every_sample
@pytest.mark.parametrize(
    "give",
    [
        pytest.param(lambda file: file, id="path"),
        pytest.param(str, id="path as text"),
        pytest.param(Path.read_bytes, id="bytes"),
        pytest.param(lambda file: gzip.compress(file.read_bytes()), id="gzip"),
        pytest.param(lambda file: io.BytesIO(file.read_bytes()), id="open file"),
        pytest.param(lambda file: json.loads(file.read_bytes()), id="list of records"),
        pytest.param(lambda file: tuple(json.loads(file.read_bytes())), id="tuple of records"),
        pytest.param(
            lambda file: {each["instr_id"]: each for each in json.loads(file.read_bytes())},
            id="records by id",
        ),
    ],
)
def test_every_sample_in_every_file_format(
    sample: Path, give: Callable[[Path], Submission], evaluator: rv.Evaluator
) -> None:
    scores = evaluator(give(sample))
    expected = rv.evaluate(sample, split=SPLIT)
    assert values_of(scores) == values_of(expected)
    assert scores.signature == expected.signature


@pytest.mark.parametrize("form", FORMS.values(), ids=list(FORMS))
def test_the_form_of_every_codebase(form: Form, evaluator: rv.Evaluator) -> None:
    expected = rv.evaluate(form.bytes(), split=SPLIT)
    for submission in (form.bytes(), form.write()):
        scores = evaluator(submission)
        assert values_of(scores) == values_of(expected)
        assert scores.notes == expected.notes


def with_numbers(record: Record, number: Number, pose: Callable[..., object]) -> Record:
    """Return a record with other types of angles and poses."""
    trajectory = [
        pose([viewpoint, number(heading), number(elevation)])
        for viewpoint, heading, elevation in record["trajectory"]
    ]
    return {**record, "trajectory": trajectory}


@pytest.mark.parametrize("pose", [list, tuple])
@pytest.mark.parametrize("number", [float, int, np.float64, np.float32])
def test_records_as_agents_have_them(
    number: Number, pose: Callable[..., object], evaluator: rv.Evaluator
) -> None:
    """Poses in lists or tuples, angles of any number type: the scores are the same."""
    records = json.loads((SAMPLES / "good.json").read_bytes())
    given = [with_numbers(record, number, pose) for record in records]
    file = json.dumps(given, default=float).encode()
    assert convert_official(given) is not None
    assert values_of(evaluator(given)) == values_of(rv.evaluate(file, split=SPLIT))


@pytest.mark.parametrize("protocol", [*rv.PROTOCOLS, "hamt"])
def test_every_protocol(protocol: str) -> None:
    evaluator = rv.Evaluator(split=SPLIT, protocol=protocol)
    scores = evaluator(SAMPLES / "good.json")
    expected = rv.evaluate(SAMPLES / "good.json", split=SPLIT, protocol=protocol)
    assert evaluator.protocol == expected.protocol
    assert (values_of(scores), scores.signature) == (values_of(expected), expected.signature)


@pytest.mark.dataset
@pytest.mark.parametrize("name", ["shortest", "walk", "mixed1", "mixed2"])
@pytest.mark.parametrize("split", ["val_seen", "val_unseen"])
def test_the_published_splits(
    split: str, name: str, published: Path, published_bundles: Path
) -> None:
    file = published / "reference" / "submissions" / f"{split}.{name}.json.gz"
    records = json.loads(gzip.decompress(file.read_bytes()))
    evaluator = rv.Evaluator(split=split, ground_truth=published_bundles)
    expected = values_of(rv.evaluate(file, split=split, ground_truth=published_bundles))
    assert values_of(evaluator(file)) == values_of(evaluator(records)) == expected


# What it takes.

LOADED = f"""
import sys
import reverie_eval as rv
assert rv.Evaluator(split="{SPLIT}")({str(SAMPLES / "good.json")!r}).to_dict()
print([name for name in {HEAVY} if name in sys.modules])
"""


def test_importing_and_calling_loads_nothing_heavy() -> None:
    """Packages for figures, tables and the server are imported only when they are used."""
    assert subprocess.check_output([sys.executable, "-c", LOADED], text=True) == "[]\n"


# One call after another.


def test_an_evaluator_shows_what_its_scores_depend_on() -> None:
    few = rv.Evaluator(split=SPLIT, track="grounding", subset=["1196_0_0"])
    assert repr(few) == f"<Evaluator {few(SAMPLES / 'good.json').signature}>"
    assert "|track:grounding|subset:" in repr(few)


def test_a_misspelt_metric_is_answered_with_a_suggestion(evaluator: rv.Evaluator) -> None:
    scores = evaluator(SAMPLES / "good.json")
    with pytest.raises(KeyError, match="no metric has the key 'SR'; did you mean success"):
        scores["SR"]  # what a table calls it
    with pytest.raises(KeyError, match="no metric has the key 'rgspll'; did you mean rgspl"):
        scores["rgspll"]


def test_calls_are_independent(evaluator: rv.Evaluator) -> None:
    good, mediocre = SAMPLE_FILES[:2]
    first = evaluator(good)
    before = values_of(first)
    evaluator(mediocre)
    assert values_of(first) == before == values_of(evaluator(good))


def test_calls_do_not_change_the_records(evaluator: rv.Evaluator) -> None:
    content = (SAMPLES / "good.json").read_bytes()
    records = json.loads(content)
    evaluator(records)
    assert records == json.loads(content)


def test_the_ground_truth_is_read_once(tmp_path: Path) -> None:
    bundle = tmp_path / f"{SPLIT}.npz"
    bundle.write_bytes((DEMO_BUNDLES / bundle.name).read_bytes())
    evaluator = rv.Evaluator(split=SPLIT, ground_truth=bundle)
    bundle.unlink()
    scores = evaluator(SAMPLES / "good.json")
    assert scores.ground_truth is evaluator.ground_truth
    assert scores.ground_truth.origin == str(bundle)


# What is wrong is said, as by `evaluate`.


@pytest.mark.parametrize("angle", [np.nan, np.inf, -np.inf, np.float32("nan"), np.float64("inf")])
@pytest.mark.parametrize("place", [1, 2], ids=["heading", "elevation"])
def test_an_invalid_angle(angle: float, place: int, evaluator: rv.Evaluator) -> None:
    """In the middle of a trajectory, where no metric uses it."""
    records = json.loads((SAMPLES / "good.json").read_bytes())
    records[5]["trajectory"][1][place] = angle
    with pytest.raises(rv.SubmissionError) as rejected:
        evaluator(records)
    (problem,) = rejected.value.problems
    assert (problem.code, problem.where) == ("not-finite", "[5].trajectory[1]")
    assert "heading and elevation are finite numbers of radians" in problem.message


def test_an_invalid_submission_raises_what_evaluate_raises(evaluator: rv.Evaluator) -> None:
    broken = SAMPLES / "broken.json"
    with pytest.raises(rv.SubmissionError) as expected:
        rv.evaluate(broken, split=SPLIT)
    for submission in (broken, json.loads(broken.read_bytes())):
        with pytest.raises(rv.SubmissionError) as rejected:
            evaluator(submission)
        assert rejected.value.problems == expected.value.problems


def test_an_evaluator_still_works_after_a_rejection(evaluator: rv.Evaluator) -> None:
    with pytest.raises(rv.SubmissionError):
        evaluator([])
    assert evaluator(SAMPLES / "good.json")["success"] > 0


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        pytest.param({"split": SPLIT, "protocol": "mine"}, rv.ProtocolError, "mine", id="protocol"),
        pytest.param({"split": "train2"}, rv.GroundTruthError, "train2", id="split"),
        pytest.param(
            {"split": "test", "ground_truth": DEMO_BUNDLES / "test.public.npz"},
            rv.GroundTruthError,
            "solution",
            id="public bundle",
        ),
    ],
)
def test_unusable_settings_are_refused_before_the_first_call(
    options: Mapping[str, Any], error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        rv.Evaluator(**options)
