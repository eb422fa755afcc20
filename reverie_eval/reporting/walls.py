"""The walls of a level as boxes: with gaps for doors, and with the windows in outer walls."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.geometry import Building, Kind, Wall, door_spans, kind_of

HEIGHT = 0.8
"""The height of a drawn wall, metres: low enough to see what is behind it."""
# Metres: the thickness of outer and of inner walls, and the longest piece of one.
_OUTER, _INNER, _PIECE = 0.3, 0.14, 1.5
# Metres: the distance of a window from its wall, the least width of a window, the height of its
# sill; and what two places may be apart by rounding.
_BESIDE, _NARROW, _SILL, _ROUNDED = 1.0, 0.35, 0.3, 1e-6


class WallPiece(NamedTuple):
    """A straight piece of a wall, or a window or a door in it."""

    material: Literal["wall", "glass", "wood"]
    ends: FloatArray
    """Shape (2, 2)."""
    half: float
    """Half its thickness, metres."""
    low: float = 0.0
    """Metres from the floor to its foot."""
    high: float = HEIGHT
    """Metres from the floor to its top."""

    def corners(self, axes: FloatArray) -> FloatArray:
        """Return its corners, shape (8, 3), along axes of shape (2, 2)."""
        start, end = self.ends @ axes.T
        left = np.array([start[1] - end[1], end[0] - start[0]])
        left *= self.half / np.hypot(*left)
        return np.array(
            [
                (*(point + side * left), up)
                for point in (start, end)
                for side in (-1, 1)
                for up in (self.low, self.high)
            ]
        )


def walls_of(building: Building, level: int) -> Iterator[WallPiece]:
    """Yield the pieces of all walls of a level."""
    walls, doors = [*building.walls_on(level)], building.doors_on(level)
    found = (_found_in(walls, building, level, kind_of(name)) for name in ("window", "door"))
    for wall, windows, closed in zip(walls, *found, strict=True):
        half = (_OUTER if wall.is_outer else _INNER) / 2
        along = (wall.ends[1] - wall.ends[0]) / np.hypot(*(wall.ends[1] - wall.ends[0]))
        # Long enough to close its corners.
        start, end = wall.ends[0] - half * along, wall.ends[1] + half * along
        gaps, length = door_spans(doors, start, end), np.hypot(*(end - start))
        # Where it is open up to its end, it closes no corner.
        gaps = np.where(gaps <= half + _ROUNDED, 0, gaps)
        gaps = np.where(gaps >= length - half - _ROUNDED, length, gaps)
        panes = _apart(windows + half, gaps)
        leaves = _apart(closed + half, np.concatenate([gaps, panes]))
        for ends in wall_pieces(start, end, np.concatenate([gaps, panes, leaves])):
            yield WallPiece("wall", ends, half)
        for span in leaves:
            yield WallPiece("wood", start + np.outer(span, along), half / 3)
        for span in panes:
            ends = start + np.outer(span, along)
            yield WallPiece("wall", ends, half, high=_SILL)
            yield WallPiece("glass", ends, half / 3, low=_SILL)


def _found_in(
    walls: Sequence[Wall], building: Building, level: int, kind: Kind
) -> Iterator[FloatArray]:
    """Yield where objects of a kind are in each wall, shape (n, 2): in the nearest outer wall.

    Metres from its start, as far as they are in it, the widest first.
    """
    solids = building.solids
    is_its = np.array([kind_of(name) == kind for name in solids.names], dtype=bool)
    its = solids.take(is_its & (solids.storey == level))
    half = its.half[:, :2].max(axis=1)
    ends = np.array([wall.ends for wall in walls]).reshape(-1, 2, 2)
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(*along.T)
    along /= length[:, None]
    offset = its.centre[:, None, :2] - ends[:, 0]
    at = np.einsum("nwi,wi->nw", offset, along)
    off = np.abs(offset[..., 0] * along[:, 1] - offset[..., 1] * along[:, 0])
    is_outer = np.array([wall.is_outer for wall in walls], dtype=bool)
    off = np.where(is_outer & (at > 0) & (at < length) & (off < _BESIDE), off, np.inf)
    is_nearest = (off == off.min(axis=1, initial=np.inf, keepdims=True)) & np.isfinite(off)
    widest = np.argsort(-half, kind="stable")
    for row, wide in enumerate(length.tolist()):
        rows = widest[is_nearest[widest, row]]
        ends = np.stack([at[rows, row] - half[rows], at[rows, row] + half[rows]], axis=1)
        yield np.clip(ends, 0, wide)


def _apart(spans: FloatArray, taken: FloatArray) -> FloatArray:
    """Return the spans that are wide enough, and on none before them or of those taken."""
    found: list[FloatArray] = []
    for span in spans:
        others = np.array([*taken, *found]).reshape(-1, 2)
        is_apart = (span[1] < others[:, 0]) | (others[:, 1] < span[0])
        if span[1] - span[0] > _NARROW and is_apart.all():
            found.append(span)
    return np.array(found).reshape(-1, 2)


def wall_pieces(start: FloatArray, end: FloatArray, gaps: FloatArray) -> Iterator[FloatArray]:
    """Yield the ends of short pieces of a wall, without gaps: metres from its start, (n, 2)."""
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    begin = 0.0
    for first, last in [*sorted(gaps.tolist()), (length, length)]:
        stop = min(first, length)
        if stop - begin > 1e-6:
            count = int(np.ceil((stop - begin) / _PIECE))
            for low, high in pairwise(np.linspace(begin, stop, count + 1)):
                yield np.stack([start + low * along, start + high * along])
        begin = max(begin, last)
