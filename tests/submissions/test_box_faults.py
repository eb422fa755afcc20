"""Invalid answers by box: every fault with its code, location and message, all at once."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from reverie_eval import Problem, SubmissionError, evaluate
from reverie_eval.submissions import read_predictions
from tests.support.amounts import amount
from tests.support.drawings import WITHOUT, Record, answer
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.worlds import SPLIT, ground_truth_by_hand


def problems_of(records: Sequence[Record], *, answers_only: bool = False) -> Sequence[Problem]:
    """Return the problems in the order in which they are reported."""
    found = read_predictions(records, answers_only=answers_only).problems
    return SubmissionError(found).problems if found else ()


BOX_FORM = "expected [x, y, width, height] in pixels from the upper left corner"
VIEW_FORM = (
    "expected a view index, an integer from 0 to 35: 0-11 look down, 12-23 are level, 24-35 look "
    "up, each row turning right from heading 0"
)
SIZE_FORM = "expected [width, height] of the image that predBox is in, at least 1 each"
POSITIVE = f"{BOX_FORM}, with positive width and height"
FINITE = f"{BOX_FORM}, finite numbers"
NO_ANSWER = "has neither predObjId nor predBox; add one"
NO_VIEW = "has a predBox but no predView; add the index of the view it is in (0-35)"
OR_POSE = ", or give heading and elevation in the last pose"

HUGE = 10**400
SHORT_HUGE = f"1{'0' * 17}...{'0' * 19}"


class Fault(NamedTuple):
    """Fields of a record that make one problem."""

    fields: Mapping[str, Any]
    code: str
    where: str
    message: str


def wrong_box(box: object, found: str, form: str = BOX_FORM, code: str = "wrong-type") -> Fault:
    """Return the fault of a malformed box."""
    return Fault({"predBox": box}, code, ".predBox", f"got {found}; {form}")


def infinite(box: object, found: str) -> Fault:
    """Return the fault of a box with a number that is not finite."""
    return wrong_box(box, found, FINITE, "not-finite")


def empty(box: object, found: str) -> Fault:
    """Return the fault of a box without area."""
    return wrong_box(box, found, POSITIVE, "empty-box")


def wrong_view(view: object, found: str) -> Fault:
    """Return the fault of a view that does not exist."""
    return Fault({"predView": view}, "wrong-view", ".predView", f"got {found}; {VIEW_FORM}")


def wrong_size(size: object, found: str) -> Fault:
    """Return the fault of an impossible image size."""
    fields = {"predImageSize": size}
    return Fault(fields, "wrong-type", ".predImageSize", f"got {found}; {SIZE_FORM}")


def also_named(key: str, named: object) -> Fault:
    """Return the fault of a record that also predicts an object."""
    message = (
        f"got {named!r} together with predBox; an episode has one answer: remove one, "
        f"or set {key} to -1"
    )
    return Fault({key: named}, "two-answers", f".{key}", message)


def no_view(*trajectory: object, view: object = WITHOUT) -> Fault:
    """Return the fault of a record without a camera."""
    fields = {"predView": view, "trajectory": trajectory}
    return Fault(fields, "missing-field", "", NO_VIEW + OR_POSE)


def wrong_camera(elevation: float, found: str) -> Fault:
    """Return the fault of a camera that is turned beyond straight up or down."""
    message = (
        f"the camera of the box has an elevation of {found}, beyond straight up or "
        "down (pi / 2); give radians, or the view index in predView (0-35)"
    )
    fields = {"predView": WITHOUT, "trajectory": [["hall", 0, 0], ["bath", 1, elevation]]}
    return Fault(fields, "wrong-camera", ".trajectory[1]", message)


def wrong_pose(code: str, pose: object, message: str) -> Fault:
    """Return the fault of a last pose whose angles cannot be read."""
    fields = {"predView": WITHOUT, "trajectory": [["hall", 0, 0], pose]}
    return Fault(fields, code, ".trajectory[1]", message)


WRONG = {
    "number": wrong_box(7, "7"),
    "text": wrong_box("1 2 3 4", "'1 2 3 4'"),
    "object": wrong_box({}, "{}"),
    "false": wrong_box(box=False, found="false"),
    "no number": wrong_box([], "[]"),
    "three numbers": wrong_box([1, 2, 3], "[1, 2, 3]"),
    "five numbers": wrong_box([1, 2, 3, 4, 5], "[1, 2, 3, 4, ...]"),
    "true in it": wrong_box([1, 2, True, 4], "[1, 2, True, 4]"),
    "text in it": wrong_box([1, 2, "x", 4], "[1, 2, 'x', 4]"),
    "null in it": wrong_box([1, None, 3, 4], "[1, None, 3, 4]"),
    "list of boxes": wrong_box([[1, 2, 3, 4]] * 2, "[[1, 2, 3, 4], [1, 2, 3, 4]]"),
    "NaN": infinite([math.nan, 2, 3, 4], "[nan, 2, 3, 4]"),
    "infinity": infinite([1, math.inf, 3, 4], "[1, inf, 3, 4]"),
    "minus infinity": infinite([1, 2, 3, -math.inf], "[1, 2, 3, -inf]"),
    "10**400": infinite([1, 2, HUGE, 4], f"[1, 2, {SHORT_HUGE}, 4]"),
    "no width": empty([1, 2, 0, 4], "[1, 2, 0, 4]"),
    "no height": empty([1, 2, 3, 0.0], "[1, 2, 3, 0.0]"),
    "negative width": empty([1, 2, -3, 4], "[1, 2, -3, 4]"),
    "negative height": empty((1, 2, 3, -4), "[1, 2, 3, -4]"),
    "view 36": wrong_view(36, "36"),
    "view -1": wrong_view(-1, "-1"),
    "view 10**8000": wrong_view(HUGE**20, "an integer with thousands of digits"),
    "view 3.5": wrong_view(3.5, "3.5"),
    "view NaN": wrong_view(math.nan, "nan"),
    "view true": wrong_view(view=True, found="true"),
    "view as a name": wrong_view("up", "'up'"),
    "views in a list": wrong_view([3, 4], "[3, 4]"),
    "size a number": wrong_size(640, "640"),
    "size of one": wrong_size([640], "[640]"),
    "size of three": wrong_size([6, 4, 3], "[6, 4, 3]"),
    "size as text": wrong_size("640x480", "'640x480'"),
    "no wide": wrong_size([0, 4], "[0, 4]"),
    "negative size": wrong_size([6, -4], "[6, -4]"),
    "less than 1 wide": wrong_size([0.5, 1], "[0.5, 1]"),
    "less than 1 high": wrong_size([1, 0.5], "[1, 0.5]"),
    "NaN high": wrong_size([6, math.nan], "[6, nan]"),
    "infinitely wide": wrong_size([math.inf, 4], "[inf, 4]"),
    "10**400 wide": wrong_size([HUGE, 4], f"[{SHORT_HUGE}, 4]"),
    "true wide": wrong_size([True, 4], "[True, 4]"),
    "object too": also_named("predObjId", 3),
    "object 0 too": also_named("predObjId", 0),
    "object as text too": also_named("predObjId", "3"),
    "wrong object too": also_named("predObjId", -2),
    "DUET's object too": also_named("pred_objid", 3),
    "older object too": also_named("pred_obj_id", 3),
    "pose without angles": no_view(["bath"]),
    "bare viewpoint": no_view("bath"),
    "angles before the last pose": no_view(["hall", 1, 2], ["bath"]),
    "hop": no_view(["hall", "bath"]),
    "view null": no_view(["bath"], view=None),
    "degrees": wrong_camera(30, "30"),
    "upside down": wrong_camera(math.nextafter(math.pi / 2, 2), "1.5707963267948968"),
    "upside down, downwards": wrong_camera(-1.6, "-1.6"),
    "heading NaN": wrong_pose(
        "not-finite",
        ["bath", math.nan, 0],
        "got ['bath', nan, 0]; heading and elevation are finite numbers of radians",
    ),
    "heading as text": wrong_pose(
        "wrong-type",
        ["bath", "1", 0],
        "got ['bath', '1', 0]; expected [viewpoint_id, heading, elevation]",
    ),
}


@pytest.mark.parametrize("fault", WRONG.values(), ids=list(WRONG))
def test_a_fault_in_an_answer_by_box(fault: Fault) -> None:
    (problem,) = problems_of([answer(), answer(**fault.fields)])
    assert (problem.code, problem.where, problem.message) == (
        fault.code,
        f"[1]{fault.where}",
        fault.message,
    )


def test_every_fault_is_found_at_once() -> None:
    records = [answer(**fault.fields) for fault in WRONG.values()]
    found = {problem.where: problem.code for problem in problems_of(records)}
    assert found == {
        f"[{row}]{fault.where}": fault.code for row, fault in enumerate(WRONG.values())
    }


def test_every_fault_of_one_record_is_found_at_once() -> None:
    record = answer(
        predBox=[1], predView=36, predImageSize=0, predObjId=3, pred_objid=4, instr_id=None
    )
    assert [(problem.code, problem.where) for problem in problems_of([record])] == [
        ("wrong-type", "[0].instr_id"),
        ("two-answers", "[0].predObjId"),
        ("two-answers", "[0].pred_objid"),
        ("wrong-view", "[0].predView"),
        ("wrong-type", "[0].predImageSize"),
        ("wrong-type", "[0].predBox"),
    ]


def test_a_repeated_field() -> None:
    text = json.dumps([answer()]).replace('"predView": 14', '"predView": 14, "predView": 15')
    (problem,) = read_predictions(text.encode()).problems
    assert (problem.code, problem.where) == ("repeated-field", "[0]")


@pytest.mark.parametrize(
    "trajectory",
    [[], 7, WITHOUT, [7], [[7, 0, 0]], ["hall", {"a": 1}], [["hall", math.inf, 0]]],
    ids=["empty", "a number", "missing", "numbers", "numbered", "objects", "infinite"],
)
def test_a_box_without_a_trajectory_has_one_problem(trajectory: object) -> None:
    """The missing camera is not reported again."""
    (problem,) = problems_of([answer(predView=WITHOUT, trajectory=trajectory)])
    assert "predView" not in problem.message


def test_without_trajectories_a_view_is_needed() -> None:
    (problem,) = problems_of([answer(predView=WITHOUT)], answers_only=True)
    assert (problem.code, problem.where, problem.message) == ("missing-field", "[0]", NO_VIEW)
    assert problems_of([answer(trajectory=WITHOUT)], answers_only=True) == ()


def test_a_box_among_records_without_an_answer() -> None:
    """So the file is not navigation only, and the answers are missing."""
    (problem,) = problems_of([answer(), answer(predBox=WITHOUT)])
    assert (problem.code, problem.message) == ("missing-field", NO_ANSWER)


# Whatever stands in the fields.

WORLD = World(
    {"flat": Scan({"bath": Viewpoint((0, 0, 0), views={5: range(36)})}, frozenset())},
    [Item("7_1", "flat", ["bath"], 5)],
)
TRUTH = ground_truth_by_hand(WORLD)

numbers = st.one_of(
    st.integers(-700, 700),
    st.floats(),
    st.integers(),
    st.sampled_from([1e308, -1e308, 5e-324, 1e-9, HUGE, -HUGE, 0.0, -0.0]),
)
values = st.recursive(
    st.none() | st.booleans() | st.text(max_size=3) | numbers,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=2), inner),
    max_leaves=6,
)
boxes = st.tuples(numbers, numbers, numbers, numbers).map(list)
image_sizes = st.tuples(numbers, numbers).map(list)
poses = st.tuples(st.just("bath"), numbers, numbers).map(list)


@settings(max_examples=amount(150))
@given(
    box=boxes | values,
    view=st.none() | st.integers(-1, 36) | values,
    size=st.none() | image_sizes | values,
    pose=poses,
)
def test_any_values_are_scored_or_rejected(
    box: object, view: object, size: object, pose: object
) -> None:
    """Anything else would be our own error; a numpy warning fails here too."""
    record = answer(trajectory=[pose], predBox=box, predView=view, predImageSize=size)
    if not problems_of([record]):
        evaluate([record], split=SPLIT, ground_truth=TRUTH)
        return
    with pytest.raises(SubmissionError):
        evaluate([record], split=SPLIT, ground_truth=TRUTH)


finite = st.floats(allow_nan=False, allow_infinity=False)
corners = finite | st.floats(-1000, 1000) | st.integers(-700, 700)
extents = finite.map(abs).filter(bool) | st.floats(1e-9, 1000) | st.integers(1, 700)
angles = finite | st.floats(-7, 7)
elevations = st.floats(-math.pi / 2, math.pi / 2)


@settings(max_examples=amount(150))
@given(
    box=st.tuples(corners, corners, extents, extents),
    view=st.none() | st.integers(0, 35),
    size=st.none() | st.tuples(*[st.floats(1, allow_infinity=False)] * 2),
    pose=st.tuples(st.just("bath"), angles, elevations),
)
@example(box=(1e308, 1e308, 1e308, 1e308), view=3, size=(1, 1), pose=("bath", 0, 0))
@example(box=(0, 0, 5e-324, 5e-324), view=None, size=None, pose=("bath", 0.2, 0.2))
@example(box=(300, 300, 1e-300, 1), view=None, size=(1e308, 1), pose=("bath", 1e308, -math.pi / 2))
def test_any_valid_numbers_are_scored(
    box: object, view: object, size: object, pose: object
) -> None:
    record = answer(trajectory=[pose], predBox=box, predView=view, predImageSize=size)
    scores = evaluate([record], split=SPLIT, ground_truth=TRUTH)
    assert 0 <= scores["iou"] <= 1
    assert scores.to_report().notes == list(scores.notes)
