"""What reading makes of a submission: columns, or every problem with its code and its place.

The tables hold the text of JSON values, because some faults exist in text only: a field that is
there twice, a number beyond the range of floats.
"""

import errno
import gzip
import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from reverie_eval import Problem, ProtocolError, SubmissionError
from reverie_eval.submissions import (
    MAX_MEBIBYTES_VARIABLE,
    Predictions,
    Submission,
    convert,
    read_predictions,
)
from reverie_eval.submissions._document import check_value_count, parse_document
from reverie_eval.submissions._official import decode_official
from reverie_eval.submissions._reading_log import ReadingLog
from reverie_eval.submissions._records import read_carefully
from reverie_eval.submissions._tables import rows_of_table
from reverie_eval.tasks import find_task
from tests.conftest import SAMPLES

RIGHT = {"instr_id": '"7_1_0"', "trajectory": '[["hall", 1.5, 0]]', "predObjId": "3"}
HUNDRED_THOUSAND = 100_000


class Columns(NamedTuple):
    """Everything that predictions say, in a form that compares."""

    instr_ids: list[str | None]
    viewpoint_ids: list[str | None]
    offsets: list[int]
    predicted_object: list[int]
    has_degrees: bool


def record(**fields: str) -> str:
    """Return the text of a right record, with other texts for some of its fields."""
    return "{" + ", ".join(f'"{name}": {text}' for name, text in (RIGHT | fields).items()) + "}"


def without(field: str) -> str:
    """Return the text of a record that lacks a field."""
    return json.dumps({name: json.loads(text) for name, text in RIGHT.items() if name != field})


def ending_in(pose: str) -> str:
    """Return the text of a record whose trajectory ends in this pose."""
    return record(trajectory=f'[["hall", 1.5, 0], {pose}]')


def document(*records: str) -> bytes:
    """Return the content of a file with these records."""
    return f"[{', '.join(records)}]".encode()


def problems_of(submission: Submission) -> tuple[Problem, ...]:
    """Return what reading finds, in the order in which it is told."""
    try:
        return SubmissionError(read_predictions(submission).problems).problems
    except SubmissionError as error:
        return error.problems


def columns_of(predictions: Predictions) -> Columns:
    """Return the columns of predictions."""
    return Columns(
        list(predictions.instr_ids),
        list(predictions.viewpoint_ids),
        predictions.offsets.tolist(),
        predictions.predicted_object.tolist(),
        predictions.has_degrees,
    )


def hops_of(predictions: Predictions) -> list[bool]:
    """Return whether each pose continues a hop."""
    if predictions.continues_hop is None:
        return [False] * len(predictions.viewpoint_ids)
    return list(predictions.continues_hop)


def boxes_of(predictions: Predictions) -> list[tuple[object, ...]]:
    """Return the boxes of predictions, each with its record, its camera and whether it is cut."""
    boxes = predictions.boxes
    columns = boxes.row, boxes.xywh, boxes.camera, boxes.is_cut
    return list(zip(*(column.tolist() for column in columns), strict=True))


def places_of(predictions: Predictions) -> list[tuple[str, list[tuple[int, ...]]]]:
    """Return where each record is in its file, and where its poses are in its trajectory."""
    return [
        (
            str(predictions.location(row)),
            [
                predictions.pose_path(row, pose)
                for pose in range(*predictions.offsets[row : row + 2].tolist())
            ],
        )
        for row in range(len(predictions.instr_ids))
    ]


# The file as a whole.

DAMAGED = bytearray(gzip.compress(document(record()), mtime=0))
DAMAGED[-5] ^= 1  # a bit of the checksum


@pytest.mark.parametrize(
    ("content", "code", "where", "fragment"),
    [
        pytest.param(b"", "not-json", "file", "is empty", id="empty file"),
        pytest.param(
            b"[\n {'a': 1}]",
            "not-json",
            "file",
            "has a list printed by Python instead of JSON; write it with json.dump",
            id="single quotes",
        ),
        pytest.param(
            b"{}\n" + 100_000 * b"[",
            "too-deep",
            "file",
            "is nested too deeply",
            id="nested after an object",
        ),
        pytest.param(
            b"[{}]\n\n  {}",
            "not-json",
            "line 3, column 3",
            "Extra data; write",
            id="a list and an object",
        ),
        pytest.param(
            b"[{}]\n[{}, nul]", "not-json", "line 2, column 6", "Expecting", id="an unfinished null"
        ),
        pytest.param(b'[{"a": 1}', "not-json", "line 1, column 10", "cut short", id="cut off"),
        pytest.param(b'["a", "b]', "not-json", "line 1, column 7", "cut short", id="cut in a text"),
        pytest.param(
            b"[1e5, .5]", "not-json", "line 1, column 7", "Expecting", id="no digit before point"
        ),
        pytest.param(
            b'["a\nb"]',
            "not-json",
            "line 1, column 4",
            "Invalid control character; write",
            id="line break in a text",
        ),
        pytest.param(b'["ok", "\xff"]', "not-json", "byte 8", "utf-8", id="invalid UTF-8"),
        pytest.param(b"PK\x03\x04", "damaged-zip", "file", "not a zip file", id="no zip"),
        pytest.param(b"<!doctype html>", "not-json", "file", "is a web page", id="web page"),
        pytest.param(
            record().encode(), "not-a-list", "file", "expected a list of", id="record without list"
        ),
        pytest.param(b"null", "not-a-list", "file", "holds null; expected a list", id="null"),
        pytest.param(b'"7_1_0"', "not-a-list", "file", "holds '7_1_0'", id="text"),
        pytest.param(b"17", "not-a-list", "file", "holds 17", id="number"),
        pytest.param(b"[" * HUNDRED_THOUSAND, "too-deep", "file", "nested", id="brackets"),
        pytest.param(
            b"{}\n" + b"[" * HUNDRED_THOUSAND,
            "too-deep",
            "file",
            "nested",
            id="brackets in the second line",
        ),
        pytest.param(
            document(record(note="[" * HUNDRED_THOUSAND + "]" * HUNDRED_THOUSAND)),
            "too-deep",
            "file",
            "a submission has four levels",
            id="brackets in a field that nobody reads",
        ),
        pytest.param(
            gzip.compress(document(record()))[:-10],
            "damaged-gzip",
            "file",
            "cannot be unpacked",
            id="truncated gzip",
        ),
        pytest.param(
            bytes(DAMAGED), "damaged-gzip", "file", "CRC check failed", id="gzip with a wrong bit"
        ),
        pytest.param(
            gzip.compress(b"")[:10] + b"\xff" * 10,
            "damaged-gzip",
            "file",
            "invalid block type",
            id="gzip of nonsense",
        ),
        pytest.param(b"\x1f\x8b[{}]", "damaged-gzip", "file", "", id="no gzip but its first bytes"),
    ],
)
def test_a_file_that_is_no_submission(content: bytes, code: str, where: str, fragment: str) -> None:
    (problem,) = problems_of(content)
    assert (problem.code, problem.where) == (code, where)
    assert fragment in problem.message


