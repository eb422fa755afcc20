"""The rectangle that a box in the world takes in the picture of each view.

A view shows what lies in its frustum: the pyramid of what projects into the picture, from ``NEAR``
on. What it shows of a box is again a body with flat faces, the frustum cut with the box, and its
picture is bounded by the pictures of its corners. Each of these lies at an end of an edge of the
box cut to the frustum, or of an edge of the frustum cut to the box.

So nothing behind the camera is mirrored into the picture, and boxes are cut to the picture before
they are bounded, not after, as those of the published files are. A camera within a box sees it
wherever it looks: the whole picture in every view.
"""

from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.geometry._oriented_boxes import EDGES, OrientedBoxes
from reverie_eval.geometry._projection import pixels_of
from reverie_eval.geometry._views import FOCAL_LENGTH, HEIGHT, NEAR, VIEW_AXES, WIDTH

_ACROSS, _UP = WIDTH / 2 / FOCAL_LENGTH, HEIGHT / 2 / FOCAL_LENGTH
"""Metres from the optical axis to the picture's sides, one metre before the camera."""

_SIDES = np.array([(-1, 0, _ACROSS), (1, 0, _ACROSS), (0, -1, _UP), (0, 1, _UP)])
"""Inward normals of the frustum's sides, which meet in the camera."""
_SIDES /= np.linalg.norm(_SIDES, axis=1, keepdims=True)

_NEAR_CORNERS = NEAR * np.array(
    [(-_ACROSS, -_UP, 1), (_ACROSS, -_UP, 1), (_ACROSS, _UP, 1), (-_ACROSS, _UP, 1)]
)
_FRUSTUM_STARTS = np.concatenate([_NEAR_CORNERS, _NEAR_CORNERS])
_FRUSTUM_STEPS = np.concatenate([np.roll(_NEAR_CORNERS, -1, axis=0) - _NEAR_CORNERS, _NEAR_CORNERS])
_FRUSTUM_ENDS = np.repeat([1.0, np.inf], 4)
"""Edges of the frustum: four around its near face, and four from there on without end."""

_SLACK = 1e-9
"""Metres from a plane up to which a point lies in it.

The horizon is where the upper and the lower row end, so a board at eye height lies in that plane.
Rounding, which moves the points of a building by some 1e-15 metres, must not decide there.
"""
_DECIMALS = 6
"""Pixels are rounded to these before they become whole, so that all machines agree."""


class BoundsInViews(NamedTuple):
    """Which boxes are in which views, sorted by box and view, and where."""

    box: IntArray
    """Shape (k,): rows of the oriented boxes."""
    view: IntArray
    """Shape (k,): 0 to 35."""
    bounds: FloatArray
    """Shape (k, 4): left, top, right and bottom in pixels, within the picture."""


class BoxesInViews(NamedTuple):
    """Which boxes are in which views, sorted by box and view, and in which pixels."""

    box: IntArray
    """Shape (k,): rows of the oriented boxes."""
    view: IntArray
    """Shape (k,): 0 to 35."""
    box_xywh: IntArray
    """Shape (k, 4): left, top, width and height in whole pixels, within the picture."""


def boxes_in_views(position: FloatArray, boxes: OrientedBoxes) -> BoxesInViews:
    """Return the box of whole pixels that each oriented box takes in each of the 36 views.

    A pixel belongs to it if its centre does. What covers no pixel's centre is left out.

    Parameters
    ----------
    position : float array of shape (3,)
        Where the camera stands in the world.
    boxes : OrientedBoxes
        In the world.

    Returns
    -------
    BoxesInViews
        With x >= 0, y >= 0, w >= 1, h >= 1, x + w <= 640 and y + h <= 480.

    References
    ----------
    .. [1] Qi et al., "REVERIE", CVPR 2020, section 3: corners of a three-dimensional box
       projected into the views. That extents are exclusive and boxes cut to the picture is
       measured on the published files.

    Examples
    --------
    >>> cube = OrientedBoxes(np.array([[0.0, 2, 0]]), np.eye(3)[None], np.full((1, 3), 0.5))
    >>> seen = boxes_in_views(np.zeros(3), cube)
    >>> seen.view.tolist()
    [0, 1, 11, 12, 13, 23, 24, 25, 35]
    >>> seen.box_xywh[3].tolist()
    [181, 101, 278, 278]
    """
    box, view, bounds = bounds_in_views(position, boxes)
    bounds = bounds.round(_DECIMALS)
    start = np.ceil(bounds[:, :2] - 0.5).astype(np.int64)
    end = np.floor(bounds[:, 2:] - 0.5).astype(np.int64) + 1
    shown = (start < end).all(axis=1)
    box_xywh = np.concatenate([start, end - start], axis=1)
    return BoxesInViews(box[shown], view[shown], box_xywh[shown])


