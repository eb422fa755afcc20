"""Converting any form to the official one: the scores stay, and what is lost is reported."""

import gzip
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from jsonschema import Draft202012Validator

from reverie_eval import GroundTruth, Problem, SubmissionError, evaluate
from reverie_eval.submissions import convert, read_predictions, submission_schema
from reverie_eval.submissions._fast import read_fast
from reverie_eval.submissions._hints import UNNAMED_ANSWERS
from reverie_eval.tasks import find_task
from tests.conftest import SAMPLES
from tests.support import forms
from tests.support.both_readers import read_by_both
from tests.support.broken_files import broken
from tests.support.flat_world import Run
from tests.support.forms import FORMS, OFFICIAL, Form
from tests.support.worlds import SPLIT, Case, cases_with_boxes, ground_truth_by_hand, records_of

SCHEMA = Draft202012Validator(submission_schema())

every_form = pytest.mark.parametrize("form", FORMS.values(), ids=list(FORMS))


NAVIGATION_NOTE = f"{len(OFFICIAL)} records, none with an answer: navigation only"


def has_answers(form: Form) -> bool:
    """Whether a form has answers; a file without stays one that says nothing of objects."""
    return bool(form.answer(1))


BOX = [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    ("answer", "is_valid"),
    [
        pytest.param({"predObjId": 0}, True, id="an object"),
        pytest.param({"predObjId": -1}, True, id="no object"),
        pytest.param({"predBox": BOX}, True, id="a box"),
        pytest.param({"predObjId": -1, "predBox": BOX}, True, id="a box and no object"),
        pytest.param({"predObjId": 0, "predBox": None}, True, id="an object and no box"),
        pytest.param({"predObjId": 0, "predBox": BOX}, False, id="both"),
        pytest.param({"predBox": None}, False, id="no box alone"),
        pytest.param({}, False, id="no answer"),
        pytest.param({"predObjId": "7"}, False, id="text"),
    ],
)
def test_the_schema_allows_an_object_or_a_box(answer: dict[str, Any], *, is_valid: bool) -> None:
    record = {"instr_id": "1_7_0", "trajectory": [["hall", 0.0, 0.0]], **answer}
    assert Draft202012Validator(submission_schema()).is_valid([record]) is is_valid


