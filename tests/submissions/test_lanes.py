"""The fast lane and the careful one read a submission to the same columns."""

import json
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from reverie_eval import SubmissionError
from reverie_eval.submissions import (
    convert,
    read_predictions,
)
from reverie_eval.submissions._document import parse_document
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._official import decode_official
from reverie_eval.submissions._records import read_carefully
from reverie_eval.tasks import find_task
from tests.conftest import SAMPLES
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


@settings(max_examples=200)
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


@settings(max_examples=200)
@given(content=damaged_documents() | st.binary())
def test_bytes_are_read_or_rejected(content: bytes) -> None:
    """Anything but a rejection would be our own error, and fail here."""
    for problem in problems_of(content):
        assert problem.message


@settings(max_examples=200)
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


@settings(max_examples=200)
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
