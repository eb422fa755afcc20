"""Every problem has its code, its place and its offender; the wording of all is in problems.txt."""

import ast
from pathlib import Path
from string import Formatter
from sys import maxsize
from typing import Any

import numpy as np
import pytest

from reverie_eval import Problem
from reverie_eval.errors import SHOWN_PROBLEMS
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._faults import Fault
from reverie_eval.submissions._problems import RecordLocation, Template
from reverie_eval.tasks import find_task
from tests.conftest import REPOSITORY

REVERIE, NDH, R2R, SOON = map(find_task, ("reverie", "ndh", "r2r", "soon"))
RECORD = RecordLocation(3)
START = "4bc21ec71c2eb1724484d2974c46412c"
KEYED = RecordLocation(3, "7_1_0")
OF_AN_ITEM = RecordLocation(3, trajectory=2)
POSE_FORM = "[viewpoint_id, heading, elevation]"
WORDING = Path(__file__).with_name("problems.txt")
"""A line for each of PROBLEMS and each fault, as a participant reads it."""

PROBLEMS = [
    # problem, code, place, what the message must show of the file
    (
        problems.NOT_JSON.of_file("line 3, column 1", reason="Extra data", found="# done"),
        "not-json",
        "line 3, column 1",
        ["Extra data", "# done"],
    ),
    (problems.CUT_SHORT.of_file("line 3, column 1"), "not-json", "line 3, column 1", []),
    (
        problems.COMMA_AT_END.of_file("line 3, column 1", bracket="]"),
        "not-json",
        "line 3, column 1",
        ["closing ]"],
    ),
    (problems.NOT_A_LITERAL.of_file(), "not-json", "file", []),
    (
        problems.OTHER_RELEASE.of_file(
            found=3_433, release="v2", split="val_unseen", own="v1", expected=3_521
        ),
        "other-release",
        "file",
        ["3,433", "v2", "v1", "3,521", "val_unseen"],
    ),
    (problems.ANOTHER_KIND.of_file(kind="a web page"), "not-json", "file", ["a web page"]),
    (problems.HUGE_NUMBER.of_file(), "not-json", "file", ["2,147,483,647"]),
    (problems.TOO_DEEP.of_file(), "too-deep", "file", []),
    (problems.TOO_LARGE.of_file(mebibytes=3), "too-large", "file", ["3 MiB"]),
    (
        problems.TOO_LARGE_FOR_NOW.of_file(mebibytes=4, variable="MAX_SIZE"),
        "too-large",
        "file",
        ["4 MiB", "MAX_SIZE"],
    ),
    (problems.TOO_MUCH_TIME.of_file(seconds=20), "too-large", "file", ["20 seconds"]),
    (problems.TOO_MUCH_MEMORY.of_file(mebibytes=2_000), "too-large", "file", ["2,000 MiB"]),
    (problems.TOO_MANY_RECORDS.of_file(limit=200_000), "too-large", "file", ["200,000 records"]),
    (
        problems.TOO_MANY_VALUES.of_file(found=4_000, limit=3_000),
        "too-large",
        "file",
        ["4,000", "3,000"],
    ),
    (problems.TOO_MANY_PROBLEMS.of_file(limit=10_000), "too-many-problems", "file", ["10,000"]),
    (problems.DAMAGED_GZIP.of_file(reason="CRC"), "damaged-gzip", "file", ["CRC"]),
    (problems.DAMAGED_ZIP.of_file(reason="CRC"), "damaged-zip", "file", ["CRC"]),
    (problems.NOT_ONE_FILE.of_file(found="no file"), "several-files", "file", ["no file"]),
    (
        problems.NOT_A_LIST.of_file(found=17, record=problems.official_form(REVERIE)),
        "not-a-list",
        "file",
        ["17", "predObjId"],
    ),
    (
        problems.NOT_A_LIST.of_file(found=17, record=problems.official_form(NDH)),
        "not-a-list",
        "file",
        ["inst_idx"],
    ),
    (
        problems.NOT_A_LIST.of_file(found=17, record=problems.official_form(SOON)),
        "not-a-list",
        "file",
        ["obj_heading"],
    ),
    (problems.UNDECLARED_NAVIGATION_ONLY.of_file(), "navigation-only", "file", []),
    (problems.DECLARED_NAVIGATION_ONLY.of_file(), "navigation-only", "file", []),
    (
        problems.BOXES_OUTSIDE.of_file(count=1_200, total=2_000),
        "wrong-scale",
        "file",
        ["1,200 of its 2,000"],
    ),
    (
        problems.TINY_BOXES.of_file(count=1_200, total=2_000),
        "wrong-scale",
        "file",
        ["1,200 of its 2,000"],
    ),
    (problems.NO_ANSWERS.of_file(), "missing-field", "file", []),
    (
        problems.NO_EPISODE_OF_SPLIT.of_file(expected=3_521, split="test"),
        "missing-episode",
        "file",
        ["3,521", "test"],
    ),
    (
        problems.MISSING_EPISODE.of_file(instr_id="7_1_0", split="test", start=START),
        "missing-episode",
        "file",
        ["7_1_0", "test", START],
    ),
    (
        problems.MISSING_EPISODES.of_file(
            count=4, expected=3_521, split="test", examples="a, b, c and 1 more", points=0.1136
        ),
        "missing-episode",
        "file",
        ["4 of the 3,521", "a, b, c", "0.1 points lost in all", "--episodes-from"],
    ),
    (
        problems.ids_of_another_task(1, "5_0", REVERIE, [R2R]),
        "other-task",
        "file",
        ["1 id looks", "'5_0'", "--task r2r"],
    ),
    (
        problems.ids_of_another_task(1_200, "5_0", REVERIE, [R2R, NDH]),
        "other-task",
        "file",
        ["1,200 ids look", "R2R or NDH"],
    ),
    (
        problems.RESULTS_OF_ANOTHER_TASK.of_file(
            task=REVERIE, other=NDH, sign="their ids are in 'inst_idx'"
        ),
        "other-task",
        "file",
        ["NDH", "'inst_idx'"],
    ),
    (
        problems.IDS_OUTSIDE_DEMO.of_file(
            count=1_200, first="1_2_0", split="test", task=REVERIE, option=""
        ),
        "not-the-demo-world",
        "file",
        ["1,200", "'1_2_0'"],
    ),
    (
        problems.IDS_OUTSIDE_DEMO.of_file(
            count=2, first="9", split="test", task=NDH, option="--task ndh "
        ),
        "not-the-demo-world",
        "file",
        ["'9'", "--task ndh --split"],
    ),
    (
        problems.BUILDINGS_OUTSIDE_DEMO.of_file(
            count=89, total=90, split="test", task=REVERIE, option=""
        ),
        "not-the-demo-world",
        "file",
        ["89 of 90", "REVERIE --split test"],
    ),
    (problems.REPEATED_KEY.of_file(key="7_1_0"), "repeated-field", "file", ["'7_1_0'"]),
    (
        problems.POSITIONS.of_file(count=40, paths="42 paths", example=[1.5, 0.1, -2.5]),
        "continuous-environment",
        "file",
        ["40 of its 42", "[1.5, 0.1, -2.5]"],
    ),
    (
        problems.OTHER_BUILDINGS.of_file(count=40, total=1_200, split="test"),
        "other-scan",
        "file",
        ["40 of 1,200"],
    ),
    (
        problems.results_of_other_splits({"test": 1}, "val_unseen", RECORD, "7_1_0"),
        "other-split",
        "[3].instr_id",
        ["test (1 record)", "'7_1_0'", "as test"],
    ),
    (
        problems.results_of_other_splits(
            {"train": 1_200, "test": 2}, "val_unseen", RECORD, "7_1_0"
        ),
        "other-split",
        "[3].instr_id",
        ["train (1,200 records) and test (2 records)"],
    ),
    (
        problems.WRONG_TYPE.of_record(RECORD, found=7, expected="an object"),
        "wrong-type",
        "[3]",
        ["got 7", "an object"],
    ),
    (
        problems.WRONG_TYPE.of_record(RECORD, ".predObjId", found=np.zeros(2), expected="a number"),
        "wrong-type",
        "[3].predObjId",
        ["array([0., 0.])", ".tolist()"],
    ),
    (
        problems.REPEATED_FIELD.of_record(RECORD, field="predObjId"),
        "repeated-field",
        "[3]",
        ["predObjId"],
    ),
    (
        problems.DUETS_EPISODES.of_record(RECORD, instr_id="1-2_3"),
        "unknown-episode",
        "[3].instr_id",
        ["'1-2_3'"],
    ),
    (
        problems.KEY_MISMATCH.of_record(KEYED, instr_id="8_1_0", key="7_1_0"),
        "key-mismatch",
        '["7_1_0"].instr_id',
        ["'8_1_0'", "'7_1_0'"],
    ),
    (
        problems.MISSING_FIELD.of_record(RECORD, field="trajectory"),
        "missing-field",
        "[3]",
        ["trajectory"],
    ),
    (
        problems.UNKNOWN_EPISODE.of_record(RECORD, instr_id="9_9_9", split="test", task=REVERIE),
        "unknown-episode",
        "[3].instr_id",
        ["'9_9_9'", "test"],
    ),
    (
        problems.DUPLICATE_EPISODE.of_record(RECORD, instr_id="7_1_0", first=RecordLocation(1)),
        "duplicate-episode",
        "[3].instr_id",
        ["7_1_0", "[1]"],
    ),
    (
        problems.CHANGED_PREDICTION.of_record(RECORD, instr_id="7_1_0"),
        "duplicate-episode",
        "[3].instr_id",
        ["7_1_0"],
    ),
    (problems.EMPTY_TRAJECTORY.of_record(RECORD), "empty-trajectory", "[3].trajectory", []),
    (
        problems.TOO_MANY_POSES.of_record(RECORD, found=30_000, limit=20_000),
        "too-large",
        "[3].trajectory",
        ["30,000", "20,000"],
    ),
    (problems.NO_ANSWER.of_record(RECORD), "missing-field", "[3]", ["predObjId", "predBox"]),
    (
        problems.TWO_ANSWERS.of_record(RECORD, ".pred_objid", found=4, key="pred_objid"),
        "two-answers",
        "[3].pred_objid",
        ["got 4", "set pred_objid"],
    ),
    (
        problems.BOX_NOT_FINITE.of_record(RECORD, found=[1, 2]),
        "not-finite",
        "[3].predBox",
        ["[1, 2]"],
    ),
    (problems.EMPTY_BOX.of_record(RECORD, found=[1, 2]), "empty-box", "[3].predBox", ["[1, 2]"]),
    (
        problems.WRONG_VIEW.of_record(RECORD, found=np.array(36)),
        "wrong-view",
        "[3].predView",
        ["array(36)", ".item()"],
    ),
    (problems.NO_VIEW.of_record(RECORD), "missing-field", "[3]", ["predView"]),
    (
        problems.NO_VIEW_NOR_POSE.of_record(RECORD),
        "missing-field",
        "[3]",
        ["predView", "last pose"],
    ),
    (
        problems.UPSIDE_DOWN.of_pose(RECORD, (4,), elevation=30.0),
        "wrong-camera",
        "[3].trajectory[4]",
        ["30.0"],
    ),
    (
        problems.HALF_A_POINT.of_record(RECORD),
        "wrong-type",
        "[3]",
        ["obj_heading", "obj_elevation"],
    ),
    (
        problems.WRONG_POSE.of_pose(RECORD, (4, 0), found=np.zeros(1)),
        "wrong-type",
        "[3].trajectory[4][0]",
        ["array([0.])", ".item()"],
    ),
    (
        problems.NOT_FINITE.of_pose(RECORD, (4,), found=["hall", 1, 2]),
        "not-finite",
        "[3].trajectory[4]",
        ["['hall', 1, 2]"],
    ),
    (
        problems.UNKNOWN_VIEWPOINT.of_pose(RECORD, (4,), viewpoint_id="cellar", scan="house"),
        "unknown-viewpoint",
        "[3].trajectory[4]",
        ["'cellar'", "house"],
    ),
    (
        problems.VIEWPOINT_OF_ANOTHER_SCAN.of_pose(
            RECORD, (4,), viewpoint_id="loft", scan="house", other_scan="barn"
        ),
        "other-scan",
        "[3].trajectory[4]",
        ["loft", "barn", "house"],
    ),
    (
        problems.WRONG_START.of_pose(RECORD, (0,), instr_id="7_1_0", expected="hall", found="loft"),
        "wrong-start",
        "[3].trajectory[0]",
        ["7_1_0", "viewpoint hall", "got loft"],
    ),
    (
        problems.WRONG_START_OF_ITEM.of_pose(
            OF_AN_ITEM, (0,), instr_id="7#2", expected="hall", found="loft"
        ),
        "wrong-start",
        "[3].trajectory[2].path[0]",
        ["7#2", "viewpoint hall", "got loft"],
    ),
    (
        problems.UNREACHABLE.of_pose(RECORD, (4,), viewpoint_id="attic"),
        "unreachable",
        "[3].trajectory[4]",
        ["attic"],
    ),
]


