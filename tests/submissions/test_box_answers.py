"""Reading an answer by box: its position, its camera, and the notes about it."""

import json
import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reverie_eval.geometry import view_angles
from reverie_eval.metrics import box_match
from reverie_eval.submissions import BoxAnswers, Predictions, read_predictions
from tests.support.drawings import BOX, POSE_ANGLES, WITHOUT, Record, answer


def read(*records: Record) -> Predictions:
    """Read valid records from Python objects."""
    predictions = read_predictions(records)
    assert predictions.problems == []
    return predictions


def box_of(record: Record) -> BoxAnswers:
    """Read the one box of a record."""
    boxes = read(record).boxes
    assert boxes.row.tolist() == [0]
    return boxes


# Which picture.

CARRIED_OVER = "{} boxes from cameras that are not one of the 36 views, warped to the nearest view"


@pytest.mark.parametrize(
    ("fields", "camera"),
    [
        pytest.param({"predView": 0}, [0, -math.pi / 6], id="first view"),
        pytest.param({"predView": 35}, [11 * math.pi / 6, math.pi / 6], id="last view"),
        pytest.param({"predView": np.int64(14)}, [math.pi / 3, 0], id="numpy"),
        pytest.param({"predView": WITHOUT}, POSE_ANGLES, id="camera of the last pose"),
        pytest.param({"predView": None}, POSE_ANGLES, id="null means no view"),
        pytest.param(
            {"predView": None, "trajectory": [["hall", 9, 9], ["bath", -7, 1, 8, 8]]},
            [-7, 1],
            id="further numbers behind the angles",
        ),
        pytest.param(
            {"predView": None, "trajectory": (("bath", np.float32(0.5), Fraction(1, 4)),)},
            [0.5, 0.25],
            id="angles of other types",
        ),
        pytest.param({"trajectory": ["bath"]}, [math.pi / 3, 0], id="a view needs no angles"),
        pytest.param(
            {"trajectory": [["bath", 90, 30]]}, [math.pi / 3, 0], id="a view for angles in degrees"
        ),
        pytest.param(
            {"predView": None, "trajectory": [["bath", 90, -math.pi / 2]]},
            [90, -math.pi / 2],
            id="straight down, and often round",
        ),
    ],
)
def test_the_camera(fields: Mapping[str, Any], camera: list[float]) -> None:
    assert box_of(answer(**fields)).camera.tolist() == [pytest.approx(camera, abs=1e-15)]


@given(view=st.integers(0, 35), turns=st.integers(-5, 5))
def test_a_pose_that_looks_where_a_view_does_is_that_view(view: int, turns: int) -> None:
    heading, elevation = view_angles(np.array([view])).tolist()[0]
    posed = answer(predView=WITHOUT, trajectory=[["bath", heading + turns * math.tau, elevation]])
    assert read(posed).read_as == []


@pytest.mark.parametrize(
    ("off", "phrases"),
    [
        pytest.param(0.0009, [], id="rounded to three decimals"),
        pytest.param(
            0.0011,
            [CARRIED_OVER.format(1)],
            id="elsewhere",
        ),
    ],
)
def test_a_camera_off_the_grid_is_reported(off: float, phrases: list[str]) -> None:
    for angles in ([off, 0], [math.tau - off, 0], [0, off], [math.pi, -math.pi / 6 - off]):
        record = answer(predView=WITHOUT, trajectory=[["bath", *angles]])
        assert read(record).read_as == phrases


def test_a_camera_far_off_the_grid_is_reported() -> None:
    """Both angles together are more than 15 degrees off, although each alone is less."""
    far = "{} of these warped by more than 15 degrees, where exact boxes fail more often"
    angles = np.deg2rad(np.array([[14.9, 0], [345.1, 0], [9, 9], [14, 14], [100, 46]]))
    poses = [["bath", *pair] for pair in angles.tolist()]
    records = [answer(predView=WITHOUT, trajectory=[pose]) for pose in poses]
    assert read(*records).read_as == [CARRIED_OVER.format(5), far.format(2)]


# Where in the picture.

SCALED = "1 boxes scaled from another image size to 640 x 480"
UPRIGHT = "1 of these from images taller than wide; predImageSize is [width, height]"
CUT = "1 boxes that reach beyond the image, cut to it"
OUTSIDE = "1 boxes entirely outside the image, which match nothing"


