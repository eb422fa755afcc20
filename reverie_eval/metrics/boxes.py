"""How well two boxes in the same view agree."""

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.protocol import IOU_THRESHOLD


def box_iou(predicted_box_xywh: FloatArray, target_box_xywh: FloatArray) -> FloatArray:
    """Intersection over union of boxes, pair by pair.

    Parameters
    ----------
    predicted_box_xywh, target_box_xywh : float arrays of shape (n, 4)
        Left, top, width and height in pixels of the same view; width and height are positive
        and exclusive: the right edge is ``x + w``.

    Returns
    -------
    float array of shape (n,)
        In [0, 1], higher is better; 0 if the boxes only touch.

    Examples
    --------
    >>> box_iou(np.array([[0.0, 0, 3, 1]]), np.array([[1.0, 0, 3, 1]]))
    array([0.5])
    """
    intersection, total = _intersection_and_total_area(predicted_box_xywh, target_box_xywh)
    return intersection / (total - intersection)


def box_match(
    predicted_box_xywh: FloatArray,
    target_box_xywh: FloatArray,
    threshold: float = IOU_THRESHOLD,
) -> BoolArray:
    """Whether a box answers right: its IoU is at least the threshold.

    Decided without division: ``I / (A + B - I) >= t`` is ``(1 + t) I >= t (A + B)``, which at one
    half is ``3 I >= A + B`` and exact for whole pixels, also at the tie.

    Parameters
    ----------
    predicted_box_xywh, target_box_xywh : float arrays of shape (n, 4)
        As for :func:`box_iou`.
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
    intersection, total = _intersection_and_total_area(predicted_box_xywh, target_box_xywh)
    return (1 + threshold) * intersection >= threshold * total


def _intersection_and_total_area(
    first_xywh: FloatArray, second_xywh: FloatArray
) -> tuple[FloatArray, FloatArray]:
    first_end = first_xywh[:, :2] + first_xywh[:, 2:]
    second_end = second_xywh[:, :2] + second_xywh[:, 2:]
    overlap = np.minimum(first_end, second_end) - np.maximum(first_xywh[:, :2], second_xywh[:, :2])
    intersection = np.maximum(overlap, 0).prod(axis=1)
    total = first_xywh[:, 2:].prod(axis=1) + second_xywh[:, 2:].prod(axis=1)
    return intersection, total
