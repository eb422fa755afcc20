"""Outcomes of answers by box: worked out by hand in one bathroom, and on the published boxes."""

import gzip
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from reverie_eval import PROTOCOLS, GroundTruth, Scores, evaluate, evaluate_protocols
from reverie_eval.geometry import FAR_OFF, degrees_off, view_angles
from reverie_eval.metrics import box_iou
from reverie_eval.scoring import BoxScores
from reverie_eval.scoring._lookups import score_boxes
from reverie_eval.submissions import BoxAnswers
from tests.support.drawings import Record
from tests.support.metrics import BOX_METRICS
from tests.support.oracle import Item, Scan, Viewpoint, World
from tests.support.panorama import PICTURE, Box, camera_of, common, drawn_from
from tests.support.worlds import SPLIT, ground_truth_by_hand

TUB, SINK = 5, 6
BOXES: Mapping[tuple[int, int], Box] = {
    (TUB, 12): (100, 100, 60, 40),
    (SINK, 12): (300, 200, 50, 50),
    (TUB, 13): (200, 200, 90, 90),
    (SINK, 13): (200, 200, 90, 45),  # an IoU of one half with the tub
    (TUB, 14): (0, 0, 640, 240),  # half of the picture
    (SINK, 14): (0, 0, 640, 119),  # a row less than half of the tub
    (TUB, 15): (300, 220, 40, 40),
    (TUB, 18): (0, 0, 9, 9),
    (SINK, 18): (0, 0, 9, 9),
    (TUB, 24): (0, 0, 640, 239),  # a row less than half of the picture
    (SINK, 16): (100, 100, 60, 40),
}
BATH = Viewpoint(
    (8.0, 6.0, 0.0),
    views={TUB: [24, 13, 12, 15, 14, 18], SINK: [16, 14, 18, 12, 13]},  # in any order
    boxes=BOXES,
)
FLAT = Scan(
    {
        "door": Viewpoint((0.0, 0.0, 0.0), views={TUB: []}),  # listed, but not visible
        "hall": Viewpoint((8.0, 0.0, 0.0), views={SINK: [12]}, boxes={(SINK, 12): PICTURE}),
        "bath": BATH,
    },
    frozenset({("door", "hall"), ("hall", "bath")}),
    centres={TUB: (8.0, 7.0, 0.0)},
)
WALK = ["door", "hall", "bath"]


def answer(*fields: Any, at: str = "bath", camera: Sequence[float] = (0, 0)) -> Record:
    """Return the record of an agent that stops at a viewpoint, with these answer fields."""
    way = WALK[: WALK.index(at)]
    return {"trajectory": [*([place, 0, 0] for place in way), [at, *camera]], **dict(fields)}


def drawn(box: Sequence[float], view: int | None = None, **stop: Any) -> Record:
    """Return a record with an answer by box."""
    return answer(("predBox", box), ("predView", view), **stop)


def named(object_id: object, **stop: Any) -> Record:
    """Return a record with an object id."""
    return answer(("predObjId", object_id), **stop)


def submitted(records: Sequence[Record]) -> tuple[list[Record], GroundTruth]:
    """Return records as a submission, and a ground truth with as many episodes."""
    item = Item("7_1", "flat", WALK, TUB, instructions=len(records))
    submission = [{"instr_id": f"7_1_{row}", **record} for row, record in enumerate(records)]
    return submission, ground_truth_by_hand(World({"flat": FLAT}, [item]))


def scored(*records: Record, **how: Any) -> Scores:
    """Score records in the flat."""
    submission, truth = submitted(records)
    return evaluate(submission, split=SPLIT, ground_truth=truth, **how)


def judged(*records: Record) -> BoxScores:
    """Score records in the flat that all have an answer by box."""
    boxes = scored(*records).boxes
    assert boxes is not None
    assert boxes.row.tolist() == list(range(len(records)))
    return boxes


# One answer.


