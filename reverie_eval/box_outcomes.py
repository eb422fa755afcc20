"""What becomes of answers that are boxes: which are right, and why the others are not.

A box is compared with the target's annotated box in the same view at the viewpoint where the agent
stops. A target that this view does not show, or that is not visible there at all, is a miss.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.geometry import HEIGHT, WIDTH, is_on_grid, snap
from reverie_eval.ground_truth import Answers
from reverie_eval.metrics import Overlap, box_match, box_overlap
from reverie_eval.protocol import IOU_THRESHOLD
from reverie_eval.reading import BoxAnswers

OUTCOMES = ("right", "low IoU", "wrong view", "target not visible")
"""What an answer by box can come to."""


@dataclass(frozen=True, eq=False)
class BoxOutcomes:
    """The answers that are boxes, judged; one row each."""

    row: IntArray
    """Shape (n_boxes,): the episode, ascending."""
    overlap: Overlap
    """With the target's box; nothing in common where the view does not show the target."""
    whole_image: Overlap
    """What the whole picture, drawn in the same view, would have in its place."""
    is_visible: BoolArray
    """Shape (n_boxes,): whether the target is visible where the agent stops."""
    is_in_view: BoolArray
    """Shape (n_boxes,): whether the view that was drawn in shows it."""
    is_ambiguous: BoolArray
    """Shape (n_boxes,): whether another object's box in that view overlaps the target's by an IoU
    of at least one half, so that a box around the wrong object passes."""

    @cached_property
    def is_right(self) -> BoolArray:
        """Shape (n_boxes,): whether the IoU is at least one half."""
        return self.overlap.reaches(IOU_THRESHOLD)

    @cached_property
    def outcome(self) -> IntArray:
        """Shape (n_boxes,): index into ``OUTCOMES``."""
        reasons = [self.is_right, self.is_in_view, self.is_visible]
        return np.asarray(np.select(reasons, [0, 1, 2], default=3))

    @property
    def misses(self) -> Mapping[str, int]:
        """How many are wrong, by reason."""
        counts = np.bincount(self.outcome, minlength=len(OUTCOMES)).tolist()
        return dict(zip(OUTCOMES[1:], counts[1:], strict=True))

    @property
    def mean_iou(self) -> float:
        """Mean over the boxes; 0 where the view does not show the target."""
        return float(self.overlap.iou().mean())

    @property
    def whole_image_share(self) -> float:
        """Share that would be right if the whole picture stood in their place."""
        return float(self.whole_image.reaches(IOU_THRESHOLD).mean())

    @property
    def ambiguous_share(self) -> float:
        """Of the views that show the target, the share that is ambiguous; 0 if none shows it."""
        return float(self.is_ambiguous.sum() / max(self.is_in_view.sum(), 1))

    def __len__(self) -> int:
        return len(self.row)


def judge_boxes(
    boxes: BoxAnswers, stop: IntArray, target_object: IntArray, answers: Answers
) -> BoxOutcomes:
    """Hold boxes against the annotation.

    Parameters
    ----------
    boxes : BoxAnswers
        Rows are episodes.
    stop, target_object : int arrays of shape (n_episodes,)
        The viewpoint where the agent stops, and the object that is meant.
    answers : Answers
        The split's candidates with their boxes.

    References
    ----------
    .. [1] Qi et al., REVERIE, CVPR 2020, section 3: a predicted box is right if its IoU with the
       ground truth is at least one half, at any viewpoint that sees the target; the views are
       those of ``visible_pos`` in the dataset's box files.
    """
    view = snap(boxes.camera)
    candidate, is_visible = answers.find(target_object[boxes.row], stop[boxes.row])
    target, has_box = answers.boxes.find(candidate, view)
    is_in_view = is_visible & has_box
    target_xywh = answers.boxes.xywh[target]
    picture = np.broadcast_to([0.0, 0.0, WIDTH, HEIGHT], target_xywh.shape)
    return BoxOutcomes(
        row=boxes.row,
        overlap=_only(is_in_view, _overlap(boxes, view, target_xywh)),
        whole_image=_only(is_in_view, box_overlap(picture, target_xywh)),
        is_visible=is_visible,
        is_in_view=is_in_view,
        is_ambiguous=is_in_view & _has_rival(target, answers),
    )


def _overlap(boxes: BoxAnswers, view: IntArray, target_xywh: IntArray) -> Overlap:
    """Overlap where the view shows the target; what another camera drew is carried over first."""
    overlap = box_overlap(boxes.xywh, target_xywh)
    off_grid = np.flatnonzero(~is_on_grid(boxes.camera))
    if off_grid.size:
        from reverie_eval.geometry.warping import polygon_overlap, warp

        polygons = warp(boxes.xywh[off_grid], boxes.camera[off_grid], view[off_grid])
        areas = polygon_overlap(polygons, target_xywh[off_grid])
        for column, carried_over in zip(overlap, areas, strict=True):
            column[off_grid] = carried_over
    return overlap


def _only(is_in_view: BoolArray, overlap: Overlap) -> Overlap:
    return overlap._replace(intersection=np.where(is_in_view, overlap.intersection, 0.0))


def _has_rival(target: IntArray, answers: Answers) -> BoolArray:
    """Whether another object's box in the same picture would pass for each target's box."""
    box_xywh = answers.boxes.xywh
    position, other = answers.boxes.beside(target)
    is_rival = box_match(box_xywh[other], box_xywh[target[position]])
    return np.bincount(position, weights=is_rival, minlength=len(target)) > 0