def test_a_trailing_comma_is_shown_in_its_line() -> None:
    """Python 3.13 shows the comma, older ones what follows."""
    (problem,) = problems_of(b"[{},\n {},\n]")
    assert problem.code == "not-json"
    assert problem.where in ("line 2, column 4", "line 3, column 1")


@pytest.mark.parametrize(
    "submission",
    [
        pytest.param(lambda content: content, id="bytes"),
        pytest.param(gzip.compress, id="what a gzip unpacks to"),
        pytest.param(io.BytesIO, id="binary file"),
        pytest.param(lambda content: io.StringIO(content.decode()), id="text file"),
    ],
)
def test_too_large(
    submission: Callable[[bytes], Submission], monkeypatch: pytest.MonkeyPatch
) -> None:
    mebibyte = 1 << 20
    monkeypatch.setenv(MAX_MEBIBYTES_VARIABLE, "1")
    just_fits = document(record()).ljust(mebibyte)
    assert problems_of(submission(just_fits)) == ()
    (problem,) = problems_of(submission(just_fits + b" "))
    assert (problem.code, problem.where) == ("too-large", "file")
    assert "larger than 1 MiB" in problem.message
    assert problem.message.endswith("set REVERIE_EVAL_MAX_MEBIBYTES to the size in MiB")


def test_of_a_file_that_is_too_large_no_more_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(MAX_MEBIBYTES_VARIABLE, "1")
    content = b" " * (2 << 20)
    path = tmp_path / "large.json"
    path.write_bytes(content)
    opened, piped = io.BytesIO(content), io.BytesIO(content)
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(piped))
    for source in (str(path), path, opened, "-"):
        (problem,) = problems_of(source)
        assert problem.code == "too-large"
    assert (opened.tell(), piped.tell()) == (1 + (1 << 20),) * 2


def test_standard_input_that_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(OSError, match="is closed: 'standard input'") as closed:
        read_predictions("-")
    assert closed.value.errno == errno.EBADF


@pytest.mark.parametrize(
    ("source", "message"),
    [
        pytest.param("[]", "to score JSON text, pass it as bytes: text.encode()", id="JSON text"),
        pytest.param(
            ' {"7_1_0": 3}\n', "to score JSON text, pass it as bytes: text.encode()", id="an object"
        ),
        pytest.param(
            3, "a submission is a path, bytes, an open file or records, got int", id="a number"
        ),
    ],
)
def test_what_is_no_source(source: Any, message: str) -> None:
    with pytest.raises(TypeError) as refused:
        read_predictions(source)
    assert str(refused.value) == message


@pytest.mark.parametrize("path", ["[a.json", "a.json}", "{a]"])
def test_a_path_with_brackets_is_a_path(path: str) -> None:
    with pytest.raises(FileNotFoundError):
        read_predictions(path)


@pytest.mark.parametrize("value", ["", "-1", "0", "1.5", "two", "9" * 7])
def test_a_largest_size_that_is_not_one(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MAX_MEBIBYTES_VARIABLE, value)
    with pytest.raises(ProtocolError, match="a whole number of MiB from 1, such as 128; got '"):
        read_predictions(CONTENT)


# Records.

NO_ID = "expected the episode's id as text"
NO_TRAJECTORY = "expected a list of poses [viewpoint_id, heading, elevation]"
NO_POSE = "expected [viewpoint_id, heading, elevation]"
NUMBERED = "has viewpoints given as numbers, such as "
NO_OBJECT = "expected an object id (an integer from 0), or -1"
FINITE = "heading and elevation are finite numbers of radians"
SECOND_POSE = ".trajectory[1]"