@pytest.mark.parametrize(
    ("record", "outcome", "iou"),
    [
        pytest.param(drawn([100, 100, 60, 40], 12), "correct", 1, id="the target's own box"),
        pytest.param(drawn([100, 100, 60, 40]), "correct", 1, id="in the view of the last pose"),
        pytest.param(drawn([200, 200, 90, 90], 13), "correct", 1, id="in any view that shows it"),
        pytest.param(
            drawn([0, 0, 640, 239], camera=(math.tau, math.pi / 6)), "correct", 1, id="upper view"
        ),
        pytest.param(drawn([100, 100, 30, 40], 12), "correct", 1 / 2, id="half of it"),
        pytest.param(drawn([100, 100, 60, 80], 12), "correct", 1 / 2, id="twice as much"),
        pytest.param(drawn([80, 100, 60, 40], 12), "correct", 1 / 2, id="shifted by a third"),
        pytest.param(drawn([100, 100, 29, 40], 12), "low IoU", 29 / 60, id="a column below half"),
        pytest.param(drawn([100, 100, 60, 81], 12), "low IoU", 40 / 81, id="a row too much"),
        pytest.param(drawn([79, 100, 60, 40], 12), "low IoU", 39 / 81, id="shifted by more"),
        pytest.param(drawn([100, 100, 45, 40], 12), "correct", 3 / 4, id="three quarters"),
        pytest.param(drawn([100, 100, 44, 40], 12), "correct", 44 / 60, id="almost"),
        pytest.param(drawn([100, 100, 30, 20], 12), "low IoU", 1 / 4, id="a quarter"),
        pytest.param(drawn([100, 100, 30, 19], 12), "low IoU", 570 / 2400, id="hardly"),
        pytest.param(drawn([160, 100, 60, 40], 12), "low IoU", 0, id="beside it"),
        pytest.param(drawn([300, 200, 50, 50], 12), "low IoU", 0, id="another object"),
        pytest.param(drawn([200, 200, 90, 45], 13), "correct", 1 / 2, id="another that is alike"),
        pytest.param(drawn([100, 100, 60, 40], 13), "low IoU", 0, id="its box of another view"),
        pytest.param(drawn([0, 0, 640, 480], 14), "correct", 1 / 2, id="the whole picture"),
        pytest.param(drawn([0, 0, 640, 480], 24), "low IoU", 239 / 480, id="and a smaller target"),
        pytest.param(drawn([-9, -9, 900, 249], 14), "correct", 1, id="cut to the picture"),
        pytest.param(drawn([900, 0, 5, 5], 14), "low IoU", 0, id="outside the picture"),
        pytest.param(
            drawn([900, 120, 5, 5], camera=(1.2, 0)), "low IoU", 0, id="outside, off the grid"
        ),
        pytest.param(drawn([100, 100, 60, 40], 16), "wrong view", 0, id="a view of the sink"),
        pytest.param(drawn([100, 100, 60, 40], 0), "wrong view", 0, id="a view of nothing"),
        pytest.param(
            drawn([64, 0, 64, 64], camera=(0, math.pi / 6)),
            "low IoU",
            64 / (10 * 239),
            id="a small box in the upper view",
        ),
        pytest.param(
            drawn([100, 100, 60, 40], 12, at="hall"), "target not visible", 0, id="next door"
        ),
        pytest.param(
            drawn([1, 2, 30, 40], 12, at="door"), "target not visible", 0, id="listed in no view"
        ),
        pytest.param(named(TUB), "", 0, id="a candidate"),
        pytest.param(named(-1), "", 0, id="no answer"),
    ],
)
def test_one_answer(record: Record, outcome: str, iou: float) -> None:
    scores = scored(record, drawn([0, 0, 1, 1], 14))
    episode = {key: column.tolist()[0] for key, column in scores.episodes.items()}
    assert scores.box_outcomes[0] == outcome
    assert [episode[key] for key in ("iou", "iou_25", "iou_50", "iou_75")] == [
        iou,
        iou >= 1 / 4,
        iou >= 1 / 2,
        iou >= 3 / 4,
    ]
    assert episode["rgs"] == (outcome == "correct" or record.get("predObjId") == TUB)
    assert episode["rgspl"] == episode["rgs"]


def test_a_box_in_an_image_of_another_size() -> None:
    small = {**drawn([50, 25, 30, 10], 12), "predImageSize": [320, 120]}
    assert judged(small).overlap.iou().tolist() == [1]


