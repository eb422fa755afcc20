"""The walls of a level as boxes: with doors, windows, and what hangs on those behind the rooms."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.geometry import Building, Solids, Wall, door_spans, kind_of

LOW, HIGH = 0.8, 1.5
"""The height of a drawn wall, metres: low enough to see what is behind it, and that of an outer
wall beyond its room, which hides nothing."""
FLATTENED = 0.6
"""The part of their height that things are drawn at, so that they hide less."""
# Metres: the thickness of outer and of inner walls, and the longest piece of one.
_OUTER, _INNER, _PIECE = 0.3, 0.14, 1.5
# Metres: the distance of a window from its wall, the least width of a window, the heights of its
# sill and of its top; and what two places may be apart by rounding.
_BESIDE, _NARROW, _SILL, _TOP, _ROUNDED = 1.0, 0.35, 0.3, 1.2, 1e-6
# Metres: how far what hangs on a wall stands out, the width of its frame, its least height, and
# how near to the floor and to the top of the wall it is drawn.
_OUT, _FRAME, _FLAT, _CLEAR = 0.04, 0.06, 0.2, 0.1
# Metres: the widths of doors that have a leaf, and its thickness.
_LEAVES, _LEAF = (0.5, 0.95), 0.06
# Metres: what is made smaller to fit between two walls keeps this much.
_THINNEST = 0.1
# What is in walls and on them, the former before the latter, and what is within its frame.
_WITHIN: Mapping[str, str] = MappingProxyType(
    {"window": "glass", "door": "wood", "picture": "white", "mirror": "silver", "screen": "dark"}
)


class WallPiece(NamedTuple):
    """A straight piece of a wall, or of what is in it or on it."""

    material: str
    """A class of the style sheet."""
    ends: FloatArray
    """Shape (2, 2)."""
    half: float
    """Half its thickness, metres."""
    low: float = 0.0
    """Metres from the floor to its foot."""
    high: float = LOW
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


class _Thing(NamedTuple):
    """What is in a wall or on it."""

    form: str
    span: FloatArray
    """Shape (2,): where it begins and ends, metres from the start of the wall."""
    low: float
    """Metres from the floor to its foot, as it is drawn."""
    high: float
    """Metres from the floor to its top."""

    @property
    def hangs(self) -> bool:
        """Whether there is a wall behind it."""
        return self.form not in {"window", "door"}


class _Straight(NamedTuple):
    """A straight wall that pieces are cut from."""

    start: FloatArray
    """Shape (2,)."""
    along: FloatArray
    """Shape (2,): a unit vector; the room is on the left."""
    half: float
    """Half its thickness, metres."""
    high: float
    """Metres."""

    def piece(
        self, material: str, span: FloatArray, low: float, high: float, out: float = 0.0
    ) -> WallPiece:
        """Return a piece, so many metres from the start, that stands out from the wall."""
        ends = self.start + np.outer(span, self.along)
        return WallPiece(material, ends, self.half + out, low, high)

    def pieces_of(self, thing: _Thing) -> Iterator[WallPiece]:
        """Yield the pieces of what is in the wall or on it, and of the wall there."""
        within, span = _WITHIN[thing.form], thing.span
        if thing.hangs:
            low, high = thing.low, thing.high
            yield self.piece("wall", span, 0.0, self.high)
            yield self.piece("wood", span, low, high, _OUT)
            inner = span + np.array([_FRAME, -_FRAME])
            yield self.piece(within, inner, low + _FRAME, high - _FRAME, 1.5 * _OUT)
            return
        sill, top = _SILL if thing.form == "window" else 0.0, min(_TOP, self.high)
        if sill:
            yield self.piece("wall", span, 0.0, sill)
        yield self.piece(within, span, sill, top, -self.half * 2 / 3)
        if top < self.high:
            yield self.piece("wall", span, top, self.high)

    def leaves(self, gaps: FloatArray, length: float, side: float) -> Iterator[WallPiece]:
        """Yield the open leaves of doors between two pieces of the wall, on its left if 1."""
        for first, last in gaps:
            touching = (gaps[:, 0] <= last + _ROUNDED) & (first <= gaps[:, 1] + _ROUNDED)
            is_between = first > 0 and last < length and touching.sum() == 1
            if is_between and _LEAVES[0] <= last - first <= _LEAVES[1]:
                hinge = self.start + first * self.along
                swing = side * (last - first) * np.array([-self.along[1], self.along[0]])
                yield WallPiece("wood", np.stack([hinge, hinge + swing]), _LEAF / 2)


def walls_of(building: Building, level: int, axes: FloatArray, floor: float) -> Iterator[WallPiece]:
    """Yield the pieces of all walls of a level, and of what is in them and on them.

    Axes of shape (2, 2) are to the right and away on the page; ``floor`` is the level's height.
    """
    walls, doors = [*building.walls_on(level)], building.doors_on(level)
    found = _things_on(walls, building.solids, level, floor)
    for wall, things in zip(walls, found, strict=True):
        half = _thickness(wall) / 2
        along = (wall.ends[1] - wall.ends[0]) / np.hypot(*(wall.ends[1] - wall.ends[0]))
        # Its room is on the left: nearer to the eye if it leads to the left on the page.
        is_beyond = along @ axes[0] < -_ROUNDED
        high = HIGH if wall.is_outer and is_beyond else LOW
        # Long enough to close its corners.
        start, end = wall.ends[0] - half * along, wall.ends[1] + half * along
        gaps, length = door_spans(doors, start, end), float(np.hypot(*(end - start)))
        # Where it is open up to its end, it closes no corner.
        gaps = np.where(gaps <= half + _ROUNDED, 0, gaps)
        gaps = np.where(gaps >= length - half - _ROUNDED, length, gaps)
        shown = (its._replace(span=its.span + half) for its in things)
        kept = _apart((its for its in shown if high == HIGH or not its.hangs), gaps)
        straight = _Straight(start, along, half, high)
        taken = np.concatenate([gaps, *(its.span[None] for its in kept)])
        for ends in wall_pieces(start, end, taken):
            yield WallPiece("wall", ends, half, high=high)
        for thing in kept:
            yield from straight.pieces_of(thing)
        # Away from the eye, where less is hidden, but never outside.
        yield from straight.leaves(gaps, length, -1 if is_beyond and not wall.is_outer else 1)


def off_the_walls(solids: Solids, building: Building, level: int) -> Solids:
    """Move what is partly in a wall of a level to its own side of it; make it smaller if it must.

    Boxes are seen to within decimetres, and the thickness of walls is assumed. What hangs on walls
    stays.
    """
    found = [*_closed(building, level)]
    ends = np.array([each for each, _ in found]).reshape(-1, 2, 2) @ solids.axes.T
    thick = np.array([_thickness(wall) / 2 for _, wall in found])
    is_along = np.abs(ends[:, 1] - ends[:, 0]).argmax(axis=1)
    flat, half = solids.centre[:, :2] @ solids.axes.T, solids.half.copy()
    stays = solids.supports == "wall"
    for along in (0, 1):
        across, its = 1 - along, is_along == along
        begin, end = np.sort(ends[its, :, along], axis=1).T
        off = flat[:, None, across] - ends[its, 0, across]
        deep = half[:, None, across] + thick[its] - np.abs(off)
        low, high = (flat[:, None, along] + side * half[:, None, along] for side in (-1, 1))
        # At the end of a wall it is less deep in the other direction, where another wall is.
        is_in = (deep > 0) & (np.minimum(high - begin, end - low) > deep)
        face = ends[its, 0, across] + np.where(off > 0, 1, -1) * thick[its]
        lowest = np.where(is_in & (off > 0), face, -np.inf).max(axis=1, initial=-np.inf)
        highest = np.where(is_in & (off <= 0), face, np.inf).min(axis=1, initial=np.inf)
        room = np.maximum(highest - lowest, _THINNEST)
        half[:, across] = np.where(stays, half[:, across], np.minimum(half[:, across], room / 2))
        moved = np.maximum(flat[:, across], lowest + half[:, across])
        moved = np.minimum(moved, highest - half[:, across])
        flat[:, across] = np.where(stays, flat[:, across], moved)
    centre = np.column_stack([flat @ solids.axes, solids.centre[:, 2]])
    return replace(solids, centre=centre, half=half)


def _closed(building: Building, level: int) -> Iterator[tuple[FloatArray, Wall]]:
    """Yield the ends, shape (2, 2), of all parts of walls between doors."""
    doors = building.doors_on(level)
    for wall in building.walls_on(level):
        start, end = wall.ends
        length = float(np.hypot(*(end - start)))
        for span in _between(door_spans(doors, start, end), length):
            yield start + np.outer(span, (end - start) / length), wall


def _thickness(wall: Wall) -> float:
    return _OUTER if wall.is_outer else _INNER


def _things_on(
    walls: Sequence[Wall], solids: Solids, level: int, floor: float
) -> Iterator[Sequence[_Thing]]:
    """Yield what is in each wall and on it: in the nearest outer wall, as far as it is there.

    Windows come first, then doors, and the widest of each.
    """
    forms = [*_WITHIN]
    form = [kind_of(name).form for name in solids.names]
    is_its = np.array([its in _WITHIN for its in form], dtype=bool) & (solids.storey == level)
    form = [form[row] for row in np.flatnonzero(is_its).tolist()]
    its = solids.take(is_its)
    half = its.half[:, :2].max(axis=1)
    up = (its.centre[:, 2:] + its.half[:, 2:] * (-1, 1) - floor) * FLATTENED
    up = np.clip(up, _CLEAR, HIGH - _CLEAR)
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
    order = np.lexsort((-half, [forms.index(each) for each in form]))
    for row, wide in enumerate(length.tolist()):
        rows = order[is_nearest[order, row]].tolist()
        spans = np.clip(at[rows, row, None] + half[rows, None] * (-1, 1), 0, wide)
        yield [
            _Thing(form[each], span, *up[each].tolist())
            for each, span in zip(rows, spans, strict=True)
        ]


def _apart(things: Iterable[_Thing], gaps: FloatArray) -> Sequence[_Thing]:
    """Return the things that are large enough, and on no gap and none before them."""
    found: list[_Thing] = []
    for each in things:
        taken = np.concatenate([gaps, *(its.span[None] for its in found)])
        is_apart = (each.span[1] < taken[:, 0]) | (taken[:, 1] < each.span[0])
        is_large = np.ptp(each.span) > _NARROW and (not each.hangs or each.high - each.low > _FLAT)
        if is_large and is_apart.all():
            found.append(each)
    return found


def wall_pieces(start: FloatArray, end: FloatArray, gaps: FloatArray) -> Iterator[FloatArray]:
    """Yield the ends of short pieces of a wall, without gaps: metres from its start, (n, 2)."""
    length = float(np.hypot(*(end - start)))
    along = (end - start) / length
    for begin, stop in _between(gaps, length):
        count = int(np.ceil((stop - begin) / _PIECE))
        for low, high in pairwise(np.linspace(begin, stop, count + 1)):
            yield np.stack([start + low * along, start + high * along])


def _between(gaps: FloatArray, length: float) -> Iterator[tuple[float, float]]:
    """Yield where the parts of a wall without gaps begin and end, metres from its start."""
    begin = 0.0
    for first, last in [*sorted(gaps.tolist()), (length, length)]:
        stop = min(first, length)
        if stop - begin > _ROUNDED:
            yield begin, stop
        begin = max(begin, last)