@pytest.mark.parametrize(
    ("text", "code", "field", "fragment"),
    [
        pytest.param('"7_1_0"', "wrong-type", "", "got '7_1_0'; expected an object", id="text"),
        pytest.param("null", "wrong-type", "", "expected an object", id="null"),
        pytest.param("[]", "wrong-type", "", "got []; expected an object", id="list"),
        pytest.param(without("instr_id"), "missing-field", "", "no instr_id", id="id missing"),
        pytest.param(
            without("trajectory"), "missing-field", "", "no trajectory", id="trajectory missing"
        ),
        pytest.param(
            without("predObjId"),
            "missing-field",
            "",
            "neither predObjId nor predBox",
            id="object missing",
        ),
        pytest.param(record(instr_id="7"), "wrong-type", ".instr_id", NO_ID, id="id is a number"),
        pytest.param(record(instr_id="null"), "wrong-type", ".instr_id", NO_ID, id="id is null"),
        pytest.param(
            record(trajectory='"hall"'),
            "wrong-type",
            ".trajectory",
            f"got 'hall'; {NO_TRAJECTORY}",
            id="trajectory is a text",
        ),
        pytest.param(
            record(trajectory="null"),
            "wrong-type",
            ".trajectory",
            NO_TRAJECTORY,
            id="no trajectory",
        ),
        pytest.param(
            record(trajectory="{}"), "wrong-type", ".trajectory", NO_TRAJECTORY, id="object for it"
        ),
        pytest.param(
            record(trajectory="[]"),
            "empty-trajectory",
            ".trajectory",
            "has one pose, its start viewpoint",
            id="empty trajectory",
        ),
        pytest.param(ending_in("7"), "wrong-type", SECOND_POSE, NUMBERED, id="pose is a number"),
        pytest.param(ending_in("null"), "wrong-type", SECOND_POSE, NO_POSE, id="pose is null"),
        pytest.param(ending_in("{}"), "wrong-type", SECOND_POSE, NO_POSE, id="pose is an object"),
        pytest.param(
            ending_in("[7, 0.0, 0.0]"),
            "wrong-type",
            SECOND_POSE,
            NUMBERED,
            id="viewpoint is a number",
        ),
        pytest.param(
            ending_in('["bath", 1]'), "wrong-type", SECOND_POSE, NO_POSE, id="no elevation"
        ),
        pytest.param(
            ending_in('["hall", "north", 0]'), "wrong-type", SECOND_POSE, NO_POSE, id="heading text"
        ),
        pytest.param(
            ending_in('["hall", true, 0]'), "wrong-type", SECOND_POSE, NO_POSE, id="heading true"
        ),
        pytest.param(
            ending_in('["hall", 0, null]'), "wrong-type", SECOND_POSE, NO_POSE, id="elevation null"
        ),
        pytest.param(ending_in('["hall", NaN, 0]'), "not-finite", SECOND_POSE, FINITE, id="NaN"),
        pytest.param(
            ending_in('["hall", 0, Infinity]'), "not-finite", SECOND_POSE, FINITE, id="Infinity"
        ),
        pytest.param(
            ending_in('["hall", 0, -Infinity]'), "not-finite", SECOND_POSE, FINITE, id="-Infinity"
        ),
        pytest.param(
            ending_in('["hall", 1e400, 0]'), "not-finite", SECOND_POSE, FINITE, id="1e400"
        ),
        pytest.param(
            ending_in(f'["hall", 0, 1{"0" * 400}]'), "not-finite", SECOND_POSE, FINITE, id="10**400"
        ),
        pytest.param(
            record(predObjId="[3]"),
            "wrong-type",
            ".predObjId",
            f"got [3]; {NO_OBJECT}",
            id="object is a list",
        ),
        pytest.param(
            record(predObjId="3.5"), "wrong-type", ".predObjId", NO_OBJECT, id="object 3.5"
        ),
        pytest.param(
            record(predObjId="3.0"),
            "wrong-type",
            ".predObjId",
            "has an object id written as a decimal, such as 3.0; write whole numbers, or let "
            "`reverie-eval convert` do it",
            id="object 3.0",
        ),
        pytest.param(
            record(predObjId="true"), "wrong-type", ".predObjId", NO_OBJECT, id="object true"
        ),
        pytest.param(
            record(predObjId='"owl"'),
            "wrong-type",
            ".predObjId",
            f"got 'owl'; {NO_OBJECT}",
            id="object is a word",
        ),
        pytest.param(
            record(predObjId='"3.0"'),
            "wrong-type",
            ".predObjId",
            "has an object id written as a decimal, such as '3.0'",
            id="text 3.0",
        ),
        pytest.param(record(predObjId='"-2"'), "wrong-type", ".predObjId", NO_OBJECT, id="text -2"),
        pytest.param(record(predObjId='" 3"'), "wrong-type", ".predObjId", NO_OBJECT, id="blank 3"),
        pytest.param(
            record(predObjId='"\u0663"'), "wrong-type", ".predObjId", NO_OBJECT, id="arabic 3"
        ),
        pytest.param(
            record(predObjId=f'"{2**31}"'), "wrong-type", ".predObjId", NO_OBJECT, id="text 2**31"
        ),
        pytest.param(
            record(predObjId=f'"{"9" * 5000}"'),
            "wrong-type",
            ".predObjId",
            NO_OBJECT,
            id="text of thousands of digits",
        ),
        pytest.param(record(predObjId="-2"), "wrong-type", ".predObjId", NO_OBJECT, id="object -2"),
        pytest.param(
            record(predObjId=str(2**31)), "wrong-type", ".predObjId", NO_OBJECT, id="object 2**31"
        ),
        pytest.param(
            record()[:-1] + ', "predObjId": 4}',
            "repeated-field",
            "",
            "has predObjId twice",
            id="field twice",
        ),
    ],
)
def test_a_fault_in_a_record(text: str, code: str, field: str, fragment: str) -> None:
    (problem,) = problems_of(document(record(), text))
    assert (problem.code, problem.where) == (code, f"[1]{field}")
    assert fragment in problem.message


def test_everything_is_reported_at_once_in_the_order_of_the_file() -> None:
    wrong = (
        record(predObjId="true", instr_id="7"),
        '"7_1_0"',
        record(),
        record(trajectory='[7, ["hall", NaN], ["hall"], [null]]', predObjId="[]"),
        "{}",
    )
    assert [problem.where for problem in problems_of(document(*wrong))] == [
        "[0].instr_id",
        "[0].predObjId",
        "[1]",
        "[3].predObjId",
        "[3].trajectory[0]",
        "[3].trajectory[1]",
        "[3].trajectory[3]",
        "[4]",
        "[4]",
        "[4]",
    ]


def test_of_too_many_problems_every_kind_is_shown() -> None:
    error = SubmissionError(problems_of(document(*map(str, range(100)), without("instr_id"))))
    title, *shown, rest = str(error).splitlines()
    assert title == "submission rejected, 101 problems"
    assert rest == "... and 97 more wrong-type"
    assert [line.partition(":")[0] for line in shown] == ["[0]", "[1]", "[2]", "[100]"]


def test_a_problem_of_many_records_is_shown_once() -> None:
    error = SubmissionError(problems_of(document(*["null"] * 1_000, without("instr_id"))))
    title, shown, other = str(error).splitlines()
    assert title == "submission rejected, 1001 problems"
    assert shown.startswith("[0] and 999 more: got null; expected an object with ")
    assert other == "[1000]: has no instr_id; add it"
    assert len(repr(error)) < 300


# What is accepted.


@pytest.mark.parametrize(
    ("text", "viewpoint_ids", "predicted_object"),
    [
        pytest.param(record(), ["hall"], 3, id="as published"),
        pytest.param(record(predObjId="-1"), ["hall"], -1, id="-1 abstains"),
        pytest.param(record(predObjId="null"), ["hall"], -1, id="null abstains"),
        pytest.param(record(predObjId='"None"'), ["hall"], -1, id="None abstains"),
        pytest.param(record(predObjId='"-1"'), ["hall"], -1, id="-1 as text abstains"),
        pytest.param(record(predObjId='""'), ["hall"], -1, id="empty text abstains"),
        pytest.param(record(predObjId="0"), ["hall"], 0, id="0 is an object"),
        pytest.param(record(predObjId='"0"'), ["hall"], 0, id="0 as text is an object"),
        pytest.param(record(predObjId='"3"'), ["hall"], 3, id="object as text"),
        pytest.param(record(predObjId=str(2**31 - 1)), ["hall"], 2**31 - 1, id="largest object id"),
        pytest.param(
            record(predObjId=f'"{2**31 - 1}"'), ["hall"], 2**31 - 1, id="largest object id as text"
        ),
        pytest.param(without("predObjId"), ["hall"], -1, id="no answer in the whole file"),
        pytest.param(ending_in('["bath"]'), ["hall", "bath"], 3, id="pose of a viewpoint alone"),
        pytest.param(
            record()[:-1] + ', "note": 1, "note": 1}', ["hall"], 3, id="field nobody reads, twice"
        ),
        pytest.param(ending_in('"bath"'), ["hall", "bath"], 3, id="bare viewpoint"),
        pytest.param(ending_in('["bath", "loft"]'), ["hall", "bath", "loft"], 3, id="nested hop"),
        pytest.param(ending_in('["hall", 9, 0]'), ["hall", "hall"], 3, id="turning on the spot"),
        pytest.param(record(note='{"a": [NaN]}'), ["hall"], 3, id="further field"),
        pytest.param(record(trajectory='[["b\\u00e4d"]]'), ["bäd"], 3, id="escapes"),
    ],
)
def test_a_right_record(text: str, viewpoint_ids: list[str], predicted_object: int) -> None:
    predictions = read_predictions(document(text))
    assert not predictions.problems
    assert columns_of(predictions)[:-1] == (
        ["7_1_0"],
        viewpoint_ids,
        [0, len(viewpoint_ids)],
        [predicted_object],
    )


