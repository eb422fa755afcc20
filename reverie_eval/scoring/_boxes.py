"""Predicted boxes, compared with the annotated ones: which are correct, and why others are not.

A box is compared with the target's annotated box in the same view at the viewpoint where the agent
stops. It is wrong if that view does not show the target.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.geometry import HEIGHT, WIDTH, is_on_grid, snap
from reverie_eval.ground_truth import Answers
from reverie_eval.metrics import IOU_THRESHOLD, Overlap, box_match, box_overlap
from reverie_eval.submissions import BoxAnswers

BOX_OUTCOMES = ("correct", "low IoU", "wrong view", "target not visible")
"""The outcomes of a predicted box."""


@dataclass(frozen=True, eq=False)
class BoxScores:
    """The predicted boxes of a submission, scored; one row each."""

    row: IntArray
    """Shape (n_boxes,): the episode, ascending."""
    overlap: Overlap
    """The overlap with the target's box; the intersection is 0 if the view does not show the
    target."""
    whole_image: Overlap
    """The overlap of a box around the whole image of that view."""
    is_visible: BoolArray
    """Shape (n_boxes,): whether the target is visible where the agent stops."""
    is_in_view: BoolArray
    """Shape (n_boxes,): whether the view of the predicted box shows the target."""
    is_ambiguous: BoolArray
    """Shape (n_boxes,): whether another object's box in that view overlaps the target's by an IoU
    of at least one half, so that a box around the wrong object counts as correct."""

    @cached_property
    def is_correct(self) -> BoolArray:
        """Shape (n_boxes,): whether the IoU is at least one half."""
        return self.overlap.reaches(IOU_THRESHOLD)

    @cached_property
    def outcome(self) -> IntArray:
        """Shape (n_boxes,): index into ``BOX_OUTCOMES``."""
        conditions = [self.is_correct, self.is_in_view, self.is_visible]
        return np.asarray(np.select(conditions, [0, 1, 2], default=3))

    @property
    def misses(self) -> Mapping[str, int]:
        """Number of wrong boxes by reason."""
        counts = np.bincount(self.outcome, minlength=len(BOX_OUTCOMES)).tolist()
        return dict(zip(BOX_OUTCOMES[1:], counts[1:], strict=True))

    @property
    def mean_iou(self) -> float:
        """Mean IoU over the boxes; that of a view without the target is 0."""
        return float(self.overlap.iou().mean())

    @property
    def whole_image_share(self) -> float:
        """Share of boxes that would be correct if each were the whole image."""
        return float(self.whole_image.reaches(IOU_THRESHOLD).mean())

    @property
    def ambiguous_share(self) -> float:
        """Share of ambiguous views among those that show the target; 0 if there are none."""
        return float(self.is_ambiguous.sum() / max(self.is_in_view.sum(), 1))

    def __len__(self) -> int:
        return len(self.row)


def score_boxes(
    boxes: BoxAnswers, stop: IntArray, target_object: IntArray, answers: Answers
) -> BoxScores:
    """Compare predicted boxes with the annotation.

    ``stop`` and ``target_object``, shape (n_episodes,), are the viewpoint where the agent stops and
    the target's object id.

    References
    ----------
    .. [1] Qi et al., REVERIE, CVPR 2020, section 3: a predicted box is correct if its IoU with the
       ground truth is at least one half, at any viewpoint that sees the target; the views are
       those of ``visible_pos`` in the dataset's box files.
    """
    view = snap(boxes.camera)
    candidate, is_visible = answers.find(target_object[boxes.row], stop[boxes.row])
    # Where nothing is found, `candidate` and `target` are those of another object: `is_visible`
    # and `is_in_view` mask whatever is computed from them.
    target, has_box = answers.boxes.find(candidate, view)
    is_in_view = is_visible & has_box
    target_xywh = answers.boxes.xywh[target]
    whole_image = np.broadcast_to([0.0, 0.0, WIDTH, HEIGHT], target_xywh.shape)
    return BoxScores(
        row=boxes.row,
        overlap=_masked(_overlap(boxes, view, target_xywh), is_in_view),
        whole_image=_masked(box_overlap(whole_image, target_xywh), is_in_view),
        is_visible=is_visible,
        is_in_view=is_in_view,
        is_ambiguous=is_in_view & _has_rival(target, answers),
    )


def _overlap(boxes: BoxAnswers, view: IntArray, target_xywh: IntArray) -> Overlap:
    """Return the overlap with the target's box; boxes from cameras off the grid are warped."""
    overlap = box_overlap(boxes.xywh, target_xywh)
    off_grid = np.flatnonzero(~is_on_grid(boxes.camera))
    if off_grid.size:
        # Importing shapely takes a third of the start-up time, and boxes in views do not need it.
        from reverie_eval.geometry._warping import polygon_overlap, warp

        polygons = warp(boxes.xywh[off_grid], boxes.camera[off_grid], view[off_grid])
        areas = polygon_overlap(polygons, target_xywh[off_grid])
        for column, warped in zip(overlap, areas, strict=True):
            column[off_grid] = warped
    return overlap


def _masked(overlap: Overlap, is_in_view: BoolArray) -> Overlap:
    """Set the intersection to 0 where the view does not show the target."""
    return overlap._replace(intersection=np.where(is_in_view, overlap.intersection, 0.0))


def _has_rival(target: IntArray, answers: Answers) -> BoolArray:
    """Whether another object's box in the same view would be accepted as each target's box."""
    box_xywh = answers.boxes.xywh
    index, other = answers.boxes.pair_with_others(target)
    is_rival = box_match(box_xywh[other], box_xywh[target[index]])
    # bincount has an entry for targets without any other object too; reduceat would not.
    return np.bincount(index, weights=is_rival, minlength=len(target)) > 0