# Cameras off the grid, which look 10 or 16 degrees away from view 15 (east). The tub spans 2.7545
# degrees to each side of the middle of that view: 20 of 415.69 pixels. A camera that looks past it
# by 10 degrees has its edges at 415.69 times the tangents of 7.2455 and 12.7545 degrees.

FROM_THE_RIGHT = [225.90, 219.52, 41.25, 40.96]
FROM_ABOVE = [299.52, 292.85, 40.96, 41.25]


@pytest.mark.parametrize(
    ("box", "degrees", "outcome"),
    [
        pytest.param(FROM_THE_RIGHT, (100, 0), "correct", id="10 degrees to the right"),
        pytest.param(FROM_ABOVE, (90, 10), "correct", id="10 degrees up"),
        pytest.param(FROM_ABOVE, (450, 10), "correct", id="after a full turn"),
        pytest.param(FROM_THE_RIGHT, (80, 0), "low IoU", id="10 degrees to the left"),
        pytest.param(FROM_ABOVE, (90, -10), "low IoU", id="10 degrees down"),
        pytest.param([300, 220, 40, 40], (100, 0), "low IoU", id="as in the view"),
        pytest.param([900, 220, 40, 40], (100, 0), "low IoU", id="outside the picture"),
        pytest.param(FROM_THE_RIGHT, (106, 0), "wrong view", id="nearer to the next view"),
        pytest.param(FROM_ABOVE, (90, 16), "wrong view", id="nearer to the upper view"),
    ],
)
def test_a_box_from_a_camera_off_the_grid(
    box: list[float], degrees: tuple[float, float], outcome: str
) -> None:
    scores = scored(drawn(box, camera=[*map(math.radians, degrees)]))
    assert scores.box_outcomes == [outcome]
    assert (scores["rgs"], scores["iou"] > 0.95) == (outcome == "correct", outcome == "correct")


@pytest.mark.parametrize("box", [FROM_THE_RIGHT, FROM_ABOVE], ids=["to the right", "up"])
def test_the_same_box_without_warping_is_wrong(box: list[float]) -> None:
    assert judged(drawn(box, 15)).overlap.iou().tolist() == [0]


def test_a_camera_close_to_a_view_counts_as_the_view() -> None:
    east = math.pi / 2
    near, far = (drawn([300, 220, 40, 40], camera=(east + off, 0)) for off in (0.0009, 0.0011))
    iou = judged(near, far).overlap.iou().tolist()
    assert iou[0] == 1
    assert 0.95 < iou[1] < 1


def test_cameras_on_and_off_the_grid_in_one_submission() -> None:
    to_the_right = drawn(FROM_THE_RIGHT, camera=(math.radians(100), 0))
    boxes = judged(drawn([100, 100, 60, 40], 12), to_the_right, drawn([100, 100, 30, 40], 12))
    assert boxes.overlap.iou().tolist() == [1, pytest.approx(0.98, abs=0.02), 0.5]
    assert boxes.whole_image.iou().tolist() == [2400 / 307200, 1600 / 307200, 2400 / 307200]


# Many answers.

EVERYTHING = (
    drawn([200, 200, 90, 45], 13),  # the sink, which looks alike
    drawn([0, 0, 64, 64], 14),
    drawn([100, 100, 45, 40], 12),
    drawn([0, 0, 640, 480], 24),
    drawn([100, 100, 60, 40], 16),
    drawn([100, 100, 60, 40], 17),
    drawn([100, 100, 60, 40], 12, at="hall"),
    drawn([100, 100, 60, 40], 12, at="door"),
)


def test_outcomes_are_counted() -> None:
    boxes = judged(*EVERYTHING)
    assert (len(boxes), int(boxes.is_correct.sum())) == (8, 2)
    assert dict(boxes.misses) == {"low IoU": 2, "wrong view": 2, "target not visible": 2}
    assert boxes.is_in_view.tolist() == [True] * 4 + [False] * 4
    assert boxes.is_visible.tolist() == [True] * 6 + [False] * 2
    assert boxes.mean_iou == pytest.approx((1 / 2 + 64 / 2400 + 3 / 4 + 239 / 480) / 8)


