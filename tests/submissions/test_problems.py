"""Every sentence about a problem, word for word, with its code and its place."""

from collections.abc import Callable
from sys import maxsize
from typing import Any

import numpy as np
import pytest

from reverie_eval import Problem
from reverie_eval.errors import SHOWN_PROBLEMS
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.tasks import find_task

REVERIE, NDH, R2R, SOON = map(find_task, ("reverie", "ndh", "r2r", "soon"))
RECORD = RecordLocation(3)
KEYED = RecordLocation(3, "7_1_0")
OF_AN_ITEM = RecordLocation(3, place=2)
POSE_FORM = "[viewpoint_id, heading, elevation]"
BOX_FORM = "[x, y, width, height] in pixels from the upper left corner"
REMOVE_ALL_ELSE = (
    "a submission needs only instr_id, trajectory and predObjId: remove everything else"
)


def of_file(report: Callable[[], Problem], code: str, message: str) -> Any:
    """Return the row of a problem of the file as a whole."""
    return pytest.param(report, code, "file", message, (), id=message[:50])


def of_record(report: Callable[[], Problem], code: str, field: str, message: str) -> Any:
    """Return the row of a problem of the record in row 3."""
    return pytest.param(report, code, f"[3]{field}", message, (3,), id=message[:50])


@pytest.mark.parametrize(
    ("report", "code", "where", "message", "position"),
    [
        pytest.param(
            lambda: problems.not_json("line 3, column 1", "Expecting value"),
            "not-json",
            "line 3, column 1",
            "Expecting value; write the file with a JSON library",
            (),
            id="not JSON",
        ),
        pytest.param(
            lambda: problems.cut_short("line 3, column 1"),
            "not-json",
            "line 3, column 1",
            "the JSON ends in the middle, so the file was cut short; write or copy it again",
            (),
            id="cut short",
        ),
        of_file(
            problems.not_a_literal,
            "not-json",
            "looks printed by Python, but was cut short or holds more than lists, dictionaries, "
            "strings and plain numbers, such as nan or array(...); write it with json.dump",
        ),
        of_file(
            lambda: problems.another_kind("a web page"),
            "not-json",
            "is a web page; send the result file itself, as JSON or gzipped JSON",
        ),
        of_file(
            problems.huge_number,
            "not-json",
            "holds an integer with thousands of digits; object ids go up to 2,147,483,647",
        ),
        of_file(
            problems.too_deep,
            "too-deep",
            "is nested too deeply to be read; a submission has four levels",
        ),
        of_file(
            lambda: problems.too_large(3 << 20, None),
            "too-large",
            f"is larger than 3 MiB unpacked; {REMOVE_ALL_ELSE}",
        ),
        of_file(
            lambda: problems.too_large(4 << 20, "MAX_SIZE"),
            "too-large",
            f"is larger than 4 MiB unpacked; {REMOVE_ALL_ELSE}; if it needs this size, set "
            "MAX_SIZE to the size in MiB",
        ),
        of_file(
            lambda: problems.too_many_records(200_000),
            "too-large",
            "holds more than 200,000 records; no split has that many episodes",
        ),
        of_file(
            lambda: problems.too_many_values(4_000, 3_000),
            "too-large",
            "holds about 4,000 values, more than the limit of 3,000",
        ),
        of_file(
            lambda: problems.damaged_gzip("CRC"),
            "damaged-gzip",
            "cannot be unpacked (CRC); compress or copy it again",
        ),
        of_file(
            lambda: problems.damaged_zip("CRC"),
            "damaged-zip",
            "cannot be unpacked (CRC); send the result file itself",
        ),
        of_file(
            lambda: problems.not_one_file([]),
            "several-files",
            "is a zip archive with no file; pack only the result file",
        ),
        of_file(
            lambda: problems.not_one_file(["a", "b", "c", "d"]),
            "several-files",
            "is a zip archive with 4 files: 'a', 'b', 'c' and 1 more; pack only the result file",
        ),
        of_file(
            lambda: problems.not_a_list(17, REVERIE),
            "not-a-list",
            f'holds 17; expected a list of predictions: [{{"instr_id": ..., "trajectory": '
            f'[{POSE_FORM}, ...], "predObjId": ...}}, ...]',
        ),
        of_file(
            problems.undeclared_navigation_only,
            "navigation-only",
            "no record has an answer; if the agent only navigates, declare it: --navigation-only "
            'on the command line, navigation_only in the API, or "Navigation only" on the page',
        ),
        of_file(
            problems.declared_navigation_only,
            "navigation-only",
            "has answers, but the method is declared navigation only; remove that declaration",
        ),
        of_file(
            lambda: problems.boxes_outside(1_200, 2_000),
            "wrong-scale",
            "1,200 of its 2,000 boxes lie entirely outside the 640 x 480 image; predBox is [x, y, "
            "width, height] in pixels of that image, or of one with the size in predImageSize",
        ),
        of_file(
            lambda: problems.tiny_boxes(1_200, 2_000),
            "wrong-scale",
            "1,200 of its 2,000 boxes are at most two pixels wide and high; if they are fractions "
            'of the image, add "predImageSize": [1, 1]',
        ),
        of_file(
            problems.no_answers,
            "missing-field",
            "no record has an answer, and the grounding track scores nothing else",
        ),
        of_file(
            lambda: problems.no_episode_of_split("val_unseen", 3_521),
            "missing-episode",
            "has no prediction for any of the 3,521 episodes of val_unseen; each needs one",
        ),
        of_file(
            lambda: problems.missing_episode("7_1_0", "val_unseen"),
            "missing-episode",
            "episode 7_1_0 has no prediction; every episode of val_unseen needs one",
        ),
        of_file(
            lambda: problems.missing_episodes(["a", "b", "c", "d"], 3_521, "val_unseen"),
            "missing-episode",
            "4 of the 3,521 episodes of val_unseen have no prediction, such as a, b, c and 1 more; "
            "every episode needs one: check that the file holds the results of all processes and "
            "was not cut short",
        ),
        of_file(
            lambda: problems.ids_of_another_task(1, "5_0", REVERIE, [R2R]),
            "other-task",
            "1 id looks like R2R ids, not like REVERIE ids (4774_267_1); the first is '5_0': score "
            "the file with --task r2r",
        ),
        of_file(
            lambda: problems.ids_of_another_task(1_200, "5_0", REVERIE, [R2R, NDH]),
            "other-task",
            "1,200 ids look like R2R or NDH ids, not like REVERIE ids (4774_267_1); the first is "
            "'5_0': score the file with --task r2r",
        ),
        of_file(
            lambda: problems.results_of_another_task(REVERIE, NDH, "their ids are in 'inst_idx'"),
            "other-task",
            "holds results of NDH, not of REVERIE: their ids are in 'inst_idx'; score the file "
            "with --task ndh",
        ),
        of_file(
            lambda: problems.ids_outside_demo(1_200, "1_2_0", "val_unseen", REVERIE),
            "not-the-demo-world",
            "no instr_id is in the demo world that ships with this package (1,200 are not, the "
            "first is '1_2_0'); to score REVERIE itself, clone github.com/YuankaiQi/REVERIE, run "
            "`reverie-eval compile REVERIE --split val_unseen -o val_unseen.npz` once and pass "
            "--ground-truth val_unseen.npz",
        ),
        of_file(
            lambda: problems.ids_outside_demo(2, "9", "test", NDH),
            "not-the-demo-world",
            "no instr_id is in the demo world that ships with this package (2 are not, the first "
            "is '9'); to score NDH itself, clone github.com/mmurray/cvdn, run `reverie-eval "
            "compile NDH --task ndh --split test -o test.npz` once and pass --ground-truth "
            "test.npz",
        ),
        of_file(
            lambda: problems.results_of_another_task(
                REVERIE, SOON, "their trajectories are objects with a path"
            ),
            "other-task",
            "holds results of SOON, not of REVERIE: their trajectories are objects with a path; "
            "score the file with --task soon",
        ),
        of_file(
            lambda: problems.repeated_key("7_1_0"),
            "repeated-field",
            "has '7_1_0' twice; keep the right one",
        ),
        of_record(
            lambda: problems.results_of_other_splits({"test": 1}, "val_unseen", RECORD, "7_1_0"),
            "other-split",
            ".instr_id",
            "holds test (1 record), and no episode of val_unseen; the first is '7_1_0': score the "
            "file as test, or send the predictions for val_unseen",
        ),
        of_record(
            lambda: problems.results_of_other_splits(
                {"train": 1_200, "test": 2}, "val_unseen", RECORD, "7_1_0"
            ),
            "other-split",
            ".instr_id",
            "holds train (1,200 records) and test (2 records), and no episode of val_unseen; the "
            "first is '7_1_0': send the predictions for val_unseen",
        ),
        of_file(
            lambda: problems.positions(40, 42, [1.5, 0.1, -2.5]),
            "continuous-environment",
            "40 of its 42 paths are positions, such as [1.5, 0.1, -2.5], of a continuous "
            "environment (VLN-CE, RxR-Habitat); only viewpoints of the navigation graph can be "
            "scored",
        ),
        of_record(
            lambda: problems.wrong_type(RECORD, 7, "an object"),
            "wrong-type",
            "",
            "got 7; expected an object",
        ),
        of_record(
            lambda: problems.wrong_type(RECORD, np.zeros(2), "a number", "predObjId"),
            "wrong-type",
            ".predObjId",
            "got array([0., 0.]); expected a number; use .tolist()",
        ),
        of_record(
            lambda: problems.repeated_field(RECORD, "predObjId"),
            "repeated-field",
            "",
            "has predObjId twice; keep the right one",
        ),
        of_record(
            lambda: problems.duets_episodes(RECORD, "1-2_3"),
            "unknown-episode",
            ".instr_id",
            "'1-2_3' is an episode id of DUET's own files, which does not identify the item; write "
            "the item's instr_id, with its trajectories in the order of its paths",
        ),
        pytest.param(
            lambda: problems.key_mismatch(KEYED, "8_1_0"),
            "key-mismatch",
            '["7_1_0"].instr_id',
            "is '8_1_0' under the key '7_1_0'; make them equal",
            (3,),
            id="key mismatch",
        ),
        of_record(
            lambda: problems.missing_field(RECORD, "trajectory"),
            "missing-field",
            "",
            "has no trajectory; add it",
        ),
        of_record(
            lambda: problems.unknown_episode(RECORD, "9_9_9", "test", REVERIE),
            "unknown-episode",
            ".instr_id",
            "'9_9_9' is not an episode of test; ids are <item id>_<index of the instruction>, "
            "counted from 0",
        ),
        of_record(
            lambda: problems.duplicate_episode(RECORD, "7_1_0", RecordLocation(1)),
            "duplicate-episode",
            ".instr_id",
            "7_1_0 already has a prediction in [1]; keep one per episode",
        ),
        of_record(
            lambda: problems.changed_prediction(RECORD, "7_1_0"),
            "duplicate-episode",
            ".instr_id",
            "7_1_0 already has a different prediction; keep one per episode, and call reset() "
            "before the next epoch",
        ),
        of_record(
            lambda: problems.empty_trajectory(RECORD),
            "empty-trajectory",
            ".trajectory",
            "is empty; an agent that does not move has one pose, its start viewpoint",
        ),
        of_record(
            lambda: problems.too_many_poses(RECORD, 30_000, 20_000),
            "too-large",
            ".trajectory",
            "holds 30,000 elements, more than the 20,000 that any agent could need",
        ),
        of_record(
            lambda: problems.no_answer(RECORD, "predObjId", "predBox"),
            "missing-field",
            "",
            "has neither predObjId nor predBox; add one",
        ),
        of_record(
            lambda: problems.two_answers(RECORD, "predObjId", 4),
            "two-answers",
            ".predObjId",
            "got 4 together with predBox; an episode has one answer: remove one, or set predObjId "
            "to -1",
        ),
        of_record(
            lambda: problems.box_not_finite(RECORD, "predBox", (1, 2)),
            "not-finite",
            ".predBox",
            f"got [1, 2]; expected {BOX_FORM}, finite numbers",
        ),
        of_record(
            lambda: problems.empty_box(RECORD, "predBox", (1, 2)),
            "empty-box",
            ".predBox",
            f"got [1, 2]; expected {BOX_FORM}, with positive width and height",
        ),
        of_record(
            lambda: problems.wrong_view(RECORD, "predView", np.array(36)),
            "wrong-view",
            ".predView",
            "got array(36); expected a view index, an integer from 0 to 35: 0-11 look down, 12-23 "
            "are level, 24-35 look up, each row turning right from heading 0; use .item()",
        ),
        of_record(
            lambda: problems.no_view(RECORD, "predView", has_poses=False),
            "missing-field",
            "",
            "has a predBox but no predView; add the index of the view it is in (0-35)",
        ),
        of_record(
            lambda: problems.no_view(RECORD, "predView", has_poses=True),
            "missing-field",
            "",
            "has a predBox but no predView; add the index of the view it is in (0-35), or give "
            "heading and elevation in the last pose",
        ),
        pytest.param(
            lambda: problems.upside_down(RECORD, (4,), 30.0, "predView"),
            "wrong-camera",
            "[3].trajectory[4]",
            "the camera of the box has an elevation of 30.0, beyond straight up or down (pi / 2); "
            "give radians, or the view index in predView (0-35)",
            (3, 4),
            id="upside down",
        ),
        of_record(
            lambda: problems.half_a_point(RECORD, ["obj_heading", "obj_elevation"]),
            "wrong-type",
            "",
            "has only one of obj_heading and obj_elevation, the other is null; give both or "
            "neither",
        ),
        pytest.param(
            lambda: problems.wrong_pose(RECORD, (4, 0), np.zeros(1)),
            "wrong-type",
            "[3].trajectory[4][0]",
            f"got array([0.]); expected {POSE_FORM}; use .item()",
            (3, 4, 0),
            id="wrong pose",
        ),
        pytest.param(
            lambda: problems.not_finite(RECORD, (4,), ("hall", 1, 2)),
            "not-finite",
            "[3].trajectory[4]",
            "got ['hall', 1, 2]; heading and elevation are finite numbers of radians",
            (3, 4),
            id="not finite",
        ),
        pytest.param(
            lambda: problems.unknown_viewpoint(RECORD, (4,), "cellar", "house"),
            "unknown-viewpoint",
            "[3].trajectory[4]",
            "viewpoint 'cellar' is not in the navigation graph of scan house; use the viewpoint "
            "ids of the connectivity files",
            (3, 4),
            id="unknown viewpoint",
        ),
        pytest.param(
            lambda: problems.viewpoint_of_another_scan(RECORD, (4,), "loft", "house", "barn"),
            "other-scan",
            "[3].trajectory[4]",
            "viewpoint loft belongs to scan barn, but the episode is in scan house; check that "
            "trajectories and instr_ids were not mixed up",
            (3, 4),
            id="viewpoint of another scan",
        ),
        pytest.param(
            lambda: problems.wrong_start(RECORD, "7_1_0", "hall", "loft"),
            "wrong-start",
            "[3].trajectory[0]",
            "episode 7_1_0 starts at viewpoint hall, got loft; list the start viewpoint as the "
            "first pose",
            (3, 0),
            id="wrong start",
        ),
        pytest.param(
            lambda: problems.wrong_start(OF_AN_ITEM, "7#2", "hall", "loft"),
            "wrong-start",
            "[3].trajectory[2].path[0]",
            "episode 7#2 starts at viewpoint hall, got loft; list the trajectories in the order of "
            "the item's paths, each from its start",
            (3, 0),
            id="wrong start of an item's trajectory",
        ),
        pytest.param(
            lambda: problems.unreachable(RECORD, (4,), "attic"),
            "unreachable",
            "[3].trajectory[4]",
            "viewpoint attic cannot be reached from the start; a jump counts at shortest-path "
            "distance, so there must be a route",
            (3, 4),
            id="unreachable",
        ),
    ],
)
def test_a_problem(
    report: Callable[[], Problem], code: str, where: str, message: str, position: tuple[int, ...]
) -> None:
    problem = report()
    found = (problem.code, problem.where, problem.message, problem.position)
    assert found == (code, where, message, position)


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
    message = problems.wrong_type(RECORD, value, "a number").message
    assert message == f"got {shown}; expected a number"


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
    assert problems.wrong_pose(RECORD, (0,), found).message.endswith(f"{POSE_FORM}{remedy}")