def bounds_in_views(position: FloatArray, boxes: OrientedBoxes) -> BoundsInViews:
    """Return the exact bounds of each oriented box in each of the 36 views.

    Parameters are those of :func:`boxes_in_views`.
    """
    box, view = _perhaps_in_view(position, boxes)
    seen = boxes[box].seen_by(position, VIEW_AXES[view])
    pixels, within = _shown_corners(seen)
    low = np.where(within, pixels, np.inf).min(axis=1, initial=np.inf)
    high = np.where(within, pixels, -np.inf).max(axis=1, initial=-np.inf)
    shown = within.any(axis=(1, 2))
    bounds = np.concatenate([low, high], axis=1)[shown]
    # The corners of the frustum are the picture's but for the last bit.
    bounds = np.clip(bounds, 0, [WIDTH, HEIGHT, WIDTH, HEIGHT])
    return BoundsInViews(box[shown], view[shown], bounds)


def _perhaps_in_view(position: FloatArray, boxes: OrientedBoxes) -> tuple[IntArray, IntArray]:
    """Return the pairs of box and view where the ball around the box reaches into the frustum."""
    centre = np.einsum("nj,vij->nvi", boxes.centre - position, VIEW_AXES)
    radius = np.sqrt((boxes.radii * boxes.radii).sum(axis=1))[:, None] + _SLACK
    reaches = centre[..., 2] - NEAR >= -radius
    for side in _SIDES:
        reaches &= (centre * side).sum(axis=-1) >= -radius
    box, view = np.nonzero(reaches)
    return box, view


def _shown_corners(seen: OrientedBoxes) -> tuple[FloatArray, BoolArray]:
    """Pixels, shape (n, 40, 2), of what may be corners of the shown bodies, and which are."""
    start, step, enter, leave = (
        np.concatenate(both, axis=1)
        for both in zip(_edges_of_boxes(seen), _edges_of_frustum(seen), strict=True)
    )
    within = enter <= leave
    way = np.where(within, [enter, leave], 0.0)[..., None]
    corners = np.where(within[..., None], start + way * step, (0.0, 0.0, NEAR))
    pixels = np.concatenate(list(pixels_of(corners)), axis=1)
    return pixels, np.tile(within, 2)[..., None]


class _CutSegments(NamedTuple):
    """Segments, and the part of each, in steps from its start, that is within a body."""

    start: FloatArray
    step: FloatArray
    enter: FloatArray
    leave: FloatArray
    """Before ``enter`` if nothing is within."""


def _edges_of_boxes(seen: OrientedBoxes) -> _CutSegments:
    """Cut the edges of boxes in cameras' frames to the frustum."""
    corners = seen.corners()
    inside = np.concatenate([_depths_within_sides(corners), corners[..., 2:] - NEAR], axis=-1)
    first, second = EDGES.T
    start, step = corners[:, first], corners[:, second] - corners[:, first]
    enter, leave = _within(inside[:, first], inside[:, second] - inside[:, first], 1.0)
    return _CutSegments(start, step, enter, leave)


def _depths_within_sides(points: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...i,si->...s", points, _SIDES))


def _edges_of_frustum(seen: OrientedBoxes) -> _CutSegments:
    """Cut the frustum's edges to boxes in cameras' frames."""
    start = np.einsum("nei,nai->nea", _FRUSTUM_STARTS - seen.centre[:, None], seen.axes)
    step = np.einsum("ei,nai->nea", _FRUSTUM_STEPS, seen.axes)
    radii = seen.radii[:, None]
    inside = np.concatenate([radii - start, radii + start], axis=-1)
    enter, leave = _within(inside, np.concatenate([-step, step], axis=-1), _FRUSTUM_ENDS)
    shape = len(seen), *_FRUSTUM_STARTS.shape
    return _CutSegments(
        np.broadcast_to(_FRUSTUM_STARTS, shape),
        np.broadcast_to(_FRUSTUM_STEPS, shape),
        enter,
        leave,
    )


def _within(
    inside: FloatArray, gain: FloatArray, end: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where segments enter and leave a body that is bounded by planes, which belong to it.

    Parameters
    ----------
    inside : float array of shape (..., n_planes)
        Metres from each plane inwards to where a segment starts.
    gain : float array of shape (..., n_planes)
        Metres that a step of it leads farther inwards.
    end : float or float array of shape (...)
        How many steps it is long.

    References
    ----------
    .. [1] Liang and Barsky, "A New Concept and Method for Line Clipping", ACM Transactions on
       Graphics 3(1), 1984.
    """
    inside, gain = _without_rounding(inside), _without_rounding(gain)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        crossing = -inside / gain
    enter = np.where(gain > 0, crossing, 0.0).max(axis=-1, initial=0.0)
    leave = np.minimum(np.where(gain < 0, crossing, np.inf).min(axis=-1, initial=np.inf), end)
    passes_by = ((gain == 0) & (inside < 0)).any(axis=-1)
    return enter, np.where(passes_by, -1.0, leave)


def _without_rounding(distance: FloatArray) -> FloatArray:
    """Take what is within ``_SLACK`` of a plane for a part of it."""
    return np.where(np.abs(distance) > _SLACK, distance, 0.0)
