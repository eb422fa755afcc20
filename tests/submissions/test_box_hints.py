"""Boxes that were not meant as they are read give a hint; boxes that were do not.

The boxes are those of the targets of the demo world, up to a tenth narrower and lower.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from reverie_eval import PROTOCOLS, GroundTruth, validate
from reverie_eval.geometry import view_angles
from reverie_eval.scoring import PreparedSubmission
from reverie_eval.submissions import BoxAnswers, read_predictions
from reverie_eval.submissions._answers import box_scale_problems
from reverie_eval.submissions._hints import _other_boxes, _other_views, _point_hints, box_hints
from tests.support.worlds import SPLIT

Box = list[float]
Meant = tuple[Box, int]
"""A box and its view."""

ALL = "% of the boxes fit an annotated object; read as "


def targets(truth: GroundTruth) -> list[Meant]:
    """Return a box of each episode's target at the end of its path."""
    solution = truth.require_solution()
    candidate, _ = solution.find(solution.target_object, solution.goal)
    by_candidate = {each: row for row, each in enumerate(solution.boxes.candidate.tolist())}
    rows = [by_candidate[each] for each in candidate.tolist()]
    boxes = solution.boxes.xywh[rows].astype(float)
    boxes[:, 2:] *= np.random.default_rng(0).uniform(0.9, 1, (len(rows), 2))
    return list(zip(boxes.tolist(), solution.boxes.view[rows].tolist(), strict=True))


def submission(
    truth: GroundTruth,
    write: Callable[[Box, int], dict[str, Any]],
    looks_there: bool = False,  # noqa: FBT001, FBT002
) -> list[dict[str, Any]]:
    """Return a submission that answers every episode by its target's box, written like this."""
    viewpoint_ids, goal = truth.graph.viewpoint_ids, truth.require_solution().goal
    records = []
    for row, (box, view) in enumerate(targets(truth)):
        angles = view_angles(np.array([view]))[0].tolist() if looks_there else [0.0, 0.0]
        start, stop = truth.episodes.start[row], goal[row]
        trajectory = [[viewpoint_ids[start], 0.0, 0.0], [viewpoint_ids[stop], *angles]]
        instr_id = truth.episodes.instr_ids[row]
        records.append({"instr_id": instr_id, "trajectory": trajectory, **write(box, view)})
    return records


def hints_about(records: Sequence[dict[str, Any]], truth: GroundTruth) -> list[str]:
    """Return what is said of the boxes."""
    notes = validate(records, split=SPLIT, ground_truth=truth).notes
    return [note for note in notes if "box" in note and not note.startswith(("read as", "ignored"))]


def resized(box: Box, width: float, height: float) -> Box:
    """Return a box in an image of another size."""
    return [side * scale for side, scale in zip(box, [width / 640, height / 480] * 2, strict=True)]


