"""The walls of a level as boxes: with gaps for doors, and with the windows in outer walls."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.geometry import Building, door_spans

HEIGHT = 0.8
"""The height of a drawn wall, metres: low enough to see what is behind it."""
# Metres: the thickness of outer and of inner walls, and the longest piece of one.
_OUTER, _INNER, _PIECE = 0.3, 0.14, 1.5
# Metres: what is too short to stand between two doors, the distance of a window from its wall, the
# least width of a window, and the height of its sill.
_POST, _BESIDE, _NARROW, _SILL = 1.3, 0.6, 0.35, 0.3


class WallPiece(NamedTuple):
    """A straight piece of a wall, or a window in it."""

    material: Literal["wall", "glass"]
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
    doors, windows = building.doors_on(level), _windows_on(building, level)
    for wall in building.walls_on(level):
        half = (_OUTER if wall.is_outer else _INNER) / 2
        along = (wall.ends[1] - wall.ends[0]) / np.hypot(*(wall.ends[1] - wall.ends[0]))
        # Long enough to close its corners.
        start, end = wall.ends[0] - half * along, wall.ends[1] + half * along
        gaps = door_spans(doors, start, end)
        panes = _spans_beside(windows, start, end, gaps) if wall.is_outer else gaps[:0]
        for ends in wall_pieces(start, end, np.concatenate([gaps, panes])):
            yield WallPiece("wall", ends, half)
        for span in panes:
            ends = start + np.outer(span, along)
            yield WallPiece("wall", ends, half, high=_SILL)
            yield WallPiece("glass", ends, half / 3, low=_SILL)


def _windows_on(building: Building, level: int) -> FloatArray:
    """Return the ends of the windows of a level, shape (n, 2, 2)."""
    solids = building.solids
    is_window = [name.rpartition(" ")[2].startswith("window") for name in solids.names]
    rows = np.flatnonzero((solids.storey == level) & np.array(is_window, dtype=bool))
    across = (1 - solids.back[rows]) % 2
    aside = solids.half[rows, across, None] * solids.axes[across]
    centre = solids.centre[rows, :2]
    return np.stack([centre - aside, centre + aside], axis=1)


def _spans_beside(
    windows: FloatArray, start: FloatArray, end: FloatArray, gaps: FloatArray
) -> FloatArray:
    """Return where windows are in a wall, as :func:`door_spans` does, but for those at a gap."""
    length = np.hypot(*(end - start))
    along = (end - start) / length
    offset = windows - start
    span = np.sort(offset @ along, axis=1)
    across = np.abs(offset[..., 0] * along[1] - offset[..., 1] * along[0])
    is_here = (across < _BESIDE).all(axis=1) & (np.ptp(span, axis=1) > _NARROW)
    is_here &= (span[:, 0] > 0) & (span[:, 1] < length)
    taken = gaps.tolist()
    for low, high in span[is_here].tolist():
        if all(high < first or last < low for first, last in taken):
            taken.append([low, high])
    return np.array(taken[len(gaps) :]).reshape(-1, 2)


def wall_pieces(start: FloatArray, end: FloatArray, gaps: FloatArray) -> Iterator[FloatArray]:
    """Yield the ends of short pieces of a wall, without what :func:`door_spans` returns.

    What is left between two gaps that are close together is a part of both.
    """
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    begin = 0.0
    for first, last in [*sorted(gaps.tolist()), (length, length)]:
        stop = min(first, length)
        is_post = begin > 0 and stop < length and stop - begin < _POST
        if stop - begin > 1e-6 and not is_post:
            count = int(np.ceil((stop - begin) / _PIECE))
            for low, high in pairwise(np.linspace(begin, stop, count + 1)):
                yield np.stack([start + low * along, start + high * along])
        begin = max(begin, last)
