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
from typing import Any

import numpy as np
import pytest

from reverie_eval import ProtocolError, SubmissionError
from reverie_eval.submissions import (
    MAX_MEBIBYTES_VARIABLE,
    Submission,
    read_headings,
    read_predictions,
)
from reverie_eval.submissions._document import rows_of_table
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._records import read_carefully
from reverie_eval.submissions._sources import check_value_count
from reverie_eval.tasks import find_task
from tests.support.json_records import (
    Columns,
    columns_of,
    document,
    ending_in,
    hops_of,
    places_of,
    problems_of,
    record,
    without,
)

HUNDRED_THOUSAND = 100_000


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
            "Extra data, got '{}'; write",
            id="a list and an object",
        ),
        pytest.param(
            b"[{}]\n[{}, nul]", "not-json", "line 2, column 6", "Expecting", id="an unfinished null"
        ),
        pytest.param(b'[{"a": 1}', "not-json", "line 1, column 10", "cut short", id="cut off"),
        pytest.param(b'["a", "b]', "not-json", "line 1, column 7", "cut short", id="cut in a text"),
        pytest.param(b'["a", 1.', "not-json", "line 1, column 8", "cut short", id="number"),
        pytest.param(b'["a", nu', "not-json", "line 1, column 7", "cut short", id="word"),
        pytest.param(
            b"[1e5, .5]", "not-json", "line 1, column 7", "Expecting", id="no digit before point"
        ),
        pytest.param(b"[1, 2 ,\n ]", "not-json", "line 1, column 7", "closing ]; r", id="comma"),
        pytest.param(b'{"a": 1,}', "not-json", "line 1, column 8", "closing }", id="in an object"),
        pytest.param(
            b'{"a": ,}', "not-json", "line 1, column 7", "Expecting value, got ',}'", id="no value"
        ),
        pytest.param(
            b"[{}]\n[{}] t", "not-json", "line 2, column 6", "or an object, got 't'", id="no record"
        ),
        pytest.param(
            b'["a\nb"]',
            "not-json",
            "line 1, column 4",
            "Invalid control character, got '\\nb\"]'; write",
            id="line break in a text",
        ),
        pytest.param(b'["ok", "\xff"]', "not-json", "byte 8", "utf-8", id="invalid UTF-8"),
        pytest.param(b"PK\x03\x04", "damaged-zip", "file", "cut short", id="no zip"),
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
            json.dumps(['{"note": ' + "[" * HUNDRED_THOUSAND]).encode(),
            "wrong-type",
            "[0]",
            "expected an object with",
            id="brackets in a record within a text",
        ),
        pytest.param(
            gzip.compress(document(record()))[:-10],
            "damaged-gzip",
            "file",
            "cannot be unpacked (it was cut short); compress",
            id="truncated gzip",
        ),
        pytest.param(
            bytes(DAMAGED), "damaged-gzip", "file", "bytes are wrong", id="gzip with a wrong bit"
        ),
        pytest.param(
            gzip.compress(b"")[:10] + b"\xff" * 10,
            "damaged-gzip",
            "file",
            "bytes are wrong",
            id="gzip of nonsense",
        ),
        pytest.param(
            gzip.compress(b"") * 10_001,
            "damaged-gzip",
            "file",
            "more than 10,000 gzip members",
            id="gzip of many empty files",
        ),
        pytest.param(b"\x1f\x8b[{}]", "damaged-gzip", "file", "", id="no gzip but its first bytes"),
    ],
)
def test_a_file_that_is_no_submission(content: bytes, code: str, where: str, fragment: str) -> None:
    (problem,) = problems_of(content)
    assert (problem.code, problem.where) == (code, where)
    assert fragment in problem.message


def test_a_gzip_file_may_have_many_members() -> None:
    parts = [gzip.compress(b"")] * 9_999
    content = b"".join([*parts, gzip.compress(document(record()))])
    assert read_predictions(content).instr_ids == read_predictions(document(record())).instr_ids


@pytest.mark.parametrize(
    ("message", "position"),
    [
        pytest.param("Expecting value", 11, id="Python 3.12"),
        pytest.param("Illegal trailing comma before end of array", 8, id="Python 3.13"),
    ],
)
def test_a_trailing_comma_is_shown_where_it_is(
    message: str, position: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "[{},\n {}, \n]"

    def refuse(*_: object, **__: object) -> None:
        raise json.JSONDecodeError(message, text, position)

    monkeypatch.setattr(json, "loads", refuse)
    (problem,) = problems_of(text.encode())
    assert (problem.code, problem.where) == ("not-json", "line 2, column 4")


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
            "has a value in a list of one, such as [3]; write the value alone",
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
        pytest.param(
            record(predObjId='" 3"'),
            "wrong-type",
            ".predObjId",
            "has spaces or a line end around a value, such as ' 3'; remove them",
            id="blank 3",
        ),
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
        record(predObjId="true", instr_id="true"),
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


def test_an_id_of_eleven_digits_is_not_one() -> None:
    (problem,) = problems_of([{**RECORDS[0], "predObjId": "0" * 10 + "3"}])
    assert problem.message.startswith("got '00000000003'; expected an object id")


# Other ways of reading.


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
    poses = read_predictions(json.loads(document(record())))
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


@pytest.mark.parametrize("form", ["text", "objects", "hops"])
def test_a_trajectory_longer_than_any_agent_walks(
    form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("fast", "trajectories"):
        monkeypatch.setattr(f"reverie_eval.submissions._{module}.MAX_POSES", 2)
    pose: Any = ["a" * 32, 0.0, 0.0] if form != "hops" else ["a" * 32]
    records = [
        {"instr_id": "1_0", "trajectory": [pose] * 2, "predObjId": 1},
        {"instr_id": "1_1", "trajectory": [pose] * 3, "predObjId": 1},
    ]
    (problem,) = problems_of(records if form == "objects" else json.dumps(records).encode())
    assert (problem.code, problem.where) == ("too-large", "[1].trajectory")
    assert "holds 3 elements, more than the 2" in problem.message


def test_reading_stops_after_too_many_problems(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reverie_eval.submissions._faults.MAX_PROBLEMS", 3)
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
        assert predictions.pose_location(0, 1)[0] == 1
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


# Headings, which only pages of episodes need.


@pytest.mark.parametrize(
    ("trajectory", "headings"),
    [
        pytest.param([["a", 1.5, 0.0], ["b", -2, 0.1]], [1.5, -2], id="official"),
        pytest.param([["a", 0.0, 0.0], ["b", 3, 0.0]], [0, 3], id="some are 0"),
        pytest.param([["a", 0.0, 0.0], ["b", 0, 0.0]], [], id="all are 0"),
        pytest.param([["a"], ["b"]], [], id="viewpoints alone"),
        pytest.param([["a", 1.5, 0.0], ["b"]], [1.5, None], id="one without"),
    ],
)
@pytest.mark.parametrize("is_keyed", [False, True])
def test_headings(trajectory: list[Any], headings: list[float | None], is_keyed: bool) -> None:  # noqa: FBT001
    other = {"instr_id": "1_1_0", "trajectory": [["a", 9, 9]], "predObjId": 1}
    wanted = {"instr_id": "1_1_1", "trajectory": trajectory, "predObjId": 1}
    records: Any = [other, wanted]
    if is_keyed:
        records = {each.pop("instr_id"): each for each in (other, wanted)}
    content = json.dumps(records).encode()
    assert [*read_headings(content, "1_1_1")] == headings
    assert [*read_headings(content, "1_1_2")] == []