@pytest.mark.parametrize(
    ("fields", "xywh", "phrases"),
    [
        pytest.param({"predBox": [1, 2, 3, 4]}, [1, 2, 3, 4], [], id="whole pixels"),
        pytest.param({"predBox": [1.5, 2.25, 3.5, 0.25]}, [1.5, 2.25, 3.5, 0.25], [], id="parts"),
        pytest.param({"predBox": (1, 2, 3, 4)}, [1, 2, 3, 4], [], id="tuple"),
        pytest.param(
            {"predBox": [np.float32(1.5), np.int64(2), np.uint8(3), np.float64(4)]},
            [1.5, 2, 3, 4],
            [],
            id="numpy",
        ),
        pytest.param({"predBox": [0, 0, 640, 480]}, [0, 0, 640, 480], [], id="whole picture"),
        pytest.param({"predBox": [-0.0, 0, 1, 1]}, [0, 0, 1, 1], [], id="minus zero"),
        pytest.param({"predImageSize": None}, BOX, [], id="size null"),
        pytest.param({"predImageSize": [640, 480]}, BOX, [], id="size as it is"),
        pytest.param({"predImageSize": (640.0, 480.0)}, BOX, [], id="size in a tuple"),
        pytest.param(
            {"predBox": [0.25, 0.5, 0.5, 0.125], "predImageSize": [1, 1]},
            [160, 240, 320, 60],
            [SCALED],
            id="fractions of the picture",
        ),
        pytest.param(
            {"predBox": [7, 14, 21, 28], "predImageSize": [224, 224]},
            [20, 30, 60, 60],
            [SCALED],
            id="square picture",
        ),
        pytest.param(
            {"predBox": [10, 20, 30, 40], "predImageSize": [320, 480]},
            [20, 20, 60, 40],
            [SCALED, UPRIGHT],
            id="half as wide",
        ),
        pytest.param(
            {"predBox": [10, 20, 30, 40], "predImageSize": [640, 960]},
            [10, 10, 30, 20],
            [SCALED, UPRIGHT],
            id="twice as high",
        ),
        pytest.param({"predBox": [-10, 20, 30, 40]}, [0, 20, 20, 40], [CUT], id="left edge"),
        pytest.param({"predBox": [10, -20, 30, 40]}, [10, 0, 30, 20], [CUT], id="upper edge"),
        pytest.param({"predBox": [630, 20, 30, 40]}, [630, 20, 10, 40], [CUT], id="right edge"),
        pytest.param({"predBox": [10, 470, 30, 40]}, [10, 470, 30, 10], [CUT], id="lower edge"),
        pytest.param({"predBox": [-9, -9, 900, 900]}, [0, 0, 640, 480], [CUT], id="all edges"),
        pytest.param(
            {"predBox": [-(10**300), -(10**300), 10**301, 10**301]},
            [0, 0, 640, 480],
            [CUT],
            id="the size of the universe",
        ),
        pytest.param(
            {"predBox": [0.5, 0.5, 1, 0.25], "predImageSize": [1, 1]},
            [320, 240, 320, 120],
            [SCALED, CUT],
            id="scaled, then cut",
        ),
        pytest.param(
            {"predBox": [0, 0, 0.1 + 0.2, 0.7 + 0.1 + 0.2], "predImageSize": [1, 1]},
            [0, 0, 192, 480],
            [SCALED],
            id="not cut by rounding",
        ),
        pytest.param(
            {"predBox": [-1e-7, -1e-7, 640 + 3e-7, 480 + 3e-7]},
            [0, 0, 640, 480],
            [],
            id="beyond by rounding alone",
        ),
        pytest.param(
            {"predBox": [0, 0, 640.00001, 480]}, [0, 0, 640, 480], [CUT], id="beyond by more"
        ),
    ],
)
def test_the_box(fields: Mapping[str, Any], xywh: list[float], phrases: list[str]) -> None:
    record = answer(**fields)
    assert box_of(record).xywh.tolist() == [pytest.approx(xywh, abs=1e-12)]
    assert read(record).read_as == phrases
    assert box_of(record).is_cut.tolist() == [CUT in phrases]


@pytest.mark.parametrize(
    "box",
    [
        [640, 0, 10, 10],
        [-10, 0, 10, 10],
        [0, 480, 10, 10],
        [0, -10, 10, 10],
        [1e308, 1e308, 1e308, 1e308],
        [-1e308, 5, 1e300, 5],
    ],
    ids=["right", "left", "below", "above", "far right", "far left"],
)
def test_a_box_outside_the_image(box: list[float]) -> None:
    boxes = box_of(answer(predBox=box))
    assert (boxes.xywh[0, 2:].min(), boxes.is_cut.tolist()) == (0, [True])
    assert ((boxes.xywh >= 0) & (boxes.xywh <= [640, 480, 640, 480])).all()
    assert read(answer(predBox=box)).read_as == [OUTSIDE]


def test_boxes_of_a_file_are_counted() -> None:
    predictions = read(
        answer(predBox=[-1, 0, 5, 5]),
        answer(predBox=[-1, 0, 5, 5], predImageSize=[1280, 960]),
        answer(predBox=[900, 0, 5, 5]),
        answer(predView=None),
        answer(predBox=None, predObjId=3),
        answer(predBox=None, predObjId=None),
        answer(predView=None, predBox=[900, 0, 5, 5]),
    )
    assert predictions.read_as == [
        "1 answers that predict no object, not written as -1",
        "1 boxes scaled from another image size to 640 x 480",
        "2 boxes that reach beyond the image, cut to it",
        "2 boxes entirely outside the image, which match nothing",
        CARRIED_OVER.format(2),
    ]
    assert predictions.boxes.row.tolist() == [0, 1, 2, 3, 6]
    assert predictions.predicted_object.tolist() == [-1, -1, -1, -1, 3, -1, -1]


