"""The fast reader and the careful one give the same columns, notes and locations."""

import json
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from reverie_eval import SubmissionError
from reverie_eval.ground_truth import ViewpointTable
from reverie_eval.submissions import (
    convert,
    read_predictions,
)
from reverie_eval.submissions._document import parse_document
from reverie_eval.submissions._fast import read_fast
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._records import read_carefully
from reverie_eval.tasks import find_task
from tests.conftest import SAMPLES
from tests.support.amounts import amount
from tests.support.both_readers import edited, read_by_both, small_files, viewpoints_in
from tests.support.forms import FORMS
from tests.support.json_records import (
    RIGHT,
    Columns,
    boxes_of,
    columns_of,
    document,
    ending_in,
    hops_of,
    places_of,
    problems_of,
    record,
    without,
)

NUMBERS = ["0", "-0", "-1", "3", "3.0", "3e0", "1.", "01", "1e400", "9" * 400, str(2**31), "NaN"]
STRANGE = ["null", "true", "{}", "[]", '"', '"a\nb"', '"\\ud800"', '"\\u00e4"', '"a:b"', '[["a"]]']

names = (st.text(max_size=3) | st.sampled_from(["reverie_", "reverie_7_1_0"])).map(json.dumps)
ids = st.sampled_from([f'"{digit * 32}"' for digit in "0af"])
angles = st.integers().map(str) | st.floats(allow_nan=False, allow_infinity=False).map(repr)
texts = st.sampled_from([*NUMBERS, *STRANGE]) | names | angles
fields = st.sampled_from(list(RIGHT))
box_fields = st.sampled_from(["predBox", "predView", "predImageSize"])
poses = st.builds("[{}, {}, {}]".format, ids, angles, angles)
right_poses = st.builds("[{}, {}, 0.5]".format, ids, st.sampled_from(["0", "-1.5", "2e-5"]))
hops = st.lists(ids | ids.map(lambda name: f"{name}, {name}"), max_size=2).map(
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


right_records = right_records_of(poses) | right_records_of(right_poses)
records_of_hops = right_records_of(hops)
bare_records = right_records_of(ids)
other_poses = st.one_of(
    ids,
    ids.map("[{}]".format),
    names,
    st.just("[]"),
    names.map("[{}]".format),
    names.map("[{}, 1.5, 0]".format),
    st.builds("[{}, {}]".format, names, names),
)
other_answers = st.sampled_from(['"3"', '"None"', '""', '"-1"', '"owl"'])
other_records = st.one_of(
    st.builds(
        lambda poses, answer: record(trajectory=f"[{', '.join(poses)}]", predObjId=answer),
        st.lists(other_poses, max_size=3),
        other_answers,
    ),
    other_answers.map(lambda answer: without("predObjId")[:-1] + f', "pred_objid": {answer}}}'),
    st.builds(
        lambda answer, second: f'{record(predObjId=answer)[:-1]}, "pred_objid": {second}}}',
        right_answers | st.just("null"),
        other_answers | st.just("null"),
    ),
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
    poses | right_poses,
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
forms = st.sampled_from([right_records, records_of_hops, bare_records, box_records])
right_lists = forms.flatmap(lambda right: st.lists(right, min_size=1, max_size=4)).map(
    lambda records: document(*records)
)
lists = forms.flatmap(
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
documents = right_lists | lists | keyed


@st.composite
def damaged_documents(draw: st.DrawFn) -> bytes:
    """Draw a document with a few bytes replaced by others."""
    content = draw(documents)
    begin = draw(st.integers(0, len(content)))
    end = draw(st.integers(begin, min(begin + 3, len(content))))
    return content[:begin] + draw(st.binary(max_size=3)) + content[end:]


A, B = f'"{"a" * 32}"', f'"{"b" * 32}"'


def boxed(**fields: str) -> str:
    """Return the text of a record that answers by box."""
    return record(**{"predObjId": "-1", "predBox": "[1, 2, 3.5, 4]"} | fields)


RIGHT_RECORD = record(trajectory=f"[[{A}, 1.5, 0]]")
TASKS = ("reverie", "ndh", "r2r", "r4r", "rxr", "soon")


@settings(max_examples=amount(120))
@given(
    content=documents | damaged_documents(),
    task=st.just("reverie") | st.sampled_from(TASKS),
    answers_only=st.booleans(),
    piece=st.sampled_from([1, 100, 1 << 16]),
)
def test_the_fast_reader_declines_or_agrees(
    content: bytes, task: str, *, answers_only: bool, piece: int
) -> None:
    """However many bytes it reads at once."""
    with patch("reverie_eval.submissions._fast._PIECE", piece):
        is_taken = read_by_both(content, find_task(task), answers_only=answers_only)
    event("taken" if is_taken else "declined")


@pytest.mark.parametrize("name", list(small_files()))
def test_a_byte_more_or_less_is_declined_or_read_alike(name: str) -> None:
    """In a file of every form, and with every mistake that people make."""
    content, task = small_files()[name]
    read_by_both(content, task)
    for changed in edited(content, 20, seed=name):
        read_by_both(changed, task)


@pytest.mark.parametrize("name", list(FORMS))
@pytest.mark.parametrize("piece", [1, 1 << 16])
def test_every_form_is_read_fast(name: str, piece: int) -> None:
    with patch("reverie_eval.submissions._fast._PIECE", piece):
        assert read_by_both(FORMS[name].bytes(), find_task("reverie"))


@pytest.mark.parametrize("name", TASKS)
def test_every_task_is_read_fast(name: str) -> None:
    sample = SAMPLES / ("good.json" if name == "reverie" else f"{name}.json")
    task = find_task(name)
    assert read_by_both(sample.read_bytes(), task)
    lines = b"\n".join(json.dumps(each).encode() for each in json.loads(sample.read_bytes()))
    # An item has several trajectories, which the fast reader takes apart in a list alone.
    assert read_by_both(lines, task) != task.has_items


@pytest.mark.parametrize(
    ("old", "new"),
    [
        pytest.param(b"_1", b"\n1", id="a line end in a text"),
        pytest.param(b"], [", b"]\n[", id="a line end for a comma"),
        pytest.param(b"}\n{", b"},\n{", id="a comma between lines"),
    ],
)
def test_a_line_is_a_record(old: bytes, new: bytes) -> None:
    line = record(instr_id='"1196_1"', trajectory=f"[[{A}, 1.5, 0], [{B}, 1.5, 0]]")
    content = f"{line}\n{line}".encode()
    assert read_by_both(content, find_task("rxr"))
    assert not read_by_both(content.replace(old, new, 1), find_task("rxr"))


@pytest.mark.parametrize(
    "between", [",", " ,\n\t", ",,", "", ",\x0b", "}, {", "], [", '"}, {"', ', {"note": "}, {"}, ']
)
def test_a_list_is_cut_between_records_only(between: str) -> None:
    """Whatever is between records: the reader cuts here after each record."""
    content = f"[{RIGHT_RECORD}{between}{RIGHT_RECORD}]".encode()
    with patch("reverie_eval.submissions._fast._PIECE", 1):
        is_taken = read_by_both(content, find_task("reverie"))
    assert is_taken == (between.strip(" \n\t") == ",")


@settings(max_examples=amount(80))
@given(content=damaged_documents() | st.binary())
def test_bytes_are_read_or_rejected(content: bytes) -> None:
    """Anything but a rejection would be our own error, and fail here."""
    for problem in problems_of(content):
        assert problem.message


@settings(max_examples=amount(80))
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


@settings(max_examples=amount(80))
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


@settings(max_examples=amount(80))
@given(content=documents)
def test_the_careful_reader_reads_common_forms_as_it_reads_others(content: bytes) -> None:
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


def test_hops_by_the_fast_reader() -> None:
    content = document(
        record(trajectory=f"[[{A}], [], [{B}, {A}]]", predObjId='"3"'),
        record(instr_id='"7_1_1"', trajectory=f"[[{B}], [{B}, 1, 2.5, 3], [{A}]]"),
    )
    predictions = read_fast(content, find_task("reverie"), viewpoints_in(content))
    assert predictions is not None
    assert columns_of(predictions) == Columns(
        ["7_1_0", "7_1_1"],
        [(A, B)[each == "b"][1:-1] for each in "ababba"],
        [0, 3, 6],
        [3, 3],
        has_degrees=False,
    )
    assert places_of(predictions) == [
        ("[0]", [(0, 0), (2, 0), (2, 1)]),
        ("[1]", [(0, 0), (1, 0), (2, 0)]),
    ]
    assert hops_of(predictions) == [False, False, True, False, False, False]


@pytest.mark.parametrize(
    ("text", "is_taken"),
    [
        pytest.param(record(predObjId=f'"{2**31 - 1}"'), True, id="largest object as text"),
        pytest.param(record(predObjId=f'"{2**31}"'), False, id="larger object as text"),
        pytest.param(record(predObjId='"03"'), True, id="leading zero"),
        pytest.param(record(predObjId="true"), False, id="boolean"),
        pytest.param(record(trajectory='[["7", 1.5, 0]]'), False, id="no viewpoint id"),
        pytest.param(record(trajectory=f"[[{A}, 1.5, 0] ]"), True, id="space between brackets"),
        pytest.param(record(trajectory=f"[[{A}], []]"), True, id="empty hop"),
        pytest.param(record(trajectory=f"[[{A}], [5]]"), False, id="a number alone"),
        pytest.param(record(trajectory=f"[[{A}], 5]"), False, id="a number among hops"),
        pytest.param(record(trajectory=f"[5, {A}]"), False, id="a number before a bare viewpoint"),
        pytest.param(record(trajectory=f"[{A}, [{A}]]"), False, id="bare, and in a list"),
        pytest.param(record(trajectory=f"[[[{A}]]]"), False, id="nested too deeply"),
        pytest.param(record(trajectory=f"[[{A}, 1]]"), False, id="one angle"),
        pytest.param(record(trajectory=f"[[1, {A}, 2]]"), False, id="an angle first"),
        pytest.param(record(trajectory=f"[[{A}, true, null]]"), False, id="no numbers"),
        pytest.param(record(trajectory=f"[[{A}, 1e400, 0]]"), False, id="infinite"),
        pytest.param(record(trajectory=f"[[{A}, {'9' * 400}, 0]]"), False, id="a long number"),
        pytest.param(record(trajectory=f"[[{A}, 1e-400, 0]]"), True, id="nearly zero"),
        pytest.param(record(trajectory=f"[[{A}, 30.5, 0]]"), True, id="degrees"),
        pytest.param(record(trajectory=f"[[{A}, 6.25, 0]]"), True, id="nearly a full turn"),
        pytest.param(record(trajectory=f"[[{A}, 6.5, 0]]"), True, id="more than a full turn"),
        pytest.param(record(trajectory=f"[[{A}, 90, 0], []]"), False, id="degrees, empty hop"),
        pytest.param(record(trajectory="[[]]"), False, id="empty hop only"),
        pytest.param(record(trajectory="[]"), False, id="no pose"),
        pytest.param(record(instr_id='"reverie_7_1_0"'), True, id="prefix"),
        pytest.param(record(note=r'"\u00e4: {\"a\": 1}"'), True, id="a field more"),
        pytest.param(record(note='{"predObjId": 5, "a": [{"b": 1}]}'), True, id="objects in it"),
        pytest.param(record(note="9" * 4400), False, id="a number that Python refuses"),
        pytest.param(record(path="1"), True, id="another spelling beside the field"),
        pytest.param(record(objId="1"), False, id="another spelling of an answer"),
        pytest.param(record(predBox="null"), True, id="null box"),
        pytest.param(record(predBox="[1, 2, 3, 4]"), False, id="box beside an object"),
        pytest.param(boxed(), True, id="box"),
        pytest.param(boxed(predView="35"), True, id="box in a view"),
        pytest.param(boxed(predView="36"), False, id="box in a view that there is not"),
        pytest.param(boxed(predView="12.0"), False, id="box in a view that is no whole number"),
        pytest.param(boxed(predView="null", predImageSize="[320, 480]"), True, id="scaled box"),
        pytest.param(boxed(predImageSize="[0.5, 480]"), False, id="box in an image without width"),
        pytest.param(boxed(predObjId="null"), True, id="box beside null"),
        pytest.param(boxed(predObjId='"None"'), True, id="box beside an abstention"),
        pytest.param(boxed(predBox="[1, 2, 0, 4]"), False, id="box without width"),
        pytest.param(boxed(predBox="[1, 2, 3]"), False, id="box of three numbers"),
        pytest.param(boxed(predBox="[1, 2, 3, 1e400]"), False, id="infinite box"),
        pytest.param(boxed(predBox="[1e308, 2, 1e308, 4]"), True, id="box outside"),
        pytest.param(boxed(trajectory=f"[[{A}]]"), False, id="box without a camera"),
        pytest.param(boxed(trajectory=f"[[{A}, 1, 1.6]]"), False, id="box from upside down"),
        pytest.param(boxed(trajectory=f"[[{A}, 90, 1.5, 7], []]"), False, id="box, empty hop"),
        pytest.param(f'{RIGHT_RECORD[:-1]}, "predObjId": 3}}', False, id="a field twice"),
        pytest.param(f'{RIGHT_RECORD[:-1]}, "pred\\u004fbjId": 3}}', False, id="twice, escaped"),
    ],
)
def test_what_the_fast_reader_takes(text: str, *, is_taken: bool) -> None:
    text = text.replace('[["hall", 1.5, 0]]', f"[[{A}, 1.5, 0]]")
    assert read_by_both(document(text, text), find_task("reverie")) == is_taken


@pytest.mark.parametrize(
    ("one", "other"),
    [
        pytest.param(f"[[{A}, 1], [{A}, 1, 0, 5]]", f"[[{B}, 1, 0]]", id="a number, in a record"),
        pytest.param(f"[[{A}, 1]]", f"[[{B}, 1, 0, 5]]", id="a number, between records"),
        pytest.param(f"[[1, {A}, 0]]", f"[[{B}, 1, 0]]", id="an angle before an id"),
        pytest.param(f"[[{A}, [1, 0], {B}, 1, 0]]", f"[[{B}, 1, 0]]", id="a pose within a pose"),
        pytest.param(f"[[{A}, 1, 0], {B}, [1, 0]]", f"[[{B}, 1, 0]]", id="a pose without a list"),
        pytest.param(f"[[{A}, 1, 0, [{A}, 1, 0]]]", f"[[{B}, 1, 0]]", id="a pose ends another"),
        pytest.param(f"[[[{A}, 1, 0]], [{A}, 1, 0]]", f"[{B}, 1, 0]", id="between records"),
        pytest.param(f'[[{A[:-1]} , 1", 0]]', f"[[{B}, 1, 0]]", id="a comma in a text"),
        pytest.param(r'[["a\"b", 1, 0]]', f"[[{B}, 1, 0]]", id="a quote in a text"),
        pytest.param(
            f"[[{A}, 1, 0] ]", f"[[[{A}, 1e-5, 0]], [[{B}, 1E5, 0]]]", id="ends of trajectories"
        ),
        pytest.param(f"[[{A}, {'9' * 400}, 0]]", f"[[{B}, 1, 0]]", id="a long number first"),
        pytest.param(f"[[{A}, 1, 0]]", f"[[{B}, 1, {'9' * 400}]]", id="a long number last"),
        pytest.param(f"[[{A}], [[{A}]]]", f"[[{B}] ]", id="ends of trajectories of hops"),
        pytest.param(f"[{A}, []]", f"[{B}]", id="an empty hop among bare viewpoints"),
        pytest.param(f"[[{A}], [5], []]", f"[[{B}], [ ]]", id="a number and an empty hop"),
    ],
)
def test_no_fault_hides_another(one: str, other: str) -> None:
    """Though both records together have as many marks as right ones have."""
    content = document(record(trajectory=one), record(instr_id='"7_1_1"', trajectory=other))
    assert not read_by_both(content, find_task("reverie"))


@pytest.mark.parametrize(
    ("viewpoint_id", "angle"),
    [
        pytest.param("room-e-0000000000000000000000000", "1E400", id="like an exponent"),
        pytest.param("\\" * 32, "1", id="escaped in the file"),
    ],
)
def test_ids_of_other_letters_are_declined(viewpoint_id: str, angle: str) -> None:
    content = document(record(trajectory=f'[[{A}, {angle}, 0], ["{viewpoint_id}", 1, 0]]'))
    table = ViewpointTable([A.strip('"'), viewpoint_id])
    assert read_fast(content, find_task("reverie"), table) is None


def test_an_item_without_trajectories_is_declined() -> None:
    items = json.loads((SAMPLES / "soon.json").read_bytes())[:2]
    content = json.dumps([{**items[0], "trajectory": []}, items[1]]).encode()
    assert not read_by_both(content, find_task("soon"))


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
def test_the_careful_reader_reads_a_trajectory(
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
def test_the_careful_reader_reads_an_answer(
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