@pytest.mark.parametrize(
    ("problem", "code", "where", "shown"),
    [pytest.param(*row, id=f"{row[1]} {row[0].message[:40]}") for row in PROBLEMS],
)
def test_a_problem(problem: Problem, code: str, where: str, shown: list[str]) -> None:
    assert (problem.code, problem.where) == (code, where)
    assert [each for each in shown if each not in problem.message] == []


@pytest.mark.parametrize(
    ("problem", "position"),
    [
        pytest.param(problems.TOO_DEEP.of_file(), (), id="file"),
        pytest.param(problems.NO_ANSWER.of_record(KEYED), (3,), id="record"),
        pytest.param(
            problems.UNREACHABLE.of_pose(RECORD, (4, 0), viewpoint_id="a"), (3, 4, 0), id="pose"
        ),
    ],
)
def test_problems_are_sorted_by_where_they_are(problem: Problem, position: tuple[int, ...]) -> None:
    assert problem.position == position


def test_the_wording() -> None:
    """A changed sentence is a changed line of problems.txt; pytest shows both."""
    found = {name: each for name, each in vars(faults).items() if isinstance(each, Fault)}
    lines = [f"{problem.where}: {problem.message}" for problem, *_ in PROBLEMS]
    lines += [f"{each.code}: {each.problem(1_200, '', (), 'x').message}" for each in found.values()]
    assert lines == WORDING.read_text("utf-8").splitlines()


