"""Solids: what the objects of a building look like, from their names and the boxes around them.

A box says how wide and high an object looks from a viewpoint. How deep it is, and what it consists
of, is told by its kind. Solids stand upright, with their sides along the walls of the building.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.geometry._kinds import Part, kind_of, parts_of, shaped
from reverie_eval.geometry._views import FOCAL_LENGTH, VIEW_AXES, pixels_of, rays_of

CAMERA_HEIGHT = 1.5
"""Metres from the floor to a camera; the median over Matterport3D is 1.54."""
# An object stands on the floor if it seems to begin at most this part of its height above it.
_STANDS = 0.5
# Metres of the thinnest and the largest side of an object.
_LEAST, _MOST = 0.03, 4.0
# Metres of the width of a chair that is hidden but for a part of its back, at most.
_CHAIR = 0.5
# Metres: half the thickness of what hangs on a wall, and half the width of a room at least.
_THIN, _ROOM = 0.03, 0.45
# Iterations that fit a solid to a box, by how much each may change a side, and the least depth.
_FITS, _CHANGE, _NEAR = 6, 2.0, 0.15


class Parts(NamedTuple):
    """The parts that solids consist of."""

    corners: FloatArray
    """Shape (n, 8, 3)."""
    of_solid: IntArray
    """Shape (n,): the row of the solid of each."""
    parts: Sequence[Part]
    lies_on: BoolArray
    """Shape (n,): whether it lies on the parts before it."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Objects as upright boxes along the walls of their building."""

    object_id: IntArray
    """Shape (n,)."""
    names: Sequence[str]
    storey: IntArray
    """Shape (n,): from 0 for the lowest."""
    room: IntArray
    """Shape (n,): index into the rooms of the building; -1 if its room is not drawn."""
    centre: FloatArray
    """Shape (n, 3): metres."""
    half: FloatArray
    """Shape (n, 3): half the size along each of ``axes`` and up, metres."""
    back: IntArray
    """Shape (n,): the side of its back, at a quarter turn from the first axis for each 1."""
    axes: FloatArray
    """Shape (2, 2): the directions of the walls."""

    @classmethod
    def of(
        cls,
        *,
        object_id: IntArray,
        names: Sequence[str],
        storey: IntArray,
        room: IntArray,
        centre: FloatArray,
        size: FloatArray,
        bounds: FloatArray,
        floors: FloatArray,
        axes: FloatArray,
    ) -> Self:
        """Make solids of objects that look so wide and high, shape (n, 2), metres.

        ``bounds`` of shape (n, 2, 2) has the low and the high corner of each object's room along
        the axes: solids are within, with their backs at the nearest wall. ``floors`` has the height
        of each storey. What is near the floor stands on it.
        """
        flat = centre[:, :2] @ axes.T
        to_walls = np.hstack([bounds[:, 1] - flat, flat - bounds[:, 0]])
        back = to_walls.argmin(axis=1) if len(flat) else np.zeros(0, dtype=np.int64)
        kinds = [kind_of(name) for name in names]
        is_board = np.array([kind.support == "wall" for kind in kinds], dtype=bool)
        depth, deepest = np.array([(kind.depth, kind.deepest) for kind in kinds]).reshape(-1, 2).T
        largest = np.array([(kind.widest, kind.tallest) for kind in kinds]).reshape(-1, 2)
        across, high = np.clip(size / 2, _LEAST / 2, largest / 2).T
        half = np.stack([across, across, high], axis=1)
        rows = np.arange(len(half))
        half[rows, back % 2] = np.where(is_board, _THIN, np.minimum(across * depth, deepest / 2))
        # What is outside of its room was seen too badly to say where it is.
        is_inside = (to_walls >= 0).all(axis=1, keepdims=True)
        middle, reach = bounds.mean(axis=1), np.maximum((bounds[:, 1] - bounds[:, 0]) / 2, _ROOM)
        half[:, :2] = np.where(is_inside, np.minimum(half[:, :2], reach), half[:, :2])
        within = middle + np.clip(flat - middle, half[:, :2] - reach, reach - half[:, :2])
        flat = np.where(is_inside, within, flat)
        floor = floors[storey]
        bottom, top = centre[:, 2] - high, centre[:, 2] + high
        stands = bottom - floor < _STANDS * 2 * high
        stands |= np.array([kind.support == "floor" for kind in kinds], dtype=bool)
        stands &= top > floor + _LEAST
        bottom = np.where(stands, floor, bottom)
        half[:, 2] = np.maximum(top - bottom, _LEAST) / 2
        half[:, :2] = np.minimum(half[:, :2], _widest(names, half))
        up = (bottom + np.maximum(top, bottom + _LEAST)) / 2
        centre = np.column_stack([flat @ axes, up])
        return cls(object_id, names, storey, room, centre, half, back, axes)

    @property
    def frame(self) -> FloatArray:
        """Shape (3, 3): the axes of all solids, as rows."""
        frame = np.eye(3)
        frame[:2, :2] = self.axes
        return frame

    def take(self, rows: IntArray | Array) -> Self:
        """Return some of the solids."""
        return replace(
            self,
            object_id=self.object_id[rows],
            names=[self.names[row] for row in np.arange(len(self.names))[rows].tolist()],
            storey=self.storey[rows],
            room=self.room[rows],
            centre=self.centre[rows],
            half=self.half[rows],
            back=self.back[rows],
        )

    @property
    def supports(self) -> Array:
        """What each stands on or hangs from, shape (n,)."""
        return np.array([kind_of(name).support for name in self.names], dtype=np.str_)

    def moved(self, camera: FloatArray, share: FloatArray) -> Self:
        """Make the solids so many times as far from a camera, shape (n,), and as large."""
        away = (self.centre - camera) * share[:, None]
        return replace(self, centre=camera + away, half=self.half * share[:, None])

    def trimmed(self, floor: float, ceiling: float) -> Self:
        """Cut what is below a floor and above a ceiling, and what is too high for its kind."""
        tallest = np.array([kind_of(name).tallest for name in self.names])
        bottom = np.maximum(self.centre[:, 2] - self.half[:, 2], floor)
        top = np.minimum(self.centre[:, 2] + self.half[:, 2], ceiling)
        top = np.where(self.supports == "floor", np.minimum(top, bottom + tallest), top)
        is_left = top > bottom + _LEAST
        half, centre = self.half.copy(), self.centre.copy()
        half[:, 2] = np.where(is_left, (top - bottom) / 2, half[:, 2])
        centre[:, 2] = np.where(is_left, (top + bottom) / 2, centre[:, 2])
        return replace(self, centre=centre, half=half)

    def turned(self, back: IntArray) -> Self:
        """Turn the solids so that their backs are at these sides."""
        half = self.half.copy()
        is_across = (back - self.back) % 2 == 1
        half[is_across, :2] = half[is_across, 1::-1]
        return replace(self, half=half, back=back)

    def flattened(self) -> Self:
        """Make what hangs on walls as thin as it was before it was moved away from a camera."""
        half, rows = self.half.copy(), np.flatnonzero(self.supports == "wall")
        half[rows, self.back[rows] % 2] = _THIN
        return replace(self, half=half)

    def narrowed(self) -> Self:
        """Make chairs no wider than they are high."""
        is_chair = np.array([kind_of(name).form == "chair" for name in self.names], dtype=bool)
        half = self.half.copy()
        half[is_chair, :2] = np.minimum(half[is_chair, :2], half[is_chair, 2:])
        return replace(self, half=half)

    def corners(self) -> FloatArray:
        """Return the corners of the boxes, shape (n, 8, 3)."""
        return np.asarray(self.centre[:, None] + (_CORNERS * self.half[:, None]) @ self.frame)

    def ground(self) -> FloatArray:
        """Return the corners of what is not on a wall, seen from above, shape (n, 2)."""
        return self.take(self.supports != "wall").corners()[..., :2].reshape(-1, 2)

    def parts(self) -> Parts:
        """Return the parts that the solids consist of."""
        wide, high = 2 * self.half[:, :2].max(axis=1, initial=0.0), 2 * self.half[:, 2]
        parts = [
            parts_of(shaped(kind_of(name), *size))
            for name, *size in zip(self.names, wide.tolist(), high.tolist(), strict=True)
        ]
        row = np.repeat(np.arange(len(parts)), list(map(len, parts)))
        flat = [part for its in parts for part in its]
        bounds = np.array([(part.low, part.high) for part in flat]).reshape(-1, 2, 3)
        local = np.where(_CORNERS[None] < 0, bounds[:, None, 0], bounds[:, None, 1])
        local = np.einsum("nij,njk->nik", local, _TURNS[self.back[row]])
        corners = self.centre[row][:, None] + (local * self.half[row][:, None]) @ self.frame
        return Parts(
            corners,
            row,
            flat,
            (np.abs(bounds) > 1).any(axis=(1, 2)),
        )

    def fitted(self, camera: FloatArray, view: IntArray, xywh: Array) -> Self:
        """Change places and sizes so that the solids look as large as they do from a viewpoint.

        Parameters
        ----------
        camera : float array of shape (3,)
            The position of the viewpoint.
        view : int array of shape (n,)
            A view of it for each solid.
        xywh : array of shape (n, 4)
            Its box there.
        """
        axes = VIEW_AXES[view]
        low = xywh[:, :2].astype(np.float64)
        size = xywh[:, 2:].astype(np.float64)
        ray = np.einsum("ni,nij->nj", rays_of(low + size / 2), axes)
        away = np.linalg.norm(self.centre - camera, axis=1) / np.linalg.norm(ray, axis=1)
        centre, half = camera + ray * np.maximum(away, _NEAR * 2)[:, None], self.half.copy()
        is_flat = self.supports == "wall"
        deepest = np.array([kind_of(name).deepest for name in self.names])
        rows, along = np.arange(len(half)), self.back % 2
        thick = half[rows, along].copy()
        for _ in range(_FITS):
            solid = replace(self, centre=centre, half=half)
            seen = np.einsum("nki,nji->nkj", solid.corners() - camera, axes)
            seen[..., 2] = np.maximum(seen[..., 2], _NEAR)
            pixels = pixels_of(seen)
            first, last = pixels.min(axis=1), pixels.max(axis=1)
            wider = np.clip(size / np.maximum(last - first, 1), 1 / _CHANGE, _CHANGE)
            half = np.clip(half * wider[:, [0, 0, 1]], _LEAST / 2, _MOST)
            half[rows, along] = np.where(is_flat, thick, np.minimum(half[rows, along], deepest / 2))
            off = (low + size / 2 - (first + last) / 2) * (1, -1) / FOCAL_LENGTH
            far = np.einsum("ni,ni->n", centre - camera, axes[:, 2])[:, None]
            far = np.maximum(far, _NEAR)
            centre = centre + off[:, :1] * far * axes[:, 0]
            centre[:, 2] += off[:, 1] * far[:, 0] / axes[:, 1, 2]
        return replace(self, centre=centre, half=half)


_CORNERS: FloatArray = np.array(
    [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
)
SIDES: IntArray = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)
"""The corners of each side of a box: two along each axis, and then below and above."""
# Quarter turns of what is local to a solid: its back is its second coordinate.
_TURNS: FloatArray = np.array(
    [
        [(c, s, 0), (-s, c, 0), (0, 0, 1)]
        for c, s in ((0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0))
    ]
)


def _widest(names: Sequence[str], half: FloatArray) -> FloatArray:
    """Return half the greatest width of solids, shape (n, 1): a wide chair is partly hidden."""
    is_chair = np.array([kind_of(name).form == "chair" for name in names], dtype=bool)
    return np.where(is_chair[:, None], np.maximum(half[:, 2:], _CHAIR / 2), _MOST)


def sides_of(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sides of boxes, shape (n, 6, 4, 3), and their normals outwards, (n, 6, 3)."""
    sides = corners[:, SIDES]
    normal = np.cross(sides[:, :, 1] - sides[:, :, 0], sides[:, :, 3] - sides[:, :, 0])
    return sides, normal