def test_the_whole_image_instead_of_each_box() -> None:
    """It is correct only for the tub that fills half of it."""
    boxes = judged(*EVERYTHING)
    assert boxes.whole_image_share == 1 / 8
    assert boxes.whole_image.reaches(0.5).tolist() == [False, True] + [False] * 6


def test_ambiguous_views() -> None:
    """The sink's box matches the tub's in view 13, and misses by one row in view 14."""
    boxes = judged(*EVERYTHING)
    assert boxes.is_ambiguous.tolist() == [True] + [False] * 7
    assert boxes.ambiguous_share == 1 / 4


def test_the_report_has_statistics_of_boxes() -> None:
    report = scored(*EVERYTHING).to_report()
    assert report.boxes is not None
    assert report.boxes.model_dump() == {
        "answers": 8,
        "correct": 2,
        "mean_iou": pytest.approx(0.2218, abs=1e-4),
        "whole_image": 0.125,
        "ambiguous_views": 0.25,
        "misses": {"low IoU": 2, "wrong view": 2, "target not visible": 2},
    }
    assert report.notes[0] == (
        "8 boxes predicted, 2 correct (misses: 2 low IoU, 2 wrong view, 2 target not visible), "
        "mean IoU 22.18 %; a box around the whole image would be correct in 12.50 %; 25.00 % of "
        "the views that show the target are ambiguous"
    )


def test_the_note_on_a_single_box() -> None:
    (note,) = scored(drawn([100, 100, 60, 40], 12)).notes
    assert note.startswith("1 box predicted, 1 correct (misses: 0 low IoU, ")


def test_no_view_shows_the_target() -> None:
    boxes = judged(*EVERYTHING[4:])
    assert (boxes.ambiguous_share, boxes.whole_image_share, boxes.mean_iou) == (0, 0, 0)


MIXED = (
    named(TUB, at="hall"),
    drawn([100, 100, 30, 40], 12),
    named(str(TUB)),
    drawn([100, 100, 60, 40], 16),
    named(SINK),
    drawn([100, 100, 60, 40], 12, at="hall"),
    named(-1),
    drawn([160, 100, 60, 40], 12),
)
RGS: Mapping[str, Sequence[int]] = {
    "official-v1": [1, 1, 1, 0, 0, 0, 0, 0],
    "paper": [0, 1, 1, 0, 0, 0, 0, 0],
    "paper-3m": [0, 1, 1, 0, 0, 0, 0, 0],
    "challenge-2022": [1, 1, 0, 0, 0, 0, 0, 0],
    "airbert": [1, 1, 1, 0, 0, 0, 0, 0],
    "duet": [1, 1, 1, 0, 0, 0, 0, 0],
    "scalevln": [0, 1, 1, 0, 0, 0, 0, 0],
}
"""RGS by protocol: some need success, and one rejects ids written as text."""


@pytest.mark.usefixtures("printed_protocols")
def test_every_protocol_scores_boxes_and_candidates_together() -> None:
    submission, truth = submitted(MIXED)
    results = evaluate_protocols(submission, split=SPLIT, ground_truth=truth)
    assert {
        name: scores.episodes["rgs"].tolist() for name, scores in results.items() if "rgs" in scores
    } == RGS
    for name in RGS:
        assert results[name].episodes["iou"].tolist() == [0, 0.5, 0, 0, 0, 0, 0, 0]
        assert results[name].box_outcomes == results["paper"].box_outcomes
    assert results["paper"].box_outcomes == [
        *("", "correct", "", "wrong view", "", "target not visible", "", "low IoU")
    ]


def test_r2r_style_does_not_score_boxes() -> None:
    scores = scored(*MIXED, protocol="r2r-style")
    assert not {"rgs", "rgspl", *BOX_METRICS} & scores.keys()
    assert (scores.boxes, set(scores.box_outcomes)) == (None, {""})


def test_the_order_of_records_does_not_matter() -> None:
    submission, truth = submitted(MIXED)
    there, back = (
        evaluate(records, split=SPLIT, ground_truth=truth)
        for records in (submission, submission[::-1])
    )
    assert back.box_outcomes == there.box_outcomes
    assert back.boxes is not None
    assert back.boxes.row.tolist() == [1, 3, 5, 7]
    for key in there:
        assert back.episodes[key].tolist() == there.episodes[key].tolist()


