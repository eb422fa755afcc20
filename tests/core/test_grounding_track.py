"""The grounding track, wherever submissions are read: checked, compared, reported, scored often."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import reverie_eval as rv
from reverie_eval import GroundTruth, GroundTruthError, ProtocolError, SubmissionError
from reverie_eval.ground_truth import DEMO_BUNDLES, Bundle
from reverie_eval.reporting import report_html
from tests.conftest import SAMPLES
from tests.support.flat_world import Run, words
from tests.support.worlds import SPLIT

GROUNDING = ("--split", SPLIT, "--track", "grounding")
GOOD, MEDIOCRE = (str(SAMPLES / f"{name}.json") for name in ("good", "mediocre"))


def answers_of(file: str) -> list[dict[str, Any]]:
    """Return a submission without its trajectories."""
    records = json.loads(Path(file).read_bytes())
    return [{key: record[key] for key in ("instr_id", "predObjId")} for record in records]


@pytest.fixture
def answers(tmp_path: Path) -> list[str]:
    """Write two submissions without trajectories."""
    files = []
    for file in (GOOD, MEDIOCRE):
        files.append(str(tmp_path / Path(file).name))
        Path(files[-1]).write_text(json.dumps(answers_of(file)))
    return files


def shifted(records: list[dict[str, Any]]) -> None:
    for record in records:
        record["trajectory"] = [["nowhere", 400.0, 0.0]]


def doubled(records: list[dict[str, Any]]) -> None:
    records += [dict(records[0]), {**records[1], "predObjId": 3}]


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda _: None, id="as it is"),
        pytest.param(shifted, id="trajectories that are ignored"),
        pytest.param(doubled, id="records that are there twice"),
        pytest.param(list.pop, id="a missing record"),
    ],
)
def test_a_file_says_what_its_records_say(change: Callable[[Any], object]) -> None:
    """A file in the official form is decoded; Python objects are read value by value."""
    records = json.loads(Path(MEDIOCRE).read_bytes())
    change(records)
    outcomes: list[object] = []
    for given in (json.dumps(records).encode(), records):
        try:
            outcomes.append(rv.evaluate(given, split=SPLIT, track="grounding").to_report())
        except SubmissionError as error:
            outcomes.append(error.problems)
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize(
    "prepare",
    [
        pytest.param(Bundle.public, id="public bundle"),
        pytest.param(lambda bundle: bundle, id="with the solution"),
    ],
)
def test_answers_alone_are_valid(prepare: Callable[[Bundle], Bundle]) -> None:
    truth = GroundTruth.from_bundle(prepare(Bundle.load(DEMO_BUNDLES / f"{SPLIT}.npz")))
    given = answers_of(GOOD)
    validation = rv.validate(given, split=SPLIT, ground_truth=truth, track="grounding")
    assert validation.notes == ["2 of 84 answers predict no object"]
    with pytest.raises(SubmissionError):
        rv.validate(given, split=SPLIT, ground_truth=truth)


def test_every_protocol_that_scores_grounding_scores_answers_alone(demo: GroundTruth) -> None:
    found = rv.evaluate_protocols(
        answers_of(GOOD), split=SPLIT, ground_truth=demo, track="grounding"
    )
    assert "r2r-style" not in found
    assert {name: dict(scores) for name, scores in found.items()} == {
        name: {"rgs": 55 / 84} for name in found
    }
    assert "official-v1" in found


def test_the_command_checks_answers_alone(answers: list[str], run: Run) -> None:
    assert run("validate", answers[0], *GROUNDING).status == 0
    assert run("validate", answers[0], "--split", SPLIT).status == 1


@pytest.mark.usefixtures("here")
def test_the_command_checks_them_with_a_public_bundle(run: Run) -> None:
    line = "validate submit.json {split} --ground-truth public.npz --track grounding"
    assert run(*words(line)).out.startswith("submit.json: valid")


def test_answers_alone_are_compared(answers: list[str], run: Run) -> None:
    """By hand: 55 of 84 answers are correct, and 34 of 84."""
    comparison = rv.compare(*answers, split=SPLIT, track="grounding")
    assert list(comparison["mediocre"]) == ["rgs"]
    assert comparison["mediocre"]["rgs"].mean == pytest.approx((34 - 55) / 84)
    status, out, _ = run("compare", *answers, *GROUNDING)
    assert status == 0
    assert "mediocre is worse than good by 25.00 RGS, " in out
    assert "|track:grounding|" in out


def test_the_report_on_answers_alone(answers: list[str], run: Run) -> None:
    status, page, _ = run("report", *answers, *GROUNDING)
    assert status == 0
    assert "55 of 84 answers from the goal (65.5\u00a0%) are correct." in page
    assert "mediocre is worse than good by 25.00 RGS" in page
    assert "No breakdown by jumps: this track ignores trajectories" in page
    assert "<summary>list all 32</summary>" in page
    for section in ("scores", "comparison", "strengths", "scans", "changes"):
        assert page.count(f'"#{section}"') == page.count(f'id="{section}"') == 1
    for section in ("outcomes", "distributions", "near-misses"):
        assert f'"#{section}"' not in page
        assert f'id="{section}"' not in page
    assert "SR" not in page.partition("<body>")[2]


def test_the_report_on_one_file_of_answers(answers: list[str], demo: GroundTruth) -> None:
    scores = rv.evaluate(answers[0], split=SPLIT, ground_truth=demo, track="grounding")
    assert "RGS %" in report_html({"good": scores})


def test_an_evaluator_of_answers_alone() -> None:
    evaluator = rv.Evaluator(split=SPLIT, track="grounding")
    scores = evaluator(answers_of(GOOD))
    assert dict(scores) == {"rgs": 55 / 84}
    assert "|track:grounding|" in scores.signature


def test_scores_of_answers_alone_in_parts() -> None:
    whole = rv.evaluate(answers_of(GOOD), split=SPLIT, track="grounding")
    rest, first = whole.subset(whole.instr_ids[7:]), whole.subset(whole.instr_ids[:7])
    assert first.headline == whole.headline
    again = rv.Scores.concatenate([first, rest])
    assert (dict(again), again.signature, again.headline) == (
        dict(whole),
        whole.signature,
        whole.headline,
    )


def test_unusable_tracks_are_refused_before_anything_is_scored() -> None:
    with pytest.raises(GroundTruthError, match="r2r-style does not score grounding"):
        rv.Evaluator(split=SPLIT, protocol="r2r-style", track="grounding")
    with pytest.raises(ProtocolError, match="unknown track 'ground'"):
        rv.Evaluator(split=SPLIT, track="ground")  # type: ignore[arg-type]