@pytest.fixture
def result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the path of a result file in the working folder."""
    monkeypatch.chdir(tmp_path)
    return Path("result.json")


@every_form
def test_every_form_becomes_the_official_one(
    form: Form, result: Path, demo: GroundTruth, run: Run
) -> None:
    result.write_bytes(form.bytes())
    assert run("convert", "result.json", "-o", "submit.json")[:2] == (0, "")
    converted = Path("submit.json").read_bytes()
    assert read_fast(converted, demo.task, demo.graph.viewpoint_table) is not None
    scores, expected = (
        evaluate(file, split=SPLIT, ground_truth=demo).episodes for file in (converted, result)
    )
    assert {key: column.tolist() for key, column in scores.items()} == {
        key: column.tolist() for key, column in expected.items()
    }


@every_form
def test_the_notes_say_what_was_read_dropped_and_added(form: Form, result: Path, run: Run) -> None:
    result.write_bytes(form.bytes())
    has_angles = form.trajectory in (forms.poses, forms.with_zeros)
    count = sum(len(record["trajectory"]) for record in OFFICIAL)
    zeros = f"{count} poses without heading and elevation; both are written as 0"
    assert run("convert", "result.json", "-o", "submit.json").err.splitlines() == [
        *([f"result.json: read as: {'; '.join(form.read_as)}"] if form.read_as else []),
        *(f"result.json: dropped: {name}, in {len(OFFICIAL)} records" for name in form.dropped),
        *([f"result.json: {UNNAMED_ANSWERS}"] if form.dropped and not has_answers(form) else []),
        *([] if has_angles else [f"result.json: {zeros}"]),
    ]


@every_form
def test_a_converted_file_stays_as_it_is(form: Form, result: Path, run: Run) -> None:
    result.write_bytes(form.bytes())
    run("convert", "result.json", "-o", "once.json")
    again = run("convert", "once.json", "-o", "twice.json")
    assert again[:2] == (0, "")
    assert again.err == ("" if has_answers(form) else f"once.json: read as: {NAVIGATION_NOTE}\n")
    assert Path("twice.json").read_bytes() == Path("once.json").read_bytes()


@every_form
def test_a_converted_file_has_the_schema(form: Form) -> None:
    records = convert(form.bytes()).records
    assert SCHEMA.is_valid(records) == has_answers(form)
    assert [record["instr_id"] for record in records] == [record["instr_id"] for record in OFFICIAL]


@pytest.mark.parametrize(
    ("record", "expected"),
    [
        pytest.param(
            {"trajectory": [["a"], ["b", "c"], []], "pred_objid": "402"},
            {"trajectory": [["a", 0.0, 0.0], ["b", 0.0, 0.0], ["c", 0.0, 0.0]], "predObjId": 402},
            id="hops",
        ),
        pytest.param(
            {"trajectory": [["a", 1, -0.5, 7]], "predObjId": "None"},
            {"trajectory": [["a", 1.0, -0.5]], "predObjId": -1},
            id="three numbers",
        ),
        pytest.param(
            {"trajectory": ["a", ["b", 2, 1, 7]], "predObjId": 0},
            {"trajectory": [["a", 0.0, 0.0], ["b", 2.0, 1.0]], "predObjId": 0},
            id="numbers behind the angles",
        ),
        pytest.param(
            {"trajectory": [["a", 1e-9, 1e300]], "predObjId": "007"},
            {"trajectory": [["a", 1e-9, 1e300]], "predObjId": 7},
            id="all digits of angles, of ids none that mean nothing",
        ),
        pytest.param(
            {"trajectory": [["a"]], "predBox": (1, 2.5, np.int64(3), 4), "predView": np.int64(7)},
            {"trajectory": [["a", 0.0, 0.0]], "predBox": [1.0, 2.5, 3.0, 4.0], "predView": 7},
            id="box in a view",
        ),
        pytest.param(
            {"trajectory": [["a", 1, 0.5, 9]], "predBox": [-1, 0, 9, 9], "predView": None},
            {"trajectory": [["a", 1.0, 0.5]], "predBox": [-1.0, 0.0, 9.0, 9.0]},
            id="box by the camera, not cut",
        ),
        pytest.param(
            {
                "trajectory": ["a"],
                "pred_objid": "None",
                "predBox": [0.25, 0.25, 0.5, 0.5],
                "predView": 0,
                "predImageSize": (1, 1),
            },
            {
                "trajectory": [["a", 0.0, 0.0]],
                "predBox": [0.25, 0.25, 0.5, 0.5],
                "predView": 0,
                "predImageSize": [1.0, 1.0],
            },
            id="box of another size of picture, not scaled",
        ),
        pytest.param(
            {"trajectory": [["a", 1, 2]], "predBox": None, "predView": 7, "predImageSize": [1, 1]},
            {"trajectory": [["a", 1.0, 2.0]], "predObjId": -1},
            id="no box",
        ),
    ],
)
def test_a_converted_record(record: dict[str, Any], expected: dict[str, Any]) -> None:
    conversion = convert([{"instr_id": "reverie_7_1_0", **record}])
    assert conversion.records == [{"instr_id": "7_1_0", **expected}]
    content = json.dumps(conversion.records).encode()
    assert convert(content).records == conversion.records
    SCHEMA.validate(conversion.records)


@pytest.mark.parametrize("keyed", [False, True], ids=["list", "keyed"])
@settings(max_examples=20)
@given(case=cases_with_boxes)
def test_converted_boxes_score_the_same(case: Case, *, keyed: bool) -> None:
    """To the last digit, and every box has the same outcome."""
    truth, records = ground_truth_by_hand(case.world), records_of(case.predictions)
    original = {record["instr_id"]: record for record in records} if keyed else records
    converted = json.dumps(convert(original).records).encode()
    before, after = (evaluate(it, split=SPLIT, ground_truth=truth) for it in (original, converted))
    assert after.box_outcomes == before.box_outcomes
    assert {key: column.tolist() for key, column in after.episodes.items()} == {
        key: column.tolist() for key, column in before.episodes.items()
    }


def test_records_that_differ_in_what_is_dropped() -> None:
    records = [{**OFFICIAL[0], "a": 1}, {**OFFICIAL[1], "b": 1}, {**OFFICIAL[2], "a": 1, "b": 2}]
    assert convert(records).notes == [
        "dropped: a, in 2 records",
        "dropped: b, in 2 records",
    ]


@pytest.mark.parametrize("content", [b"[]", b"{}"], ids=["list", "keyed"])
def test_an_empty_file_is_converted_to_an_empty_one(content: bytes, result: Path, run: Run) -> None:
    """There is no split, so no episode can be missing."""
    result.write_bytes(content)
    status, out, err = run("convert", "result.json")
    assert (status, json.loads(out), err) == (0, [], "")


def test_ids_are_not_checked(result: Path, run: Run) -> None:
    """Ids of any split and any building are accepted."""
    records = [{"instr_id": "who?", "trajectory": [["nowhere", 0.5, 0.25]], "predObjId": 2**31 - 1}]
    result.write_text(json.dumps(records))
    assert json.loads(run("convert", "result.json").out) == records


def test_a_gzip_from_standard_input(monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    content = gzip.compress(FORMS["C HAMT"].bytes())
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(content)))
    status, out, err = run("convert", "-")
    assert (status, read_by_both(out.encode(), find_task("reverie"))) == (0, True)
    assert "object ids written as text" in err


def problems_of_reading(content: bytes) -> Sequence[object]:
    """Return the problems that reading finds in a file, in the order of reporting."""
    return SubmissionError(read_predictions(content).problems).problems


def test_the_broken_sample_is_rejected_with_its_reading_problems(result: Path, run: Run) -> None:
    content = (SAMPLES / "broken.json").read_bytes()
    with pytest.raises(SubmissionError) as rejected:
        convert(content)
    # A number for an id is found together with what the other ids are.
    numbered = "has a number for the id, such as '1196'; write the episode's id as text"
    assert set(rejected.value.problems) == {
        *problems_of_reading(content),
        Problem("wrong-type", "[85].instr_id", numbered),
    }
    assert {problem.code for problem in rejected.value.problems} == {
        "empty-trajectory",
        "missing-field",
        "not-finite",
        "wrong-type",
    }
    result.write_bytes(content)
    status, out, err = run("convert", "result.json", "-o", "submit.json")
    assert (status, out, Path("submit.json").exists()) == (1, "", False)
    assert err == f"result.json: {rejected.value}\n"


@pytest.mark.parametrize(
    ("content", "code"),
    [
        pytest.param(b'{"instr_id": "a", "trajectory": []}', "not-a-list", id="record alone"),
        pytest.param(b"[", "not-json", id="not JSON"),
        pytest.param(b"[{'a': None, []: 1}]", "not-json", id="Python that cannot be a value"),
        pytest.param(b'{"a": {}, "a": {}}', "repeated-field", id="id twice"),
        pytest.param(b'[{"instr_id": "a", "instr_id": "b"}]', "repeated-field", id="field twice"),
        pytest.param(b'{"instr_id": 1, "instr_id": 2}\n{}', "repeated-field", id="in lines"),
    ],
)
def test_what_cannot_be_converted(content: bytes, code: str) -> None:
    with pytest.raises(SubmissionError) as rejected:
        convert(content)
    assert code in {problem.code for problem in rejected.value.problems}


# The schema of what is written.


@pytest.mark.parametrize("name", ["good.json", "mediocre.json"])
def test_the_samples_have_the_schema(name: str) -> None:
    SCHEMA.validate(json.loads((SAMPLES / name).read_bytes()))


BOX = [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("answer", "is_one"),
    [
        pytest.param({"predObjId": 0}, True, id="object"),
        pytest.param({"predObjId": -1}, True, id="no object"),
        pytest.param({"predBox": BOX, "predView": 12}, True, id="box"),
        pytest.param({"predBox": BOX, "predView": 12, "predObjId": -1}, True, id="box, no object"),
        pytest.param({"predBox": None, "predObjId": 0}, True, id="object, box null"),
        pytest.param({"predBox": BOX, "predView": 12, "predObjId": 0}, False, id="box and object"),
        pytest.param({"predView": 12}, False, id="neither"),
        pytest.param({"predBox": [1, 2, 0, 4], "predView": 12}, False, id="box without width"),
        pytest.param({"predBox": BOX, "predView": 36}, False, id="view 36"),
        pytest.param({"predObjId": 2**31}, False, id="object 2**31"),
    ],
)
def test_the_published_schema_accepts_the_answers_that_reading_accepts(
    answer: dict[str, Any], *, is_one: bool
) -> None:
    where = {"instr_id": "7_1_1", "trajectory": [["hall", 1.5, 0.0]]}
    records = [{**where, "instr_id": "7_1_0", "predObjId": 3}, {**where, **answer}]
    assert SCHEMA.is_valid(records) == is_one
    assert (problems_of_reading(json.dumps(records).encode()) == ()) == is_one


RIGHT = {"instr_id": "7_1_0", "trajectory": [["hall", 1.5, 0.0]], "predObjId": 3}


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"predObjId": -2}, id="object -2"),
        pytest.param({"predObjId": 2**31}, id="object 2**31"),
        pytest.param({"predObjId": "3"}, id="object as text"),
        pytest.param({"predObjId": None}, id="null"),
        pytest.param({"instr_id": 7}, id="id is a number"),
        pytest.param({"trajectory": []}, id="no pose"),
        pytest.param({"trajectory": [["hall"]]}, id="no angles"),
        pytest.param({"trajectory": [["hall", 1, 2, 3]]}, id="three numbers"),
        pytest.param({"trajectory": [["hall", "kitchen"]]}, id="hop"),
        pytest.param({"predBox": [1, 2, 3, 4]}, id="box and object"),
    ],
)
def test_the_schema_describes_only_the_official_form(changes: dict[str, Any]) -> None:
    SCHEMA.validate([RIGHT])
    assert not SCHEMA.is_valid([RIGHT | changes])


BOXED = {
    "instr_id": "7_1_0",
    "trajectory": [["hall", 1.5, 0.0]],
    "predBox": [-1.5, 2, 3, 4],
    "predView": 35,
    "predImageSize": [1, 1.5],
}


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, id="box with everything"),
        pytest.param({"predView": None, "predImageSize": None}, id="box alone"),
        pytest.param({"predObjId": -1}, id="beside an abstention"),
        pytest.param({"predView": 0}, id="first view"),
        pytest.param({"predImageSize": [1, 1]}, id="smallest picture"),
        pytest.param({"predBox": None, "predObjId": 3}, id="no box"),
    ],
)
def test_a_converted_box_has_the_schema(changes: dict[str, Any]) -> None:
    records = [BOXED | changes]
    SCHEMA.validate(records)
    assert not read_predictions(json.dumps(records).encode()).problems


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"predObjId": 3}, id="beside an object"),
        pytest.param({"predObjId": 0}, id="beside object 0"),
        pytest.param({"predBox": [1, 2, 3]}, id="three numbers"),
        pytest.param({"predBox": [1, 2, 3, 4, 5]}, id="five numbers"),
        pytest.param({"predBox": [1, 2, 0, 4]}, id="no width"),
        pytest.param({"predBox": [1, 2, 3, 0]}, id="no height"),
        pytest.param({"predBox": "1 2 3 4"}, id="text"),
        pytest.param({"predView": 36}, id="view 36"),
        pytest.param({"predView": -1}, id="view -1"),
        pytest.param({"predView": 3.5}, id="half a view"),
        pytest.param({"predImageSize": [0.5, 1]}, id="less than 1 wide"),
        pytest.param({"predImageSize": [1, 0.5]}, id="less than 1 high"),
        pytest.param({"predImageSize": [640]}, id="no height of the picture"),
    ],
)
def test_a_box_that_reading_rejects_has_no_schema(changes: dict[str, Any]) -> None:
    records = [BOXED | changes]
    assert read_predictions(json.dumps(records).encode()).problems
    assert not SCHEMA.is_valid(records)


def test_a_record_without_an_answer_has_no_schema() -> None:
    silent = {field: RIGHT[field] for field in ("instr_id", "trajectory")}
    assert not SCHEMA.is_valid([silent])


@pytest.mark.parametrize(
    "mistake",
    [
        *("pandas to_json", 'pandas to_json(orient="index")', 'pandas to_json(orient="split")'),
        *('pandas to_json(orient="table")', "two files joined", "one list per process"),
        *("JSON within JSON", '{"results": {...}}', "predObjId written in three ways"),
        *('{"version": 1, "meta": {...}, "results": [...]}', "instr_id written id"),
        "the prefix val_unseen_",
    ],
)
def test_another_structure_is_converted_to_what_was_meant(mistake: str) -> None:
    records = convert(broken(mistake), split=SPLIT).records
    assert records == [
        {name: record[name] for name in ("instr_id", "trajectory", "predObjId")}
        for record in OFFICIAL
    ]


def test_views_become_whole_numbers() -> None:
    assert {record["predView"] for record in convert(broken("views as decimals")).records} == {12}
    record = {"instr_id": "a", "trajectory": ["hall"], "predBox": [1, 2, 3, 4]}
    for view in ("12", "12.0"):
        assert convert([{**record, "predView": view}]).records[0]["predView"] == 12


@pytest.mark.parametrize("behind", [b"see you", b"5"])
def test_what_follows_the_list_is_left_out(behind: bytes) -> None:
    converted = convert(json.dumps(OFFICIAL).encode() + b" " + behind)
    assert [record["instr_id"] for record in converted.records] == [
        record["instr_id"] for record in OFFICIAL
    ]
    assert converted.fixed == [f"text after the JSON: '{behind.decode()}'"]


def test_mistakes_that_could_be_fixed_are_listed_with_the_others() -> None:
    record = {name: OFFICIAL[0][name] for name in ("instr_id", "trajectory", "predObjId")}
    without_id = {name: record[name] for name in ("trajectory", "predObjId")}
    with pytest.raises(SubmissionError) as repeated:
        convert([record, record, without_id])
    same, no_id = repeated.value.problems
    assert (same.where, no_id.where) == ("[1].instr_id", "[2]")
    assert f"as an earlier record, such as '{record['instr_id']}'; remove" in same.message
    prefixed = {**record, "instr_id": f"r2r_{record['instr_id']}"}
    with pytest.raises(SubmissionError) as unknown:
        convert([prefixed, without_id], split=SPLIT)
    assert [problem.where for problem in unknown.value.problems] == ["[0].instr_id", "[1]"]


def test_a_record_without_id_repeats_no_other() -> None:
    record = {name: OFFICIAL[0][name] for name in ("trajectory", "predObjId")}
    with pytest.raises(SubmissionError) as caught:
        convert([record, record])
    assert {problem.code for problem in caught.value.problems} == {"missing-field"}
