"""Whether the agent predicted the right object, by its id, a box or a point: a value per episode.

Points and outlines are headings and elevations in turns, as SOON's agents submit them: heading /
2 pi, and (elevation + pi) / 2 pi. They are compared as plain numbers, as its evaluators do: a point
a whole turn away is another one, and an outline across heading 0 is not the one that is seen.
"""

from typing import Literal, NamedTuple

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.geometry import are_inside

ABSTAINED = -1
"""The predicted object of an answer without one; a target's id is never negative."""

IOU_THRESHOLD = 0.5
"""A predicted box is correct if its intersection over union with the target's is at least this.

Source: Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in Real Indoor
Environments", CVPR 2020, section 3 on the evaluation of REVERIE success.
"""

LOOSE_IOU_THRESHOLD, STRICT_IOU_THRESHOLD = 0.25, 0.75
"""Reported along with the benchmark's own threshold, to separate near misses from exact boxes."""

# Share of an area by which rounding may miss a tie. One pixel of a whole image is 3e-6.
_TIE = 1e-9


def candidate_match(predicted_object: IntArray, target_object: IntArray) -> BoolArray:
    """Whether the predicted object is the target, per episode.

    Parameters
    ----------
    predicted_object : int array of shape (n_episodes,)
        Object id within the scan, or -1 if the agent predicted no object.
    target_object : int array of shape (n_episodes,)
        Object id within the scan, at least 0.

    Returns
    -------
    bool array of shape (n_episodes,)
        True is better. An abstention is never correct.

    References
    ----------
    .. [1] ``eval_release.py`` lines 77-81 of the dataset's repository: the two ids are compared
       as text, and where the agent stopped does not matter.

    Examples
    --------
    >>> candidate_match(np.array([7, 7, -1]), np.array([7, 8, 9]))
    array([ True, False, False])
    """
    return np.equal(predicted_object, target_object)


def remote_grounding_success(
    is_correct: BoolArray,
    success: BoolArray,
    needs_success: bool,  # noqa: FBT001
) -> BoolArray:
    """Whether the answer counts as correct, per episode.

    Parameters
    ----------
    is_correct : bool array of shape (n_episodes,)
        Whether the predicted object or box is the target's.
    success : bool array of shape (n_episodes,)
        Whether the agent stopped on a goal viewpoint.
    needs_success : bool
        Whether a correct answer counts only with success: the paper's text requires it, the
        dataset's own script does not [1]_.

    Returns
    -------
    bool array of shape (n_episodes,)
        True is better.

    References
    ----------
    .. [1] Qi et al., REVERIE, CVPR 2020, section 3; ``eval_release.py`` lines 77-81.
    """
    return is_correct & success if needs_success else is_correct


class Overlap(NamedTuple):
    """Areas of pairs of shapes, from which the IoU is computed."""

    intersection: FloatArray
    """Shape (n,): area that both shapes cover."""
    total: FloatArray
    """Shape (n,): sum of the two areas; positive."""

    def iou(self) -> FloatArray:
        """Intersection over union, in [0, 1]; higher is better."""
        return self.intersection / (self.total - self.intersection)

    def reaches(self, threshold: float) -> BoolArray:
        """Whether the IoU is at least the threshold, a number in (0, 1]; a tie counts.

        For whole pixels of a 640 x 480 image and the thresholds 1/4, 1/2 and 3/4 the comparison is
        exact. Boxes scaled from another image size, or warped, are off by some 1e-16 of their
        coordinates, so an IoU below the threshold by less than 1e-9 of it is a tie too.
        """
        # I / (A + B - I) >= t without the division, which would round.
        needed = threshold * self.total * (1 - _TIE)
        return np.greater_equal((1 + threshold) * self.intersection, needed)


def box_overlap(predicted_box_xywh: Array, target_box_xywh: Array) -> Overlap:
    """Overlap of boxes, pair by pair.

    Parameters
    ----------
    predicted_box_xywh, target_box_xywh : float or int arrays of shape (n, 4)
        Left, top, width and height in pixels of the same view; width and height are positive
        and exclusive: the right edge is ``x + w``. A box without area overlaps nothing.

    Returns
    -------
    Overlap
        Areas in square pixels.
    """
    # Bundles hold boxes in 16 bits, which the area of a picture would overflow.
    first_x, first_y, first_width, first_height = np.asarray(predicted_box_xywh, np.float64).T
    second_x, second_y, second_width, second_height = np.asarray(target_box_xywh, np.float64).T
    across = _shared_length(first_x, first_width, second_x, second_width)
    down = _shared_length(first_y, first_height, second_y, second_height)
    return Overlap(across * down, first_width * first_height + second_width * second_height)


def _shared_length(
    first: FloatArray, first_size: FloatArray, second: FloatArray, second_size: FloatArray
) -> FloatArray:
    end = np.minimum(first + first_size, second + second_size)
    return np.asarray(np.maximum(end - np.maximum(first, second), 0))


