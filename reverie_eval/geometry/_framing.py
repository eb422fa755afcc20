"""Boxes of any orientation in the world, and their bounding rectangles in each of the 36 views.

A view shows what lies in its frustum: the pyramid that projects into the image, beyond ``NEAR``.
The visible part of a box is the intersection of box and frustum, a convex polyhedron, so the
projections of its corners bound the rectangle. Each corner is an end of an edge of the box clipped
to the frustum, or of an edge of the frustum clipped to the box.

Clipping comes before projection. So nothing behind the camera is mirrored into the image, and
the rectangle surrounds the visible part only, unlike the published boxes, which were cut to the
image after projection. A camera inside a box sees the box everywhere, in every view.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, frozen
from reverie_eval.geometry._views import FOCAL_LENGTH, HEIGHT, NEAR, VIEW_AXES, WIDTH, pixels_of

CORNER_SIDES: FloatArray = frozen(np.array(list(product((-1.0, 1.0), repeat=3))))
"""Shape (8, 3): the side of the centre on which each corner lies, along each axis."""


EDGES: IntArray = frozen(
    np.array(
        [
            (a, b)
            for a in range(len(CORNER_SIDES))
            for b in range(a)
            if np.count_nonzero(CORNER_SIDES[a] != CORNER_SIDES[b]) == 1
        ]
    )
)
"""Shape (12, 2): the two corners of each edge."""


@dataclass(frozen=True, eq=False, slots=True)
class OrientedBoxes:
    """Boxes in a metric frame, the world's or a camera's."""

    centre: FloatArray
    """Shape (n, 3)."""
    axes: FloatArray
    """Shape (n, 3, 3): rows of orthogonal unit vectors."""
    radii: FloatArray
    """Shape (n, 3): metres from the centre to the faces, along each axis; not negative."""

    @classmethod
    def along(
        cls,
        centre: FloatArray,
        first_axis: FloatArray,
        second_axis: FloatArray,
        radii: FloatArray,
    ) -> Self:
        """Build boxes from two of their axes; the third is the cross product.

        All arrays have the shape (n, 3). Axes may have any length. If they are not quite
        orthogonal, as when they were written with a few digits, the second is made so.

        >>> up, rightish = np.array([[0.0, 0.0, 2.0]]), np.array([[1.0, 0.0, 0.1]])
        >>> OrientedBoxes.along(np.zeros((1, 3)), up, rightish, np.ones((1, 3))).axes[0].tolist()
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        """
        first, second = _unit(first_axis), _scaled(second_axis)
        second = _unit(second - (second * first).sum(axis=-1, keepdims=True) * first)
        axes = np.stack([first, second, np.cross(first, second)], axis=-2)
        return cls(centre, axes, radii)

    def __len__(self) -> int:
        return len(self.centre)

    def __getitem__(self, which: IntArray | BoolArray) -> Self:
        return type(self)(self.centre[which], self.axes[which], self.radii[which])

    def seen_by(self, position: FloatArray, camera_axes: FloatArray) -> Self:
        """Return the boxes in the frames of cameras, one camera per box.

        Parameters
        ----------
        position : float array, shape (3,)
            Of all cameras.
        camera_axes : float array, shape (n, 3, 3)
            The unit vectors right, up and forward of each camera, as rows.
        """
        centre: FloatArray = np.einsum("nj,nij->ni", self.centre - position, camera_axes)
        return type(self)(centre, np.einsum("naj,nij->nai", self.axes, camera_axes), self.radii)

    def corners(self) -> FloatArray:
        """Shape (n, 8, 3): the corners, in the order of ``CORNER_SIDES``."""
        half_edges = self.axes * self.radii[:, :, None]
        return np.asarray(self.centre[:, None] + np.einsum("ca,nai->nci", CORNER_SIDES, half_edges))


def _unit(vectors: FloatArray) -> FloatArray:
    vectors = _scaled(vectors)
    return np.asarray(vectors / np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True)))


def _scaled(vectors: FloatArray) -> FloatArray:
    """Scale vectors to a length near 1, so that their squares neither overflow nor underflow."""
    # Dividing by a power of two changes no digit.
    _, exponent = np.frexp(np.abs(vectors).max(axis=-1, keepdims=True))
    return np.asarray(np.ldexp(vectors, -exponent))


# Metres from the optical axis to the image's edges, one metre in front of the camera.
_RIGHT, _UP = WIDTH / 2 / FOCAL_LENGTH, HEIGHT / 2 / FOCAL_LENGTH

# Inward normals of the frustum's sides, which meet at the camera.
_SIDES = np.array([(-1, 0, _RIGHT), (1, 0, _RIGHT), (0, -1, _UP), (0, 1, _UP)])
_SIDES /= np.linalg.norm(_SIDES, axis=1, keepdims=True)

_NEAR_CORNERS = NEAR * np.array(
    [(-_RIGHT, -_UP, 1), (_RIGHT, -_UP, 1), (_RIGHT, _UP, 1), (-_RIGHT, _UP, 1)]
)
_FRUSTUM_STARTS = np.concatenate([_NEAR_CORNERS, _NEAR_CORNERS])
_FRUSTUM_STEPS = np.concatenate([np.roll(_NEAR_CORNERS, -1, axis=0) - _NEAR_CORNERS, _NEAR_CORNERS])
# Edges of the frustum: four around its near face, and four that leave it and never end.
_FRUSTUM_ENDS = np.repeat([1.0, np.inf], 4)

# Metres from a plane within which a point counts as lying in it.
#
# The upper and lower rows of views end at the horizon, so the top of a table at eye height lies in
# that plane. Rounding errors, some 1e-15 metres in a building, must not decide whether it is shown.
_SLACK = 1e-9
# Decimals to which pixels are rounded before they become whole, so that all machines agree.
_DECIMALS = 6


class BoxesInViews(NamedTuple):
    """The boxes that each view shows, sorted by box and view, and their pixels."""

    box: IntArray
    """Shape (k,): rows of the oriented boxes."""
    view: IntArray
    """Shape (k,): 0 to 35."""
    box_xywh: IntArray
    """Shape (k, 4): left, top, width and height in whole pixels, within the image."""


def boxes_in_views(position: FloatArray, boxes: OrientedBoxes) -> BoxesInViews:
    """Return the rectangle of whole pixels around each oriented box in each of the 36 views.

    A pixel is covered if its centre is. Boxes that cover no pixel of a view are left out, so that
    x >= 0, y >= 0, w >= 1, h >= 1, x + w <= 640 and y + h <= 480. ``position``, shape (3,), is the
    camera's in the world, where the boxes are too.

    References
    ----------
    .. [1] Qi et al., "REVERIE", CVPR 2020, section 3: corners of a three-dimensional box
       projected into the views. The published files show that extents are exclusive and that
       boxes are cut to the image.

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