@pytest.mark.parametrize(
    ("write", "reading"),
    [
        pytest.param(
            lambda box, view: {
                "predBox": [*box[:2], box[0] + box[2], box[1] + box[3]],
                "predView": view,
            },
            "[left, top, right, bottom]",
            id="corners",
        ),
        pytest.param(
            lambda box, view: {
                "predBox": [box[0] + box[2] / 2, box[1] + box[3] / 2, *box[2:]],
                "predView": view,
            },
            "[centre x, centre y, width, height]",
            id="centre",
        ),
        pytest.param(
            lambda box, view: {"predBox": [box[1], box[0], box[3], box[2]], "predView": view},
            "[y, x, height, width]",
            id="axes swapped",
        ),
        pytest.param(
            lambda box, view: {"predBox": [640 - box[0] - box[2], *box[1:]], "predView": view},
            "x measured from the right edge",
            id="mirrored",
        ),
        pytest.param(
            lambda box, view: {
                "predBox": [box[0], 480 - box[1] - box[3], *box[2:]],
                "predView": view,
            },
            "y measured from the lower edge",
            id="upside down",
        ),
        *(
            pytest.param(
                lambda box, view, side=side: {
                    "predBox": resized(box, side, side),
                    "predView": view,
                },
                f"boxes of {side} x {side} images",
                id=f"{side} pixels",
            )
            for side in (224, 336, 384)
        ),
        pytest.param(
            lambda box, view: {"predBox": box, "predView": min(view + 1, 35)},
            "views counted from 1",
            id="views from 1",
        ),
        pytest.param(
            lambda box, view: {"predBox": box, "predView": max(view - 1, 0)},
            "views one too low",
            id="views one too low",
        ),
        pytest.param(
            lambda box, view: {"predBox": box, "predView": 24 - view // 12 * 12 + view % 12},
            "views whose first row looks up",
            id="rows upside down",
        ),
    ],
)
def test_another_reading_that_fits_better(
    write: Callable[[Box, int], dict[str, Any]], reading: str, demo: GroundTruth
) -> None:
    records = submission(demo, write)
    (hint,) = [hint for hint in hints_about(records, demo) if ALL in hint]
    assert f"read as {reading}, " in hint
    assert hint.endswith("predBox is [x, y, width, height] in the image of predView")


def test_a_view_that_contradicts_the_last_pose(demo: GroundTruth) -> None:
    records = submission(
        demo,
        lambda box, view: {"predBox": box, "predView": (7 * view + 3) % 36},
        looks_there=True,
    )
    (hint,) = hints_about(records, demo)
    assert "read as boxes in the view of the last pose, " in hint


def test_boxes_without_view_from_agents_that_never_turn(demo: GroundTruth) -> None:
    records = submission(demo, lambda box, _: {"predBox": box})
    (hint,) = hints_about(records, demo)
    assert hint.startswith("all 84 boxes are in view 12; predView is the view that the box is in")


def test_boxes_of_small_images_without_a_size(demo: GroundTruth) -> None:
    records = submission(
        demo, lambda box, view: {"predBox": resized(box, 256, 256), "predView": view}
    )
    (hint,) = hints_about(records, demo)
    assert hint.startswith("no box reaches beyond 256 pixels of an image of 640 x 480")
    assert hint.endswith("if the images were smaller, give their size in predImageSize")


@pytest.mark.parametrize(
    ("write", "looks_there"),
    [
        pytest.param(lambda box, view: {"predBox": box, "predView": view}, False, id="in a view"),
        pytest.param(lambda box, _: {"predBox": box}, True, id="by the last pose"),
        pytest.param(
            lambda box, view: {
                "predBox": resized(box, 224, 224),
                "predView": view,
                "predImageSize": [224, 224],
            },
            False,
            id="small images with their size",
        ),
        pytest.param(
            lambda _, view: {"predBox": [0, 0, 640, 480], "predView": view},
            False,
            id="whole images",
        ),
    ],
)
def test_boxes_that_are_meant_as_they_are_read(
    write: Callable[[Box, int], dict[str, Any]],
    looks_there: bool,  # noqa: FBT001
    demo: GroundTruth,
) -> None:
    """Right or wrong, they give no hint."""
    assert hints_about(submission(demo, write, looks_there), demo) == []


def test_a_few_boxes_say_nothing(demo: GroundTruth) -> None:
    records = submission(demo, lambda box, _: {"predBox": resized(box, 224, 224)})
    few = [
        record if row < 19 else {**record, "predBox": None, "predObjId": -1}
        for row, record in enumerate(records)
    ]
    assert hints_about(few, demo) == []


def test_a_hint_depends_on_no_answer(demo: GroundTruth) -> None:
    """All annotated objects of a view are compared alike, whichever is the target."""
    records = submission(demo, lambda box, view: {"predBox": box, "predView": min(view + 1, 35)})
    solution = demo.require_solution()
    others = replace(demo, solution=replace(solution, target_object=solution.target_object + 1))
    assert hints_about(records, others) == hints_about(records, demo)
    assert hints_about(records, replace(demo, solution=None)) == []


def test_a_hint_from_answers_is_left_out_where_they_are_private(demo: GroundTruth) -> None:
    records = submission(demo, lambda box, view: {"predBox": box, "predView": min(view + 1, 35)})
    prepared = PreparedSubmission.of(read_predictions(records), demo)
    (hint,) = prepared.answer_hints
    rules = PROTOCOLS["official-v1"]
    assert hint in prepared.score(rules).notes
    notes = prepared.without_answer_hints().score(rules).notes
    assert notes == [note for note in prepared.score(rules).notes if note != hint]


# Boxes by themselves.


def predicted(*given: Box, uncut: Sequence[Box] = (), cut: int = 0, turned: int = 0) -> BoxAnswers:
    """Return boxes of which the first so many were cut, or are in the next view to the right."""
    count = len(given)
    views = np.where(np.arange(count) < turned, 13, 12)
    return BoxAnswers(
        row=np.arange(count),
        xywh=np.array(given, dtype=float),
        camera=view_angles(views),
        is_cut=np.arange(count) < cut,
        uncut_xywh=np.array(uncut or given, dtype=float),
        stop_angles=np.zeros((count, 2)),
    )


WHOLE = [0.0, 0.0, 640.0, 480.0]
OUTSIDE, NARROW, FLAT = [640.0, 0.0, 0.0, 9.0], [9.0, 9.0, 0.0, 9.0], [9.0, 480.0, 9.0, 0.0]
TINY, LARGER = [9.0, 9.0, 2.0, 2.0], [9.0, 9.0, 2.0, 2.5]
ALL_OUTSIDE = (
    " boxes lie entirely outside the 640 x 480 image; predBox is [x, y, width, height] in pixels "
    "of that image, or of one with the size in predImageSize"
)
ALL_TINY = (
    " boxes are at most two pixels wide and high; if they are fractions of the image, add "
    '"predImageSize": [1, 1]'
)


@pytest.mark.parametrize(
    ("boxes", "messages"),
    [
        pytest.param(predicted(*[WHOLE] * 20), [], id="whole images"),
        pytest.param(predicted(*[OUTSIDE] * 19), [], id="19 outside"),
        pytest.param(predicted(*[OUTSIDE] * 20), [f"20 of its 20{ALL_OUTSIDE}"], id="20 outside"),
        pytest.param(predicted(*[OUTSIDE] * 10, *[WHOLE] * 10), [], id="half outside"),
        pytest.param(
            predicted(*[NARROW] * 6, *[FLAT] * 5, *[WHOLE] * 9, uncut=[WHOLE] * 20),
            [f"11 of its 20{ALL_OUTSIDE}"],
            id="over half without area",
        ),
        pytest.param(predicted(*[TINY] * 10, *[WHOLE] * 10), [], id="half tiny"),
        pytest.param(
            predicted(*[TINY] * 11, *[WHOLE] * 9), [f"11 of its 20{ALL_TINY}"], id="over half tiny"
        ),
        pytest.param(predicted(*[LARGER] * 20), [], id="more than two pixels high"),
        pytest.param(predicted(*[LARGER[:2] + LARGER[:1:-1]] * 20), [], id="more than two wide"),
        pytest.param(
            predicted(*[OUTSIDE] * 20, uncut=[TINY] * 20),
            [f"20 of its 20{ALL_OUTSIDE}"],
            id="outside and tiny",
        ),
    ],
)
def test_boxes_of_a_wrong_scale(boxes: BoxAnswers, messages: list[str]) -> None:
    assert [problem.message for problem in box_scale_problems(boxes)] == messages


CORNER = [0.0, 0.0, 2.0, 2.0]
FRACTIONS = (
    "most boxes lie within two pixels of the upper left corner; if they are fractions of the "
    'image, add "predImageSize": [1, 1]; predBox is [x, y, width, height], not two corners'
)
CUT = (
    "most boxes reach beyond the image; predBox is [x, y, width, height], not two corners, in an "
    "image of 640 x 480 unless predImageSize says otherwise"
)
SMALL = (
    "no box reaches beyond 384 pixels of an image of 640 x 480; if the images were smaller, give "
    "their size in predImageSize"
)
ONE_VIEW = (
    "all 20 boxes are in view 12; predView is the view that the box is in, and without it the last "
    "pose has to look there"
)


@pytest.mark.parametrize(
    ("boxes", "hints"),
    [
        pytest.param(predicted(*[WHOLE] * 4), [], id="a few whole images"),
        pytest.param(predicted(*[CORNER] * 2, *[WHOLE] * 2), [], id="half in the corner"),
        pytest.param(predicted(*[CORNER] * 3, *[WHOLE] * 2), [FRACTIONS], id="most in the corner"),
        pytest.param(predicted([0, 0, 2.5, 1], [0.75, 0, 1, 2.5], WHOLE), [], id="near the corner"),
        pytest.param(predicted([2, 0, 1, 1], [0, 2, 1, 1]), [], id="beside the corner"),
        pytest.param(predicted(*[WHOLE] * 4, cut=2), [], id="half cut"),
        pytest.param(predicted(*[WHOLE] * 4, cut=3), [CUT], id="most cut"),
        pytest.param(predicted(*[WHOLE] * 20), [ONE_VIEW], id="one view"),
        pytest.param(predicted(*[WHOLE] * 20, turned=1), [], id="two views"),
        pytest.param(predicted(*[WHOLE] * 19), [], id="19 boxes"),
        pytest.param(
            predicted(*[[84.0, 0.0, 300.0, 9.0]] * 20, turned=1), [SMALL], id="up to 384 wide"
        ),
        pytest.param(
            predicted(*[[0.0, 84.0, 9.0, 300.0]] * 20, turned=1), [SMALL], id="up to 384 high"
        ),
        pytest.param(predicted(*[[84.0, 0.0, 300.0, 9.0]] * 19, turned=1), [], id="19 up to 384"),
        pytest.param(predicted(*[[85.0, 0.0, 300.0, 9.0]] * 20, turned=1), [], id="up to 385"),
    ],
)
def test_what_boxes_say_by_themselves(boxes: BoxAnswers, hints: list[str]) -> None:
    assert list(box_hints(boxes)) == hints


@pytest.mark.parametrize(
    ("reading", "box", "view"),
    [
        ("[left, top, right, bottom]", [10, 20, 20, 30], 13),
        ("[centre x, centre y, width, height]", [-5, -5, 30, 50], 13),
        ("[y, x, height, width]", [20, 10, 50, 30], 13),
        ("x measured from the right edge", [600, 20, 30, 50], 13),
        ("y measured from the lower edge", [10, 410, 30, 50], 13),
        ("boxes of 1000 x 1000 images", [6.4, 9.6, 19.2, 24], 13),
        ("views counted from 1", [10, 20, 30, 50], 12),
        ("views one too low", [10, 20, 30, 50], 14),
    ],
)
def test_another_reading_worked_by_hand(reading: str, box: Box, view: int) -> None:
    given, view_given = np.array([[10.0, 20.0, 30.0, 50.0]]), np.array([13])
    boxes = {**dict(_other_boxes(given)), **dict.fromkeys(_other_views(view_given), given)}
    assert boxes[reading][0].tolist() == pytest.approx(box)
    assert _other_views(view_given).get(reading, view_given).tolist() == [view]


def test_views_at_the_ends_of_their_rows() -> None:
    others = _other_views(np.array([0, 11, 12, 35]))
    assert {name: views.tolist() for name, views in others.items()} == {
        "views counted from 1": [35, 10, 11, 34],
        "views one too low": [1, 12, 13, 0],
        "views whose first row looks up": [24, 35, 12, 11],
    }


# Points.

SCALED = (
    "most points are not within 0 and 1: obj_heading is heading / (2 pi), obj_elevation "
    "(elevation + pi) / (2 pi), of angles in radians"
)
NO_POINT = [np.nan, np.nan]


@pytest.mark.parametrize(
    ("points", "hints"),
    [
        pytest.param([NO_POINT] * 2, ["no trajectory has a point: SFPL will be 0"], id="none"),
        pytest.param([[0.0, 1.0], [1.0, 0.0], NO_POINT], [], id="fractions of a turn"),
        pytest.param([[1.5, 0.5], [0.5, 0.5]], [], id="half beyond"),
        pytest.param([[1.5, 0.5], [0.5, -0.5], [0.5, 0.5]], [SCALED], id="most beyond"),
        pytest.param([[1.5, 0.5], NO_POINT, NO_POINT], [SCALED], id="all that there are"),
        pytest.param([[0.5, 0.5], NO_POINT, NO_POINT], [], id="one, and none beyond"),
    ],
)
def test_what_points_say(points: list[list[float]], hints: list[str]) -> None:
    assert list(_point_hints(np.array(points))) == hints
    assert list(_point_hints(None)) == []
