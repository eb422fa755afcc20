"""Points in polygons, exactly."""

from fractions import Fraction

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray

_UNSURE = 1e-15
"""Share of its terms within which rounding may change the sign of an orientation: three times the
bound of Shewchuk, "Adaptive Precision Floating-Point Arithmetic", 1997, section 4.2."""


def are_inside(point: FloatArray, corners: FloatArray) -> BoolArray:
    """Whether each point is strictly inside its polygon; on the border is outside.

    Where the border crosses itself, what it winds around twice is outside. Signs are exact, so no
    rounding decides on which side of an edge a point is.

    Parameters
    ----------
    point : float array of shape (n, 2)
        NaN is outside.
    corners : float array of shape (n, n_corners, 2)
        In the order of the border; the last is joined with the first.

    Returns
    -------
    bool array of shape (n,)

    Examples
    --------
    >>> square = np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]] * 3)
    >>> are_inside(np.array([[0.5, 0.5], [1.0, 0.5], [0.5, 1.5]]), square)
    array([ True, False, False])
    """
    inside = np.zeros(len(point), dtype=np.bool_)
    on_border = np.zeros(len(point), dtype=np.bool_)
    height = point[:, 1]
    for index in range(corners.shape[1]):
        begin, end = corners[:, index - 1], corners[:, index]
        side = _side(point, begin, end)
        low, high = np.minimum(begin, end), np.maximum(begin, end)
        on_border |= (side == 0) & ((low <= point) & (point <= high)).all(axis=1)
        # A ray to the right meets an edge that goes up and has the point on its left, or down and
        # on its right. The lower end of an edge belongs to it, and the upper end does not.
        goes_up = begin[:, 1] < end[:, 1]
        spans = (low[:, 1] <= height) & (height < high[:, 1])
        inside ^= spans & np.where(goes_up, side > 0, side < 0)
    return inside & ~on_border


def _side(point: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Return 1 for points to the left of the way from begin to end, -1 for the right, else 0."""
    edge, to_point = end - begin, point - begin
    first, second = edge[:, 0] * to_point[:, 1], edge[:, 1] * to_point[:, 0]
    side = np.sign(first - second)
    unsure = np.abs(first - second) <= _UNSURE * (np.abs(first) + np.abs(second))
    for row in np.flatnonzero(unsure).tolist():
        side[row] = _exact_side(*point[row], *begin[row], *end[row])
    return side


def _exact_side(*coordinates: float) -> int:
    x, y, x0, y0, x1, y1 = map(Fraction, coordinates)
    area = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
    return (area > 0) - (area < 0)