@pytest.mark.parametrize(
    ("trajectory", "has_degrees"),
    [
        pytest.param('[["hall", 6.28, 0]]', False, id="a full turn, nearly"),
        pytest.param('[["hall", 6.29, 0]]', True, id="more than a full turn"),
        pytest.param('[["hall", 0, -30]]', True, id="elevation"),
        pytest.param('[["hall", 90, 0], ["bath", -3, 0.5]]', False, id="not at the last pose"),
        pytest.param('[["hall", 1, 2], ["bath", -90, 0.5]]', True, id="at the last pose"),
        pytest.param('[["hall", 90, 0], ["bath"]]', False, id="stop without angles"),
        pytest.param('["hall"]', False, id="bare viewpoint"),
        pytest.param('[["hall", "bath"]]', False, id="nested hop"),
    ],
)
def test_degrees_are_recognised_at_the_last_pose(trajectory: str, *, has_degrees: bool) -> None:
    predictions = read_predictions(document(record(trajectory=trajectory)))
    assert predictions.has_degrees == has_degrees


def test_most_records_have_to_look_like_degrees() -> None:
    radians, degrees = record(), record(trajectory='[["hall", 90, 0]]')
    assert not read_predictions(document(radians, degrees)).has_degrees
    assert read_predictions(document(radians, degrees, degrees)).has_degrees


@pytest.mark.parametrize("content", [b"[]", b"{}"], ids=["list", "keyed"])
def test_no_record_at_all(content: bytes) -> None:
    """It is for the ground truth to say that every episode is missing."""
    predictions = read_predictions(content)
    assert columns_of(predictions) == ([], [], [0], [], False)
    assert not [*predictions.problems, *predictions.read_as]


CONTENT = document(record(), record(instr_id='"7_1_1"', trajectory='[["hall"], ["bath", 0, 0]]'))
RECORDS = json.loads(CONTENT)
COLUMNS = Columns(
    ["7_1_0", "7_1_1"], ["hall", "hall", "bath"], [0, 1, 3], [3, 3], has_degrees=False
)


def _written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    "submission",
    [
        pytest.param(lambda folder: _written(folder / "submit.json", CONTENT), id="path"),
        pytest.param(lambda folder: str(_written(folder / "submit.json", CONTENT)), id="its text"),
        pytest.param(
            lambda folder: _written(folder / "submit.json.gz", gzip.compress(CONTENT)), id="gzip"
        ),
        pytest.param(
            lambda folder: _written(folder / "submit.json", gzip.compress(CONTENT)),
            id="gzip by another name",
        ),
        pytest.param(lambda _: CONTENT, id="bytes"),
        pytest.param(lambda _: gzip.compress(CONTENT), id="bytes of a gzip"),
        pytest.param(lambda _: b"\xef\xbb\xbf" + CONTENT, id="UTF-8 with a byte order mark"),
        pytest.param(
            lambda _: CONTENT.decode().encode("utf-16"), id="UTF-16, as PowerShell writes"
        ),
        pytest.param(lambda _: io.BytesIO(CONTENT), id="binary stream"),
        pytest.param(lambda _: io.StringIO(CONTENT.decode()), id="text stream"),
        pytest.param(lambda _: RECORDS, id="list"),
        pytest.param(lambda _: tuple(RECORDS), id="tuple"),
    ],
)
def test_every_kind_of_source(submission: Callable[[Path], Submission], tmp_path: Path) -> None:
    assert columns_of(read_predictions(submission(tmp_path))) == COLUMNS


@pytest.mark.parametrize("mode", ["r", "rb"])
def test_an_open_file(mode: str, tmp_path: Path) -> None:
    with _written(tmp_path / "submit.json", CONTENT).open(mode) as file:
        assert columns_of(read_predictions(file)) == COLUMNS  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "content", [pytest.param(CONTENT, id="plain"), pytest.param(gzip.compress(CONTENT), id="gzip")]
)
def test_a_dash_is_standard_input(content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(content)))
    assert columns_of(read_predictions("-")) == COLUMNS


def test_python_objects_with_tuples_and_numpy_scalars() -> None:
    agent_output = {
        "instr_id": np.str_("7_1_0"),
        "trajectory": (("hall", np.float32(1.5), np.int64(0)), (np.str_("bath"),)),
        "predObjId": np.int64(3),
    }
    expected = Columns(["7_1_0"], ["hall", "bath"], [0, 2], [3], has_degrees=False)
    assert columns_of(read_predictions([agent_output])) == expected


@pytest.mark.parametrize(
    "value", [np.bool_(1), np.float64(3), np.int64(-2), float("nan"), {3}, b"3"], ids=repr
)
def test_python_objects_that_are_not_object_ids(value: object) -> None:
    (problem,) = problems_of([{"instr_id": "7_1_0", "trajectory": [["hall"]], "predObjId": value}])
    assert (problem.code, problem.where) == ("wrong-type", "[0].predObjId")


# The fast lane reads as the slow one does.

NUMBERS = ["0", "-0", "-1", "3", "3.0", "3e0", "1.", "01", "1e400", "9" * 400, str(2**31), "NaN"]
STRANGE = ["null", "true", "{}", "[]", '"', '"a\nb"', '"\\ud800"', '"\\u00e4"', '"a:b"', '[["a"]]']

names = (st.text(max_size=3) | st.sampled_from(["reverie_", "reverie_7_1_0"])).map(json.dumps)
angles = st.integers().map(str) | st.floats(allow_nan=False, allow_infinity=False).map(repr)
texts = st.sampled_from([*NUMBERS, *STRANGE]) | names | angles
fields = st.sampled_from(list(RIGHT))
box_fields = st.sampled_from(["predBox", "predView", "predImageSize"])
poses = st.builds("[{}, {}, {}]".format, names, angles, angles)
hops = st.lists(names | names.map(lambda name: f"{name}, {name}"), max_size=2).map(
    lambda ids: f"[{', '.join(ids)}]"
)
right_answers = st.integers(-1, 2**31 - 1).map(str) | st.integers(0, 2**31 + 1).map('"{}"'.format)