def test_the_grounding_track() -> None:
    """Every agent answers from the bath, whatever its trajectory."""
    scores = scored(*MIXED, track="grounding")
    assert list(scores) == ["rgs", "iou", "iou_25", "iou_50", "iou_75"]
    assert scores.episodes["rgs"].tolist() == [1, 1, 1, 0, 0, 1, 0, 0]
    assert scores.box_outcomes[5] == "correct"
    without_trajectories = [
        {key: value for key, value in record.items() if key != "trajectory"} for record in MIXED
    ]
    again = scored(*without_trajectories, track="grounding")
    assert again.box_outcomes == scores.box_outcomes
    assert again.notes == scores.notes


# The published boxes.


@pytest.mark.dataset
@pytest.mark.parametrize("split", ["val_seen", "val_unseen"])
@pytest.mark.parametrize("name", ["shortest", "mixed1"])
def test_annotated_boxes_score_the_same_as_target_ids(
    split: str, name: str, published: Path, published_bundles: Path
) -> None:
    """Per episode, in every column, under every protocol."""
    truth = _measured(GroundTruth.load(published_bundles / f"{split}.npz"))
    file = published / "reference" / "submissions" / f"{split}.{name}.json.gz"
    records = json.loads(gzip.decompress(file.read_bytes()))
    boxed = _boxed(records, truth)
    assert sum("predBox" in record for record in boxed) > len(records) / 4
    by_name, by_box = (
        evaluate_protocols(submission, split=split, ground_truth=truth)
        for submission in (records, boxed)
    )
    assert by_name.keys() == by_box.keys() == PROTOCOLS.keys()
    for protocol, scores in by_name.items():
        for key, column in scores.episodes.items():
            assert by_box[protocol].episodes[key].tolist() == column.tolist(), (protocol, key)


N_DRAWN = 8000