def test_upright_images_are_counted() -> None:
    upright = answer(predImageSize=[480, 640])
    assert read(upright, upright).read_as[1] == UPRIGHT.replace("1", "2", 1)


def test_boxes_in_another_order() -> None:
    boxes = read(
        answer(),
        answer(predBox=None, predObjId=-1),
        answer(predView=None, predBox=[1, 2, 3, 999]),
    ).boxes.take(np.array([1, 0]))
    assert boxes.row.tolist() == [2, 0]
    assert boxes.xywh.tolist() == [[1, 2, 3, 478], BOX]
    assert boxes.camera.tolist() == [POSE_ANGLES, pytest.approx([math.pi / 3, 0])]
    assert boxes.is_cut.tolist() == [True, False]


@pytest.mark.parametrize(
    "size",
    [(640, 480), (224, 224), (333, 333), (1000, 750), (1024, 768), (1, 1)],
    ids=lambda size: f"{size[0]} wide",
)
def test_a_tie_counts_in_an_image_of_any_size(size: tuple[int, int]) -> None:
    """Half of the target is just enough; a tenth of a pixel less is not."""
    across, down = size[0] / 640, size[1] / 480
    lefts, tops, widths = range(0, 400, 37), range(0, 240, 41), range(2, 100, 11)
    targets = [(x, y, 2 * width, 90) for x in lefts for y in tops for width in widths]
    for less, counts in ((0, True), (0.1, False)):
        boxes = read(
            *(
                answer(
                    predBox=[x * across, y * down, (width / 2 - less) * across, height * down],
                    predImageSize=size,
                )
                for x, y, width, height in targets
            )
        ).boxes
        assert set(box_match(boxes.xywh, np.array(targets)).tolist()) == {counts}


# Beside other answers.


@pytest.mark.parametrize("named", [-1, "None", "-1", "", np.int64(-1)], ids=repr)
@pytest.mark.parametrize("key", ["predObjId", "pred_objid", "pred_obj_id"])
def test_a_box_together_with_an_abstention(key: str, named: object) -> None:
    predictions = read(answer(**{key: named}))
    assert predictions.boxes.xywh.tolist() == [BOX]
    assert (predictions.predicted_object.tolist(), predictions.read_as) == ([-1], [])


@pytest.mark.parametrize("key", ["predObjId", "pred_objid", "pred_obj_id"])
def test_null_beside_a_box_is_not_an_answer(key: str) -> None:
    predictions = read(answer(**{key: None}))
    assert predictions.boxes.xywh.tolist() == [BOX]
    assert predictions.read_as == [f"1 records with null under {key}, beside an answer"]


@pytest.mark.parametrize("other", [[1, 2, 3, 4], [9, 8, 7, 6.5]], ids=str)
def test_two_boxes_under_two_spellings(other: list[float]) -> None:
    (problem,) = read_predictions([answer(predBox=[1, 2, 3, 4.5], pred_box=other)]).problems
    assert (problem.code, problem.where) == ("two-answers", "[0]")


@pytest.mark.parametrize(
    ("fields", "named"),
    [
        pytest.param({"predObjId": 3}, 3, id="beside an object"),
        pytest.param({"pred_objid": "3"}, 3, id="beside an object under another key"),
        pytest.param({"predObjId": -1}, -1, id="beside an abstention"),
    ],
)
def test_a_null_box_is_not_an_answer(fields: Mapping[str, Any], named: int) -> None:
    predictions = read(answer(predBox=None, **fields))
    assert (predictions.predicted_object.tolist(), len(predictions.boxes.row)) == ([named], 0)


def test_a_null_box_alone_is_no_answer() -> None:
    """Nobody writes it on purpose: more likely the box was lost."""
    (problem,) = read_predictions([answer(predBox=None)] * 3).problems
    assert (problem.code, problem.where) == ("missing-field", "[0].predBox")
    assert problem.message.startswith("3 records have a null predBox and no object id; write ")


def test_a_file_without_boxes_has_none() -> None:
    for fields in ({"predBox": WITHOUT, "predObjId": 3}, {"predBox": None, "predObjId": -1}):
        boxes = read_predictions(json.dumps([answer(**fields)]).encode()).boxes
        shapes = [boxes.row.shape, boxes.xywh.shape, boxes.camera.shape, boxes.is_cut.shape]
        assert shapes == [(0,), (0, 4), (0, 2), (0,)]