def test_a_mistake_that_many_records_share_is_one_problem() -> None:
    """Also where every value differs; up to a screenful, each is told by itself."""
    found = [
        problems.wrong_type(RecordLocation(row), f"obj_{row}", problems.OBJECT_FORM, "predObjId")
        for row in range(SHOWN_PROBLEMS + 1)
    ]
    others = [problems.wrong_type(RecordLocation(2), 7, problems.TRAJECTORY_FORM, "trajectory")]
    assert problems.limit_problems([*found[1:], *others]) == [*found[1:], *others]
    joined, *rest = problems.limit_problems([*reversed(found), *others])
    assert rest == others
    assert (joined.where, joined.code) == ("[0].predObjId", "wrong-type")
    assert joined.message == f"{found[0].message} (20 more like it)"


def test_the_same_field_of_records_by_their_ids_is_one_place() -> None:
    found = [
        problems.missing_field(RecordLocation(row, f"{row}_1_0"), "trajectory")
        for row in range(SHOWN_PROBLEMS + 1)
    ]
    (joined,) = problems.limit_problems(found)
    assert str(joined) == '["0_1_0"]: has no trajectory; add it (20 more like it)'


def test_problems_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(problems, "MAX_PROBLEMS", 2)
    found = [problems.missing_field(RecordLocation(row), "a") for row in range(5)]
    assert problems.limit_problems(iter(found[:2])) == found[:2]
    further = iter(found)
    *first, last = problems.limit_problems(further)
    assert first == found[:2]
    assert next(further) is found[3]  # nothing is searched for beyond the limit
    assert (last.code, last.where, last.position) == ("too-many-problems", "file", (maxsize,))
    assert last.message == (
        "has more than 2 problems; fix these first, because the rest was not checked"
    )


def test_a_fault_of_many_records() -> None:
    of_one = problems.DECIMAL_IDS.problem(1, "[3].predObjId", (3,), 3.0)
    assert (of_one.code, of_one.where, of_one.position) == ("wrong-type", "[3].predObjId", (3,))
    assert of_one.message == (
        "has an object id written as a decimal, such as 3.0; write whole numbers, or let "
        "`reverie-eval convert` do it"
    )
    of_many = problems.DISAGREEING_ANSWERS.problem(1_200, "[3]", (3,), None)
    assert of_many.message == (
        "1,200 records have different answers under two keys, such as null; keep one of the keys"
    )
    assert problems.DECIMAL_IDS.fixed(1, "[3].predObjId", 3.0) == (
        "an object id written as a decimal, such as 3.0, in 1 record"
    )
    assert problems.WRAPPED.fixed(1, "file", "results") == "the records under the key 'results'"


def test_a_misspelt_field_may_have_braces() -> None:
    fault = problems.misspelt("{pred}", "predObjId")
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