def test_every_kind_of_problem_is_in_the_table() -> None:
    templates = {
        each.message: name for name, each in vars(problems).items() if isinstance(each, Template)
    }
    shown = "\n".join(problem.message for problem, *_ in PROBLEMS)
    parts = {name: Formatter().parse(message) for message, name in templates.items()}
    literal = {name: max((text for text, *_ in each), key=len) for name, each in parts.items()}
    assert [name for name, text in literal.items() if text not in shown] == []


def test_each_call_gives_a_template_the_values_that_it_names() -> None:
    """A value that is missing would fail only when somebody makes the mistake."""
    source = REPOSITORY / "reverie_eval" / "submissions"
    nodes = (node for file in source.glob("*.py") for node in ast.walk(ast.parse(file.read_text())))
    wrong = []
    for call in nodes:
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute)):
            continue
        template = getattr(problems, getattr(call.func.value, "attr", ""), None)
        if isinstance(template, Template):
            fields = [field for _, field, *_ in Formatter().parse(template.message) if field]
            named = {field.partition(".")[0] for field in fields}
            wrong += [template] if named != {keyword.arg for keyword in call.keywords} else []
    assert wrong == []


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        pytest.param(None, "null", id="nothing"),
        pytest.param(True, "true", id="true"),
        pytest.param(False, "false", id="false"),
        pytest.param(10**5000, "an integer with thousands of digits", id="thousands of digits"),
        pytest.param([[[1]]], "[[[...]]]", id="nested lists"),
        pytest.param([1, 2, 3, 4, 5], "[1, 2, 3, 4, ...]", id="long list"),
        pytest.param({"a": 1, "b": 2, "c": 3}, "{'a': 1, 'b': 2, ...}", id="large object"),
        pytest.param("x" * 58, f"'{'x' * 58}'", id="60 letters with its quotes"),
        pytest.param("x" * 59, f"'{'x' * 27}...{'x' * 28}'", id="longer text"),
    ],
)
def test_a_value_is_shown_in_a_line(value: object, shown: str) -> None:
    message = problems.WRONG_TYPE.text(found=value, expected="a number")
    assert message == f"got {shown}; expected a number"