def bounds_in_views(
    position: FloatArray, boxes: OrientedBoxes
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the box and the view of each box in a view, and its unrounded bounds.

    Bounds, shape (k, 4), are left, top, right and
    bottom in pixels, within the image.
    """
    box, view = _near_frustum(position, boxes)
    seen = boxes[box].seen_by(position, VIEW_AXES[view])
    pixels, within = _shown_corners(seen)
    low = np.where(within, pixels, np.inf).min(axis=1, initial=np.inf)
    high = np.where(within, pixels, -np.inf).max(axis=1, initial=-np.inf)
    shown = within.any(axis=(1, 2))
    bounds = np.concatenate([low, high], axis=1)[shown]
    # Projected corners of the frustum are those of the image up to the last bit.
    bounds = np.clip(bounds, 0, [WIDTH, HEIGHT, WIDTH, HEIGHT])
    return box[shown], view[shown], bounds


def _near_frustum(position: FloatArray, boxes: OrientedBoxes) -> tuple[IntArray, IntArray]:
    """Return the pairs of box and view in which the box's bounding sphere may reach the frustum.

    A cheap test that leaves few pairs for the clipping.
    """
    centre = np.einsum("nj,vij->nvi", boxes.centre - position, VIEW_AXES)
    radius = np.sqrt((boxes.radii * boxes.radii).sum(axis=1))[:, None] + _SLACK
    reaches = centre[..., 2] - NEAR >= -radius
    for side in _SIDES:
        reaches &= (centre * side).sum(axis=-1) >= -radius
    box, view = np.nonzero(reaches)
    return box, view


def _shown_corners(seen: OrientedBoxes) -> tuple[FloatArray, BoolArray]:
    """Return pixels, shape (n, 40, 2), of possible corners of the visible parts, and which exist.

    Each of the 12 edges of a box and the 8 of the frustum has two ends.
    """
    start, step, enter, leave = (
        np.concatenate(both, axis=1)
        for both in zip(_edges_of_boxes(seen), _edges_of_frustum(seen), strict=True)
    )
    within = enter <= leave
    steps = np.where(within, [enter, leave], 0.0)[..., None]
    # Edges that are clipped away get a harmless point: their own may be infinite.
    corners = np.where(within[..., None], start + steps * step, (0.0, 0.0, NEAR))
    pixels = np.concatenate(list(pixels_of(corners)), axis=1)
    return pixels, np.tile(within, 2)[..., None]


# Edges by start and step, and where each enters and leaves a convex body, in steps from its start;
# it leaves before it enters if it is outside.
_ClippedEdges = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def _edges_of_boxes(seen: OrientedBoxes) -> _ClippedEdges:
    """Clip the edges of boxes in cameras' frames to the frustum."""
    corners = seen.corners()
    from_sides = np.einsum("...i,si->...s", corners, _SIDES)
    inside = np.concatenate([from_sides, corners[..., 2:] - NEAR], axis=-1)
    first, second = EDGES.T
    start, step = corners[:, first], corners[:, second] - corners[:, first]
    enter, leave = _clip(inside[:, first], inside[:, second] - inside[:, first], 1.0)
    return start, step, enter, leave


def _edges_of_frustum(seen: OrientedBoxes) -> _ClippedEdges:
    """Clip the frustum's edges to boxes in cameras' frames."""
    # In a box's own frame its faces are at plus and minus its radii.
    start = np.einsum("nei,nai->nea", _FRUSTUM_STARTS - seen.centre[:, None], seen.axes)
    step = np.einsum("ei,nai->nea", _FRUSTUM_STEPS, seen.axes)
    radii = seen.radii[:, None]
    inside = np.concatenate([radii - start, radii + start], axis=-1)
    enter, leave = _clip(inside, np.concatenate([-step, step], axis=-1), _FRUSTUM_ENDS)
    shape = len(seen), *_FRUSTUM_STARTS.shape
    starts, steps = (np.broadcast_to(each, shape) for each in (_FRUSTUM_STARTS, _FRUSTUM_STEPS))
    return starts, steps, enter, leave


def _clip(
    inside: FloatArray, gain: FloatArray, end: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where edges enter and leave a body bounded by planes, in steps from their starts.

    ``inside``, shape (..., n_planes), is metres from each plane inwards to the start of an edge;
    ``gain``, of that shape, the metres that each step leads farther inwards; ``end``, a number or
    shape (...), the length of the edge in steps.

    References
    ----------
    .. [1] Liang and Barsky, "A New Concept and Method for Line Clipping", ACM Transactions on
       Graphics 3(1), 1984.
    """
    inside, gain = (np.where(np.abs(metres) > _SLACK, metres, 0.0) for metres in (inside, gain))
    # An edge parallel to a plane never crosses it; `where` drops what the division gives there.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        crossing = -inside / gain
    enter = np.where(gain > 0, crossing, 0.0).max(axis=-1, initial=0.0)
    leave = np.minimum(np.where(gain < 0, crossing, np.inf).min(axis=-1, initial=np.inf), end)
    is_outside = ((gain == 0) & (inside < 0)).any(axis=-1)
    return enter, np.where(is_outside, -1.0, leave)