@pytest.mark.dataset
def test_exact_boxes_by_cameras_off_the_grid(published_bundles: Path) -> None:
    """When warped, 91.1 % of 8,000 boxes are correct; when compared as they are, 13.1 %.

    The camera's own picture does not cut 68.8 % of the boxes: 99.8 % of these pass. Of those that
    are carried over by more than 15 degrees, 80.0 % pass, and of the others 93.2 %.
    """
    random = Random(0)
    is_correct: list[bool] = []
    is_right_raw: list[bool] = []
    is_whole: list[bool] = []
    is_far: list[bool] = []
    for split in ("val_seen", "val_unseen"):
        solution = GroundTruth.load(published_bundles / f"{split}.npz").require_solution()
        picked = random.sample(_unclipped(solution.boxes.xywh), N_DRAWN // 2)
        target, view = solution.boxes.xywh[picked].tolist(), solution.boxes.view[picked].tolist()
        camera = [_away(random, *camera_of(it)) for it in view]
        seen = list(map(drawn_from, camera, view, target))
        cut = [common(box, PICTURE) for box in seen]
        candidate = solution.boxes.candidate[picked]
        outcomes = score_boxes(
            BoxAnswers(
                row=np.arange(len(picked)),
                xywh=np.array(cut, float),
                camera=np.array(camera),
                is_cut=np.array(picked) < 0,
                uncut_xywh=np.array(cut, float),
                stop_angles=np.array(camera),
            ),
            stop=solution.candidate_viewpoint[candidate],
            target_object=solution.candidate_object[candidate],
            solution=solution,
        )
        assert outcomes.is_in_view.all()
        is_correct += outcomes.is_correct.tolist()
        is_right_raw += (box_iou(np.array(cut, float), np.array(target)) >= 0.5).tolist()
        is_whole += map(_is_within_picture, seen)
        is_far += (degrees_off(np.array(camera)) > FAR_OFF).tolist()
    assert len(is_correct) == N_DRAWN
    right, far = np.array(is_correct), np.array(is_far)
    passed = right, is_right_raw, right[is_whole], is_whole, right[far], right[~far]
    assert [round(100 * float(np.mean(share)), 1) for share in passed] == [
        *(91.1, 13.1, 99.8, 68.8),
        *(80.0, 93.2),
    ]


@pytest.mark.dataset
@pytest.mark.parametrize(
    ("split", "ambiguous", "whole_image"),
    [
        pytest.param("val_seen", (2.79, 8.7), (0.56, 2.5), id="val_seen"),
        pytest.param("val_unseen", (4.01, 9.6), (2.44, 8.5), id="val_unseen"),
    ],
)
def test_whole_image_and_ambiguous_shares_of_the_published_boxes(
    split: str,
    ambiguous: tuple[float, float],
    whole_image: tuple[float, float],
    published_bundles: Path,
) -> None:
    """Percentages of the views that show a target at its goal, and of items with such a view."""
    truth = GroundTruth.load(published_bundles / f"{split}.npz")
    solution = truth.require_solution()
    _, first_episode = np.unique(truth.episodes.item, return_index=True)
    goal, target = solution.goal[first_episode], solution.target_object[first_episode]
    candidate, _ = solution.find(target, goal)
    item, box = np.nonzero(candidate[:, None] == solution.boxes.candidate)
    outcomes = score_boxes(
        BoxAnswers(
            row=np.arange(len(box)),
            xywh=solution.boxes.xywh[box].astype(float),
            camera=view_angles(solution.boxes.view[box]),
            is_cut=np.zeros(len(box), dtype=bool),
            uncut_xywh=solution.boxes.xywh[box].astype(float),
            stop_angles=view_angles(solution.boxes.view[box]),
        ),
        stop=goal[item],
        target_object=target[item],
        solution=solution,
    )
    assert outcomes.is_correct.all()
    shares = outcomes.ambiguous_share, outcomes.whole_image_share
    assert [round(100 * share, 2) for share in shares] == [ambiguous[0], whole_image[0]]
    passes = outcomes.is_ambiguous, outcomes.whole_image.reaches(0.5)
    items = [len(np.unique(item[which])) / len(goal) for which in passes]
    assert [round(100 * share, 1) for share in items] == [ambiguous[1], whole_image[1]]


def _measured(truth: GroundTruth) -> GroundTruth:
    """Put every object close, as in v1, for the protocols that need object positions."""
    solution = truth.require_solution()
    measured = replace(
        solution,
        candidate_distance=np.zeros(len(solution.candidate_object)),
        target_position=truth.graph.viewpoint_position[solution.goal],
    )
    return replace(truth, solution=measured)


def _boxed(records: Sequence[Record], truth: GroundTruth) -> list[Record]:
    """Replace correct, visible object ids by the target's box, in one view after another."""
    solution, boxed = truth.require_solution(), []
    for number, record in enumerate(records):
        episode = truth.episodes.index[record["instr_id"]]
        target, stop = solution.target_object[episode], record["trajectory"][-1][0]
        candidate = (solution.candidate_viewpoint == truth.graph.index[stop]) & (
            solution.candidate_object == target
        )
        shown = np.flatnonzero(candidate[solution.boxes.candidate])
        if record["predObjId"] != target or not shown.size:
            boxed.append(record)
            continue
        box = shown[number % shown.size]
        view = int(solution.boxes.view[box])
        drawing = {"predBox": solution.boxes.xywh[box].tolist(), "predView": view, "predObjId": -1}
        boxed.append({**record, **drawing})
    return boxed


def _unclipped(xywh: np.ndarray) -> list[int]:
    """Return whether each box stays clear of the edges of its image."""
    left, top, width, height = xywh.T
    inside = (left > 0) & (top > 0) & (left + width < 640) & (top + height < 480)
    return np.flatnonzero(inside).tolist()


def _is_within_picture(box: Box) -> bool:
    left, top, width, height = box
    return left >= 0 and top >= 0 and left + width <= 640 and top + height <= 480


def _away(random: Random, heading: float, elevation: float) -> tuple[float, float]:
    """Turn a camera by up to 15 degrees each way."""
    most = math.pi / 12
    return heading + random.uniform(-most, most), elevation + random.uniform(-most, most)