def right_records_of(steps: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    """Draw records of which most are of a form that the fast lane reads."""
    return st.builds(
        lambda instr_id, trajectory, answer: record(
            instr_id=instr_id, trajectory=f"[{', '.join(trajectory)}]", predObjId=answer
        ),
        names,
        st.lists(steps, min_size=1, max_size=3),
        right_answers,
    )


right_records = right_records_of(poses)
records_of_hops = right_records_of(hops)
other_poses = st.one_of(
    names, st.just("[]"), names.map("[{}]".format), st.builds("[{}, {}]".format, names, names)
)
other_answers = st.sampled_from(['"3"', '"None"', '""', '"-1"', '"owl"'])
other_records = st.one_of(
    st.builds(
        lambda poses, answer: record(trajectory=f"[{', '.join(poses)}]", predObjId=answer),
        st.lists(other_poses, max_size=3),
        other_answers,
    ),
    other_answers.map(lambda answer: without("predObjId")[:-1] + f', "pred_objid": {answer}}}'),
)
numbers = st.one_of(st.integers(-700, 700), st.floats(-1000, 1000), st.floats(0)).map(json.dumps)
extents = (st.integers(1, 700) | st.floats(1e-3, 1000)).map(json.dumps)
box_records = st.builds(
    lambda box, view, size, pose: record(
        predBox=box, predView=view, predImageSize=size, predObjId="-1", trajectory=f"[{pose}]"
    ),
    st.builds("[{}, {}, {}, {}]".format, numbers, numbers, extents, extents),
    st.just("null") | st.integers(0, 35).map(str),
    st.just("null") | st.builds("[{}, {}]".format, extents, extents),
    st.builds("[{}, {}, {}]".format, names, angles, angles),
)
wrong_records = st.one_of(
    other_records,
    box_records,
    texts,
    fields.map(without),
    st.builds(
        lambda name, text: record(**{name: text}), fields | box_fields | st.just("note"), texts
    ),
    st.builds(lambda name, text: f'{record()[:-1]}, "{name}": {text}}}', fields, texts),
    st.builds("[{}, {}, {}]".format, texts, texts, texts).map(ending_in),
)
lists = st.sampled_from([right_records, records_of_hops]).flatmap(
    lambda right: st.builds(
        lambda before, wrong, after: document(*before, *wrong, *after),
        st.lists(right, max_size=2),
        st.lists(wrong_records, max_size=1),
        st.lists(right, max_size=2),
    )
)
keyed = st.lists(st.tuples(names, right_records | wrong_records), max_size=3).map(
    lambda items: f"{{{', '.join(f'{name}: {text}' for name, text in items)}}}".encode()
)
documents = lists | keyed


@st.composite
def damaged_documents(draw: st.DrawFn) -> bytes:
    """Draw a document with a few bytes replaced by others."""
    content = draw(documents)
    begin = draw(st.integers(0, len(content)))
    end = draw(st.integers(begin, min(begin + 3, len(content))))
    return content[:begin] + draw(st.binary(max_size=3)) + content[end:]


@settings(max_examples=500)
@given(content=documents | damaged_documents(), chunk=st.sampled_from([1, 100, 1 << 16]))
def test_the_fast_lane_declines_or_agrees(content: bytes, chunk: int) -> None:
    """However many bytes it decodes at once."""
    with patch("reverie_eval.submissions._official._CHUNK", chunk):
        predictions = decode_official(content)
    event("taken" if predictions else "declined")
    if predictions:
        log = ReadingLog()
        carefully = read_carefully(parse_document(content, log), log)
        assert columns_of(predictions) == columns_of(carefully)
        assert places_of(predictions) == places_of(carefully)
        assert predictions.answer_is_text.tolist() == carefully.answer_is_text.tolist()
        assert boxes_of(predictions) == boxes_of(carefully) == []
        assert predictions.differences == carefully.differences
        assert hops_of(predictions) == hops_of(carefully)
        assert predictions.read_as == carefully.read_as
        assert not carefully.problems


@pytest.mark.parametrize(
    "between", [",", " ,\n\t", ",,", "", ",\x0b", "}, {", "], [", '"}, {"', ', {"note": "}, {"}, ']
)
def test_a_list_is_cut_between_records_only(between: str) -> None:
    """Whatever is between records: the fast lane cuts here after each record."""
    content = f"[{record()}{between}{record()}]".encode()
    with patch("reverie_eval.submissions._official._CHUNK", 1):
        predictions = decode_official(content)
    assert (predictions is not None) == (between.strip(" \n\t") == ",")
    assert predictions is None or columns_of(predictions) == columns_of(read_predictions(content))


def test_a_text_that_looks_like_the_space_between_records() -> None:
    name = json.dumps("a}, {b")
    content = document(record(instr_id=name), record(trajectory=f"[[{name}, 0, 0]]"))
    with patch("reverie_eval.submissions._official._CHUNK", 1):
        assert decode_official(content) is None
    assert read_predictions(content).instr_ids[0] == json.loads(name)


@settings(max_examples=500)
@given(content=damaged_documents() | st.binary())
def test_bytes_are_read_or_rejected(content: bytes) -> None:
    """Anything but a rejection would be our own error, and fail here."""
    for problem in problems_of(content):
        assert problem.message


@settings(max_examples=500)
@given(content=documents | damaged_documents(), answers_only=st.booleans())
def test_columns_fit_together(content: bytes, *, answers_only: bool) -> None:
    """Whatever is read has a value for each record and a location for each pose."""
    try:
        predictions = read_predictions(content, answers_only=answers_only)
    except SubmissionError:
        return
    records, poses = len(predictions.instr_ids), len(predictions.viewpoint_ids)
    assert len(predictions.predicted_object) == len(predictions.answer_is_text) == records
    assert set(predictions.boxes.row.tolist()) <= set(range(records))
    assert predictions.offsets[[0, -1]].tolist() == [0, poses]
    assert (
        np.diff(predictions.offsets) >= (0 if predictions.problems or answers_only else 1)
    ).all()
    assert sum(len(paths) for _, paths in places_of(predictions)) == poses
    if not predictions.problems and not answers_only:
        assert (np.diff(predictions.first_of_hops().offsets) >= 1).all()


@settings(max_examples=500)
@given(content=documents)
def test_what_can_be_read_is_read_the_same_when_converted(content: bytes) -> None:
    """Except for missing angles, which become 0, and for what was fixed."""
    told = problems_of(content)
    try:
        conversion = convert(content)
    except SubmissionError:
        event("rejected")
        return
    converted = json.dumps(conversion.records).encode()
    assert not problems_of(converted)
    if told or conversion.fixed:
        event("fixed")
        assert conversion.fixed
        return
    before, after = (read_predictions(it) for it in (content, converted))
    assert columns_of(after)[:-1] == columns_of(before)[:-1]
    assert boxes_of(after) == boxes_of(before)


def with_tuples(value: Any) -> Any:
    """Return a document with tuples in the place of lists; its objects are changed."""
    if isinstance(value, dict):
        value |= {name: with_tuples(each) for name, each in value.items()}
    return tuple(map(with_tuples, value)) if isinstance(value, list) else value


@settings(max_examples=200)
@given(content=documents)
def test_the_careful_lane_reads_common_forms_as_it_reads_others(content: bytes) -> None:
    """Trajectories that are lists are read by loops in C if they have a common form."""
    try:
        document, other = (parse_document(content, ReadingLog()) for _ in range(2))
        by_loops, by_elements = (
            read_carefully(each, ReadingLog()) for each in (document, with_tuples(other))
        )
    except SubmissionError:
        return
    assert columns_of(by_loops) == columns_of(by_elements)
    assert places_of(by_loops) == places_of(by_elements)
    assert by_loops.differences == by_elements.differences
    assert np.array_equal(by_loops.continues_hop, by_elements.continues_hop)  # type: ignore[arg-type]
    assert [each.where for each in by_loops.problems] == [
        each.where for each in by_elements.problems
    ]


@pytest.mark.parametrize("chunk", [1, 1 << 16])
def test_the_fast_lane_reads_hops(chunk: int) -> None:
    content = document(
        record(trajectory='[["hall"], [], ["bath", "loft"]]', predObjId='"3"'),
        record(instr_id='"7_1_1"', trajectory='[["hall"], ["bath"]]'),
        record(instr_id='"7_1_2"', trajectory='[["loft"]]', predObjId="4"),
    )
    with patch("reverie_eval.submissions._official._CHUNK", chunk):
        predictions = decode_official(content)
    assert predictions is not None
    assert columns_of(predictions) == Columns(
        ["7_1_0", "7_1_1", "7_1_2"],
        ["hall", "bath", "loft", "hall", "bath", "loft"],
        [0, 3, 5, 6],
        [3, 3, 4],
        has_degrees=False,
    )
    assert places_of(predictions) == [
        ("[0]", [(0, 0), (2, 0), (2, 1)]),
        ("[1]", [(0, 0), (1, 0)]),
        ("[2]", [(0, 0)]),
    ]
    assert hops_of(predictions) == [False, False, True, False, False, False]
    assert predictions.answer_is_text.tolist() == [True, False, False]
    assert predictions.has_leading_zeros.tolist() == [False] * 3
    assert not predictions.is_navigation_only
    assert predictions.differences == {
        "text ids": 1,
        "hops": 1,
        "empty hops": 1,
        "long hops": 1,
        "no angles": 6,
    }
    assert predictions.read_as == [
        "1 trajectories of nested hops",
        "1 hops with more than one viewpoint, every viewpoint counted",
        "6 poses without heading and elevation",
        "1 object ids written as text",
    ]


@pytest.mark.parametrize(
    ("text", "is_taken"),
    [
        pytest.param(record(predObjId=f'"{2**31 - 1}"'), True, id="largest object as text"),
        pytest.param(record(predObjId=f'"{2**31}"'), False, id="larger object as text"),
        pytest.param(record(predObjId='"03"'), False, id="leading zero"),
        pytest.param(record(trajectory='[["7", 1.5, 0]]'), True, id="digits for a viewpoint"),
        pytest.param(record(trajectory='[["hall", "7"]]'), False, id="hop, or angle as text"),
        pytest.param(record(trajectory='[["hall"], []]'), True, id="empty hop"),
        pytest.param(record(trajectory="[[]]"), False, id="empty hop only"),
        pytest.param(record(trajectory="[]"), False, id="no pose"),
        pytest.param(record(instr_id='"reverie_7_1_0"'), False, id="prefix"),
        pytest.param(record(instr_id='"7:1"'), False, id="colon"),
    ],
)
def test_what_the_fast_lane_takes(text: str, *, is_taken: bool) -> None:
    assert (decode_official(document(text)) is not None) == is_taken


def test_the_longest_trajectory_of_the_fast_lane(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reverie_eval.submissions._official.MAX_POSES", 2)
    two, three = (record(trajectory=f'[{", ".join(["""["hall", 1, 0]"""] * n)}]') for n in (2, 3))
    assert decode_official(document(record(), two)) is not None
    assert decode_official(document(record(), three)) is None


@pytest.mark.parametrize("form", [list, tuple])
@pytest.mark.parametrize(
    ("trajectory", "viewpoint_ids", "paths", "continues_hop", "differences"),
    [
        pytest.param([["a", 1, 2]], "a", [(0, 0)], [False], {}, id="poses"),
        pytest.param(
            [["a"], [], ["b", "c"]],
            "abc",
            [(0, 0), (2, 0), (2, 1)],
            [False, False, True],
            {"hops": 2, "empty hops": 2, "long hops": 2, "no angles": 6},
            id="hops",
        ),
        pytest.param([["a"], ["b"]], "ab", [(0, 0), (1, 0)], [False] * 2, {"no angles": 4}, id="1"),
        pytest.param(
            [["a", 0, 0], [], ["b", "c", "d"]],
            "abcd",
            [(0, 0), (2, 0), (2, 1), (2, 2)],
            [False, False, True, True],
            {"hops": 2, "empty hops": 2, "long hops": 2, "no angles": 6},
            id="a pose and hops",
        ),
        pytest.param(
            ["a", ["b"], ["c", 1, 2, 3]],
            "abc",
            [(0,), (1, 0), (2, 0)],
            [False] * 3,
            {"bare viewpoints": 2, "no angles": 2, "extra numbers": 2},
            id="every form of a pose",
        ),
        pytest.param(
            ["a", ["b", "c"]],
            "abc",
            [(0,), (1, 0), (1, 1)],
            [False, False, True],
            {"bare viewpoints": 2, "hops": 2, "long hops": 2, "no angles": 4},
            id="a hop of two behind a bare viewpoint",
        ),
    ],
)
def test_the_careful_lane_reads_a_trajectory(
    trajectory: list[Any],
    viewpoint_ids: str,
    paths: list[tuple[int, ...]],
    *,
    continues_hop: list[bool],
    differences: dict[str, int],
    form: Callable[[list[Any]], Any],
) -> None:
    """In two records, so that what differs from the official form is counted twice."""
    log = ReadingLog()
    records = [
        {"instr_id": name, "trajectory": form(trajectory), "predObjId": 3} for name in ("x", "y")
    ]
    predictions = read_carefully(records, log)
    assert list(predictions.viewpoint_ids) == [*viewpoint_ids, *viewpoint_ids]
    assert places_of(predictions) == [("[0]", paths), ("[1]", paths)]
    assert hops_of(predictions) == continues_hop * 2
    assert {key: count for key, count in log.differences.items() if count} == differences
    assert predictions.differences is log.differences
    assert predictions.predicted_object.dtype == np.int64
    assert predictions.answer_is_text.dtype == predictions.has_leading_zeros.dtype == np.bool_


@pytest.mark.parametrize(
    ("answer", "object_id", "is_text", "has_leading_zeros", "differences"),
    [
        pytest.param(3, 3, False, False, {}, id="number"),
        pytest.param(2**31 - 1, 2**31 - 1, False, False, {}, id="largest"),
        pytest.param(-1, -1, False, False, {}, id="none"),
        pytest.param(None, -1, False, False, {"abstentions": 2}, id="null"),
        pytest.param("-1", -1, False, False, {"abstentions": 2}, id="none as text"),
        pytest.param("3", 3, True, False, {"text ids": 2}, id="text"),
        pytest.param("0", 0, True, False, {"text ids": 2}, id="0 as text"),
        pytest.param(str(2**31 - 1), 2**31 - 1, True, False, {"text ids": 2}, id="largest text"),
        pytest.param("03", 3, True, True, {"text ids": 2, "leading zeros": 2}, id="leading zero"),
        pytest.param(
            "0000000003", 3, True, True, {"text ids": 2, "leading zeros": 2}, id="ten digits"
        ),
    ],
)
def test_the_careful_lane_reads_an_answer(
    answer: object,
    object_id: int,
    *,
    is_text: bool,
    has_leading_zeros: bool,
    differences: dict[str, int],
) -> None:
    """In two records, so that what differs from the official form is counted twice."""
    log = ReadingLog()
    records = [
        {"instr_id": name, "trajectory": [["a", 0, 0]], "predObjId": answer} for name in "xy"
    ]
    predictions = read_carefully(records, log)
    assert not predictions.problems
    assert predictions.predicted_object.tolist() == [object_id] * 2
    assert predictions.answer_is_text.tolist() == [is_text] * 2
    assert predictions.has_leading_zeros.tolist() == [has_leading_zeros] * 2
    assert {key: count for key, count in log.differences.items() if count} == differences


def test_an_id_of_eleven_digits_is_not_one() -> None:
    (problem,) = problems_of([{**RECORDS[0], "predObjId": "0" * 10 + "3"}])
    assert problem.message.startswith("got '00000000003'; expected an object id")


@pytest.mark.parametrize("name", ["good.json", "mediocre.json"])
def test_the_fast_lane_accepts_what_agents_write(name: str) -> None:
    assert decode_official((SAMPLES / name).read_bytes()) is not None


@pytest.mark.parametrize("name", ["r2r", "r4r"])
@pytest.mark.parametrize("chunk", [1, 1 << 16])
def test_the_fast_lane_reads_a_task_without_objects(name: str, chunk: int) -> None:
    content = (SAMPLES / f"{name}.json").read_bytes()
    with patch("reverie_eval.submissions._official._CHUNK", chunk):
        predictions = decode_official(content, has_answers=False)
    assert predictions is not None
    log = ReadingLog()
    carefully = read_carefully(parse_document(content, log), log, find_task(name))
    assert columns_of(predictions) == columns_of(carefully)
    assert predictions.is_navigation_only
    assert carefully.is_navigation_only
    assert decode_official(content) is None
    assert decode_official((SAMPLES / "good.json").read_bytes(), has_answers=False) is None


@pytest.mark.parametrize("name", ["good", "r2r"])
@pytest.mark.parametrize("load", [bytes, json.loads], ids=["text", "objects"])
def test_the_official_form_takes_the_fast_lane(load: Callable[[bytes], Any], name: str) -> None:
    """The careful one notes where every record is."""
    submission = load((SAMPLES / f"{name}.json").read_bytes())
    task = find_task("r2r" if name == "r2r" else "reverie")
    assert read_predictions(submission, task).locations is None


@pytest.mark.parametrize("load", [bytes, json.loads], ids=["text", "objects"])
@pytest.mark.parametrize("answer", ["3", "3.5"], ids=["right", "wrong"])
def test_answers_alone(load: Callable[[bytes], Any], answer: str) -> None:
    submission = load(document(record(), record(predObjId=answer, trajectory='[["hall", 99, 0]]')))
    predictions = read_predictions(submission, answers_only=True)
    assert list(predictions.instr_ids) == ["7_1_0", "7_1_0"]
    assert list(predictions.viewpoint_ids) == []
    assert predictions.offsets.tolist() == [0, 0, 0]
    assert predictions.predicted_object.tolist() == [3, 3 if answer == "3" else -1]
    assert not predictions.has_degrees
    assert len(predictions.problems) == (answer != "3")


def test_only_the_first_viewpoints_of_hops() -> None:
    trajectory = '[["hall"], ["bath", "loft"], ["hall", "bath"]]'
    whole = read_predictions(document(record(trajectory=trajectory), record(trajectory='[["a"]]')))
    cut = whole.first_of_hops()
    assert list(cut.viewpoint_ids) == ["hall", "bath", "hall", "a"]
    assert cut.offsets.tolist() == [0, 3, 4]
    assert places_of(cut) == [("[0]", [(0, 0), (1, 0), (2, 0)]), ("[1]", [(0, 0)])]
    assert hops_of(cut) == [False] * 4
    assert (whole.has_long_hops, cut.has_long_hops) == (True, False)
    poses = read_predictions(document(record()))
    assert poses.first_of_hops() is poses


def test_answers_alone_need_no_trajectory() -> None:
    content = document(without("trajectory"))
    assert not read_predictions(content, answers_only=True).problems
    assert [problem.message for problem in read_predictions(content).problems] == [
        "has no trajectory; add it"
    ]


@pytest.mark.parametrize("field", ["predObjID", "bbox"])
def test_a_task_without_objects_ignores_fields_that_resemble_an_answer(field: str) -> None:
    text = without("predObjId")[:-1] + f', "{field}": 3}}'
    predictions = read_predictions(document(text), find_task("r2r"))
    assert not predictions.problems
    assert predictions.ignored_fields == {field: 1}


@pytest.mark.parametrize("content", [b"[{}, {}, {}]", b"{}\n{}\n{}", b"{} {} {} and more"])
def test_more_records_than_any_split_has(content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reverie_eval.submissions._document.MAX_RECORDS", 2)
    (problem,) = problems_of(content)
    assert (problem.code, problem.where) == ("too-large", "file")
    assert problem.message == "holds more than 2 records; no split has that many episodes"


@pytest.mark.parametrize("content", [b"[[], [], []]", b"[1, 2, 3, 4, 5]", b'[{"a": 1, "b": [2]}]'])
def test_more_values_than_can_be_read(content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """A parsed value takes many times its bytes, so values are counted before parsing."""
    monkeypatch.setattr("reverie_eval.submissions._document.MAX_VALUES", 3)
    (problem,) = problems_of(content)
    assert (problem.code, problem.where) == ("too-large", "file")
    assert "values, more than the limit of 3" in problem.message


@pytest.mark.parametrize(
    ("content", "values"),
    [
        pytest.param(b"[[[[", 4, id="a value in each byte"),
        pytest.param(b'[{"a": 1}, 2]', 3, id="few values"),
    ],
)
def test_as_many_values_as_the_limit_are_read(content: bytes, values: int) -> None:
    check_value_count(content, values)
    message = f"about {values} values, more than the limit of {values - 1}"
    with pytest.raises(SubmissionError, match=message):
        check_value_count(content, values - 1)


@pytest.mark.parametrize("lane", ["text", "objects", "hops"])
def test_a_trajectory_longer_than_any_agent_walks(
    lane: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("official", "trajectories"):
        monkeypatch.setattr(f"reverie_eval.submissions._{module}.MAX_POSES", 2)
    pose: Any = ["a", 0.0, 0.0] if lane != "hops" else ["a"]
    records = [
        {"instr_id": "1_0", "trajectory": [pose] * 2, "predObjId": 1},
        {"instr_id": "1_1", "trajectory": [pose] * 3, "predObjId": 1},
    ]
    (problem,) = problems_of(records if lane == "objects" else json.dumps(records).encode())
    assert (problem.code, problem.where) == ("too-large", "[1].trajectory")
    assert "holds 3 elements, more than the 2" in problem.message


def test_reading_stops_after_too_many_problems(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reverie_eval.submissions._problems.MAX_PROBLEMS", 3)
    poses = b'[{"instr_id": "1_0", "predObjId": 1, "trajectory": [{}, {}, {}, {}, {}]}, {}]'
    for content, places in (
        (b"[1, 2, 3, 4, 5, 6]", ["[0]", "[1]", "[2]", "file"]),
        (poses, [f"[0].trajectory[{number}]" for number in range(3)] + ["file"]),
    ):
        found = problems_of(content)
        assert [problem.where for problem in found] == places
        assert found[-1].code == "too-many-problems"
        assert "has more than 3 problems; fix these" in found[-1].message
    assert len(problems_of(b"[1, 2, 3]")) == 3


X, Y = {"instr_id": "x", "predObjId": 3}, {"instr_id": "y", "predObjId": 4}


@pytest.mark.parametrize(
    ("document", "rows"),
    [
        pytest.param({"instr_id": ["x", "y"], "predObjId": [3, 4]}, [X, Y], id="lists"),
        pytest.param({"instr_id": ["x"], "predObjId": [3, 4]}, None, id="lists of other lengths"),
        pytest.param({"instr_id": ["x"], "predObjId": 3}, None, id="a list and a number"),
        pytest.param({"instr_id": ["x", "y"]}, None, id="one column"),
        pytest.param({"x": [1], "y": [2]}, None, id="columns of something else"),
        pytest.param(
            {"instr_id": {"1": "y", "0": "x"}, "predObjId": {"0": 3, "1": 4}},
            [Y, X],
            id="in the order of the first column",
        ),
        pytest.param({"instr_id": {"0": "x"}, "predObjId": {"1": 3}}, None, id="other rows"),
        pytest.param(
            {"columns": ["instr_id", "predObjId"], "data": [["x", 3], ["y", 4]]}, [X, Y], id="split"
        ),
        pytest.param({"columns": ["instr_id"], "data": ["x"]}, None, id="rows that are not lists"),
        pytest.param({"columns": ["instr_id"], "data": [["x", 3]]}, None, id="too long a row"),
        pytest.param({"columns": [7], "data": [["x"]]}, None, id="a name that is not text"),
    ],
)
def test_the_rows_of_a_table(document: dict[str, Any], rows: list[dict[str, Any]] | None) -> None:
    assert rows_of_table(document) == rows


@pytest.mark.parametrize(
    ("element", "message"),
    [
        pytest.param(
            ["hall", "1.5", "0.0"],
            "has angles written as text, such as ['hall', '1.5', ",
            id="text",
        ),
        pytest.param(
            {"viewpoint": "hall", "heading": 1.5, "elevation": 0},
            "has poses written as objects, such as {'elevation': 0, 'heading': 1.5, ",
            id="object",
        ),
        pytest.param(
            [7, 1.5, 0], "has viewpoints given as numbers, such as [7, 1.5, 0]; write", id="number"
        ),
    ],
)
def test_a_mistake_in_a_pose_is_shown(element: object, message: str) -> None:
    written = {**RECORDS[0], "trajectory": [["bath"], element]}
    predictions = read_predictions([written])
    (problem,) = predictions.problems
    assert problem.where == "[0].trajectory[1]"
    assert problem.message.startswith(message)
    expected = [None if element == [7, 1.5, 0] else "hall"]
    assert list(predictions.viewpoint_ids) == ["bath", *expected]


def test_a_pose_that_cannot_be_read_has_its_place() -> None:
    for element in (7, None, ["hall", math.nan, 0]):
        written = {**RECORDS[0], "trajectory": [["bath"], element]}
        predictions = read_predictions([written])
        assert predictions.pose_path(0, 1)[0] == 1
        assert len(predictions.problems) == 1


def test_poses_without_angles_are_counted_whatever_their_form() -> None:
    """Also the third part of a hop of three that looks like a heading."""
    log = ReadingLog()
    poses = [("bath", 1, 0), {"viewpoint": "hall"}, ["a", "b", "1"]]
    read_carefully([{**RECORDS[0], "trajectory": poses}], log)
    assert log.differences["no angles"] == 4


def test_the_angles_of_a_pose_written_as_an_object_are_its_own() -> None:
    pose = {"viewpoint": "hall", "elevation": 0.5, "heading": 1.0}
    record = {"instr_id": "1_7_0", "trajectory": [pose], "predBox": [1, 2, 3, 4]}
    assert read_predictions([record]).boxes.camera.tolist() == [[1.0, 0.5]]