def test_an_array_is_shown_in_a_line_too() -> None:
    message = problems.WRONG_TYPE.text(found=np.zeros((2, 1)), expected="a number")
    assert message == "got array([[0.], [0.]]); expected a number; use .tolist()"


@pytest.mark.parametrize(
    ("found", "remedy"),
    [
        pytest.param([np.array(1), np.float64(2), "a"], "; use .item()", id="one in a list"),
        pytest.param((np.array([1]), np.array(2)), "; use .item()", id="two of a number each"),
        pytest.param([np.array([1]), np.zeros((1, 2))], "; use .tolist()", id="of two numbers"),
        pytest.param(np.zeros(0), "; use .tolist()", id="empty"),
        pytest.param(np.float64(2), "", id="number of numpy's"),
    ],
)
def test_the_remedy_for_arrays(found: object, remedy: str) -> None:
    assert problems.WRONG_POSE.text(found=found).endswith(f"{POSE_FORM}{remedy}")


def wrong_type(location: RecordLocation, found: object, expected: str, field: str) -> Problem:
    return problems.WRONG_TYPE.of_record(location, f".{field}", found=found, expected=expected)


def test_a_mistake_that_many_records_share_is_one_problem() -> None:
    """Also where every value differs; up to a screenful, each is told by itself."""
    found = [
        wrong_type(RecordLocation(row), f"obj_{row}", problems.OBJECT_FORM, "predObjId")
        for row in range(SHOWN_PROBLEMS + 1)
    ]
    others = [wrong_type(RecordLocation(2), 7, problems.TRAJECTORY_FORM, "trajectory")]
    assert faults.limit_problems([*found[1:], *others]) == [*found[1:], *others]
    joined, *rest = faults.limit_problems([*reversed(found), *others])
    assert rest == others
    assert (joined.where, joined.code) == ("[0].predObjId", "wrong-type")
    assert joined.message == f"{found[0].message} (20 more like it)"