def box_iou(predicted_box_xywh: Array, target_box_xywh: Array) -> FloatArray:
    """Intersection over union of boxes, pair by pair.

    Parameters are those of :func:`box_overlap`.

    Returns
    -------
    float array of shape (n,)
        In [0, 1], higher is better; 0 if the boxes only touch.

    Examples
    --------
    >>> box_iou(np.array([[0.0, 0, 3, 1]]), np.array([[1.0, 0, 3, 1]]))
    array([0.5])
    """
    return box_overlap(predicted_box_xywh, target_box_xywh).iou()


def box_match(
    predicted_box_xywh: Array,
    target_box_xywh: Array,
    threshold: float = IOU_THRESHOLD,
) -> BoolArray:
    """Whether a predicted box is correct: its IoU is at least the threshold.

    Parameters
    ----------
    predicted_box_xywh, target_box_xywh : float or int arrays of shape (n, 4)
        As for :func:`box_overlap`.
    threshold : float
        In (0, 1]; the benchmark's own is one half [1]_.

    Returns
    -------
    bool array of shape (n,)
        True is better.

    References
    ----------
    .. [1] :data:`reverie_eval.metrics.IOU_THRESHOLD` and the source given there.

    Examples
    --------
    >>> box_match(np.array([[0.0, 0, 3, 1]]), np.array([[1.0, 0, 3, 1]]))
    array([ True])
    """
    return box_overlap(predicted_box_xywh, target_box_xywh).reaches(threshold)


def iou(overlap: Overlap, row: IntArray, n_episodes: int) -> FloatArray:
    """IoU of the predicted boxes, per episode.

    Parameters
    ----------
    overlap : Overlap
        The overlap of each predicted box with the target's.
    row : int array of shape (n_boxes,)
        The episode of each box.
    n_episodes : int
        Number of episodes.

    Returns
    -------
    float array of shape (n_episodes,)
        In [0, 1], higher is better; 0 where the answer is not a box.
    """
    return _per_episode(overlap.iou(), row, n_episodes)


def iou_reaches(threshold: float, overlap: Overlap, row: IntArray, n_episodes: int) -> FloatArray:
    """Whether the IoU is at least a threshold, per episode.

    ``threshold`` is in (0, 1]; the other parameters are those of :func:`iou`.

    Returns
    -------
    float array of shape (n_episodes,)
        0 or 1, higher is better; 0 where the answer is not a box.
    """
    return _per_episode(overlap.reaches(threshold), row, n_episodes)


def _per_episode(values: Array, row: IntArray, n_episodes: int) -> FloatArray:
    # An episode has at most one box, so nothing is overwritten.
    column = np.zeros(n_episodes)
    column[row] = values
    return column


def detection_success(point: FloatArray, outline: FloatArray) -> BoolArray:
    """Whether the point is inside the target's outline as seen from the stop, per episode.

    Parameters
    ----------
    point : float array of shape (n_episodes, 2)
        NaN where the agent predicts no point.
    outline : float array of shape (n_episodes, 5, 2)
        Centre and corners; NaN where the target is not seen. On the border is outside.

    Returns
    -------
    bool array of shape (n_episodes,)
        True is better.

    References
    ----------
    .. [1] ``evaluation_script/main.py`` lines 96-121 of ZhuFengdaaa/SOON-EvalAI-Starters at
       66f5e37; the comparison is that of ``shapely.Polygon.contains``.
    """
    # The first of the five is the centre.
    return are_inside(point, outline[:, 1:])


def heading_error(point: FloatArray, outline: FloatArray) -> FloatArray:
    """Difference in heading from the target's centre, per episode.

    Parameters and source are those of :func:`detection_success`.

    Returns
    -------
    float array of shape (n_episodes,)
        Turns, at least 0, lower is better; NaN where there is no point, or the target is not seen.
    """
    # Not wrapped around: the official script compares plain numbers, and digits must be its own.
    return np.abs(outline[:, 0, 0] - point[:, 0])


def elevation_error(point: FloatArray, outline: FloatArray) -> FloatArray:
    """Difference in elevation from the target's centre; otherwise as :func:`heading_error`."""
    return np.abs(outline[:, 0, 1] - point[:, 1])


def point_error(
    heading_error: FloatArray,
    elevation_error: FloatArray,
    detected: BoolArray,
    point_errors: Literal["detections", "where the target is seen"],
) -> FloatArray:
    """Distance of the point from the target's centre, per episode.

    Parameters
    ----------
    heading_error, elevation_error : float arrays of shape (n_episodes,)
        Turns; NaN where there are none.
    detected : bool array of shape (n_episodes,)
        Whether the point is inside the outline.
    point_errors : "detections" or "where the target is seen"
        Which episodes have one; the official script takes detections.

    Returns
    -------
    float array of shape (n_episodes,)
        Turns, at least 0, lower is better; NaN for episodes that have none.

    Examples
    --------
    >>> errors = np.array([0.3, 0.3]), np.array([0.4, 0.4]), np.array([True, False])
    >>> point_error(*errors, "detections")
    array([0.5, nan])
    """
    # A plain distance of the two angles, without the cosine of the elevation.
    error = np.hypot(heading_error, elevation_error)
    return np.where(detected, error, np.nan) if point_errors == "detections" else error
