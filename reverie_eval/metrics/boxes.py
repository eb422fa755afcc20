"""How well two boxes in the same view agree."""

from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray
from reverie_eval.protocol import IOU_THRESHOLD


class Overlap(NamedTuple):
    """What pairs of shapes share, and what they come to: all that IoU needs to know."""

    intersection: FloatArray
    """Shape (n,): area that both cover."""
    total: FloatArray
    """Shape (n,): areas of the two, added; positive."""

    def iou(self) -> FloatArray:
        """Intersection over union, in [0, 1]; higher is better."""
        return self.intersection / (self.total - self.intersection)

    def reaches(self, threshold: float) -> BoolArray:
        """Whether the IoU is at least the threshold, a number in (0, 1].

        Decided without division: ``I / (A + B - I) >= t`` is ``(1 + t) I >= t (A + B)``, which at
        one half is ``3 I >= A + B`` and exact for whole pixels, also at the tie.
        """
        return np.greater_equal((1 + threshold) * self.intersection, threshold * self.total)


def box_overlap(predicted_box_xywh: Array, target_box_xywh: Array) -> Overlap:
    """Overlap of boxes, pair by pair.

    Parameters
    ----------
    predicted_box_xywh, target_box_xywh : float or int arrays of shape (n, 4)
        Left, top, width and height in pixels of the same view; width and height are positive
        and exclusive: the right edge is ``x + w``. A box without area overlaps nothing.
        Integers of any size: areas are computed in float64, which 16 bits would not hold.

    Returns
    -------
    Overlap
        Areas in square pixels.
    """
    first_x, first_y, first_width, first_height = np.asarray(predicted_box_xywh, np.float64).T
    second_x, second_y, second_width, second_height = np.asarray(target_box_xywh, np.float64).T
    across = _shared(first_x, first_width, second_x, second_width)
    down = _shared(first_y, first_height, second_y, second_height)
    return Overlap(across * down, first_width * first_height + second_width * second_height)


def _shared(
    first: FloatArray, first_size: FloatArray, second: FloatArray, second_size: FloatArray
) -> FloatArray:
    """Length that two intervals have in common."""
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
    """Whether a box answers right: its IoU is at least the threshold.

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
    .. [1] :data:`reverie_eval.protocol.IOU_THRESHOLD` and the source given there.

    Examples
    --------
    >>> box_match(np.array([[0.0, 0, 3, 1]]), np.array([[1.0, 0, 3, 1]]))
    array([ True])
    """
    return box_overlap(predicted_box_xywh, target_box_xywh).reaches(threshold)