def test_the_same_field_of_records_by_their_ids_is_one_place() -> None:
    found = [
        problems.MISSING_FIELD.of_record(RecordLocation(row, f"{row}_1_0"), field="trajectory")
        for row in range(SHOWN_PROBLEMS + 1)
    ]
    (joined,) = faults.limit_problems(found)
    assert str(joined) == '["0_1_0"]: has no trajectory; add it (20 more like it)'


def test_problems_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "MAX_PROBLEMS", 2)
    found = [problems.MISSING_FIELD.of_record(RecordLocation(row), field="a") for row in range(5)]
    assert faults.limit_problems(iter(found[:2])) == found[:2]
    further = iter(found)
    *first, last = faults.limit_problems(further)
    assert first == found[:2]
    assert next(further) is found[3]  # nothing is searched for beyond the limit
    assert (last.code, last.where, last.position) == ("too-many-problems", "file", (maxsize,))
    assert last.message == (
        "has more than 2 problems; fix these first, because the rest was not checked"
    )


def test_a_fault_of_many_records() -> None:
    of_one = faults.DECIMAL_IDS.problem(1, "[3].predObjId", (3,), 3.0)
    assert (of_one.code, of_one.where, of_one.position) == ("wrong-type", "[3].predObjId", (3,))
    assert of_one.message == (
        "has an object id written as a decimal, such as 3.0; write whole numbers, or let "
        "`reverie-eval convert` do it"
    )
    of_many = faults.DISAGREEING_ANSWERS.problem(1_200, "[3]", (3,), None)
    assert of_many.message == (
        "1,200 records have different answers under two keys, such as null; keep one of the keys"
    )
    assert faults.DECIMAL_IDS.fixed(1, "[3].predObjId", 3.0) == (
        "an object id written as a decimal, such as 3.0, in 1 record"
    )
    assert faults.WRAPPED.fixed(1, "file", "results") == "the records under the key 'results'"


def test_a_misspelt_field_may_have_braces() -> None:
    fault = faults.misspelt("{pred}", "predObjId")
    assert fault.problem(1, "[0]", (0,), None).message == (
        "has the field '{pred}', which is not read; did you mean predObjId? Rename it, or let "
        "`reverie-eval convert` do it"
    )
    assert fault.code == "misspelt-field"


@pytest.mark.parametrize(
    ("task", "record_form", "id_form"),
    [
        pytest.param(
            REVERIE,
            "an object with instr_id, trajectory and predObjId",
            'the episode\'s id as text: "4774_267_1"',
            id="targets",
        ),
        pytest.param(
            NDH,
            "an object with inst_idx and trajectory",
            "the number of the episode: 5354",
            id="ndh",
        ),
    ],
)
def test_the_forms_of_a_task(task: Any, record_form: str, id_form: str) -> None:
    assert (problems.record_form(task), problems.id_form(task)) == (record_form, id_form)


@pytest.mark.parametrize(
    ("location", "field", "where"),
    [
        pytest.param(RECORD, ".trajectory[5]", "[3].trajectory[5]", id="by row"),
        pytest.param(KEYED, ".instr_id", '["7_1_0"].instr_id', id="by key"),
        pytest.param(OF_AN_ITEM, ".instr_id", "[3].instr_id", id="id of an item"),
        pytest.param(OF_AN_ITEM, "", "[3].trajectory[2]", id="trajectory of an item"),
        pytest.param(
            OF_AN_ITEM, ".trajectory[5][0]", "[3].trajectory[2].path[5][0]", id="pose of an item"
        ),
    ],
)
def test_where_a_record_is(location: RecordLocation, field: str, where: str) -> None:
    assert location.at(field) == where
    assert str(location) == location.at("")
