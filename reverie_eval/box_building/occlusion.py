"""Which boxes at a viewpoint are hidden by others, as the paper describes it."""

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray


def is_hidden(view: IntArray, box_xywh: IntArray, distance: FloatArray) -> BoolArray:
    """Whether each box lies wholly within the box of a nearer object in the same view.

    Boxes are held against all others, hidden ones included, so their order does not matter.
    Equal boxes count as within each other; equally distant ones hide nothing.

    Parameters
    ----------
    view : int array of shape (n,)
        The view that each box is in.
    box_xywh : int array of shape (n, 4)
        Left, top, width and height in pixels.
    distance : float array of shape (n,)
        Metres from the camera to the centre of the box's object.

    Returns
    -------
    bool array of shape (n,)

    References
    ----------
    .. [1] Qi et al., "REVERIE", CVPR 2020, section 3: a box that is fully covered by another and
       has a larger depth is removed.

    Examples
    --------
    >>> boxes = np.array([[0, 0, 9, 9], [0, 0, 9, 5], [0, 0, 9, 9]])
    >>> is_hidden(np.array([12, 12, 13]), boxes, np.array([1.0, 2.0, 2.0]))
    array([False,  True, False])
    """
    hidden = np.zeros(len(view), dtype=np.bool_)
    for shown in np.unique(view):
        rows = np.flatnonzero(view == shown)
        hidden[rows] = _is_hidden_here(box_xywh[rows], distance[rows])
    return hidden


def _is_hidden_here(box_xywh: IntArray, distance: FloatArray) -> BoolArray:
    """Whether each box of one view is hidden."""
    left, top, width, height = box_xywh.T
    right, bottom = left + width, top + height
    contains = (
        (left[:, None] <= left)
        & (top[:, None] <= top)
        & (right[:, None] >= right)
        & (bottom[:, None] >= bottom)
    )
    return np.asarray((contains & (distance[:, None] < distance)).any(axis=0))
