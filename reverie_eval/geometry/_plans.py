"""The plan of a storey: walls along the axes of the building, the rooms between them, doors."""

from collections.abc import Iterator, Sequence
from itertools import combinations, groupby, pairwise
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.geometry._room_parts import CLEFT
from reverie_eval.geometry._straightening import straighten

DOOR_WIDTH = 0.9
"""Metres."""
# Outlines: objects farther from the median than this many times the 75 % quantile are not evidence;
# share of the smaller room's evidence that a cut may lose; edges closer than this are one wall.
_OUTLIER, _MOST_LOST, _WALL = 2.2, 0.22, 0.6
_CUTS = 24
# Halls: half the least width; metres between the points of a way that tell if it is in a room; what
# a square metre counts when a wall moves, because nothing in a hall tells where its walls are.
_HALL, _STEP, _VAGUE = 0.7, 0.2, 0.25
# Square metres: what is smaller and has rooms all around is a part of them.
_NOOK = 20.0
# Width of a row of points, metres; another direction than north has to be better by this factor.
_BIN, _CLEARLY = 0.12, 1.05
# Metres beside a door within which another way needs none of its own, and the least metres of a
# wall between two doors, or of one that stands free.
_BESIDE, _POST = 0.25, 1.3
# A wall between rooms is left out if several doors take this share of it, or if a single one leaves
# so few metres of it.
_MOSTLY, _LEFT = 0.5, 0.6


def axes_of(points: FloatArray) -> FloatArray:
    """Return the directions of walls: along them, points are in the fewest rows."""
    turns = np.deg2rad(np.arange(90))  # a building's other axis is at right angles
    axes = np.stack([np.cos(turns), np.sin(turns), -np.sin(turns), np.cos(turns)], axis=1)
    axes = axes.reshape(-1, 2, 2)
    score = [
        sum((np.bincount(bins) ** 2).sum() for bins in (cells - cells.min(axis=0)).T)
        for cells in (np.floor(points @ each.T / _BIN).astype(np.int64) for each in axes)
    ]
    best = int(np.argmax(score))
    return np.asarray(axes[best if score[best] > _CLEARLY * score[0] else 0])


def without_outliers(points: FloatArray) -> FloatArray:
    """Return the objects of a room, shape (n, 2), without those that are far from the others."""
    away = np.abs(points - np.median(points, axis=0))
    return np.asarray(
        points[(away <= _OUTLIER * np.quantile(away, 0.75, axis=0) + 1e-9).all(axis=1)]
    )


# Openings in walls: doors where somebody can walk, and walls that would mostly be doors.


class Border(NamedTuple):
    """A straight wall between two rooms, or between one and the outside."""

    axis: int
    """The axis that it crosses."""
    line: float
    """Where it does, metres."""
    low: float
    """Where it begins along the other axis, metres."""
    high: float
    """Where it ends."""
    is_inner: bool
    """Whether a room is on both sides."""

    def ends(self, span: tuple[float, float]) -> FloatArray:
        """Return the ends of a part of it, shape (2, 2)."""
        found = np.full((2, 2), self.line)
        found[:, 1 - self.axis] = span
        return found


def openings(borders: Sequence[Border], legs: FloatArray) -> Iterator[FloatArray]:
    """Yield the ends of the openings that legs of shape (n, 2, 2) need in walls, shape (2, 2).

    What is left of inner walls between openings is open too if it is short and touches no other.
    Walls come in the order of their lines, and along these.
    """
    standing: list[Border] = []
    for border in borders:
        spans = _spans(border, _passed(border, legs))
        yield from map(border.ends, spans)
        marks = [border.low, *(mark for span in spans for mark in span), border.high]
        for low, high in zip(marks[::2], marks[1::2], strict=True):
            piece = border._replace(low=low, high=high)
            if standing and standing[-1][:2] == piece[:2] and standing[-1].high == low:
                before = standing.pop()
                is_inner = before.is_inner and piece.is_inner
                piece = piece._replace(low=before.low, is_inner=is_inner)
            if piece.low < high:
                standing.append(piece)
    for piece in standing:
        if piece.is_inner and piece.high - piece.low < _POST and not _is_held(piece, standing):
            yield piece.ends((piece.low, piece.high))


def _passed(border: Border, legs: FloatArray) -> FloatArray:
    """Return where legs pass a wall, ascending."""
    axis, other = border.axis, 1 - border.axis
    is_across = (legs[:, 0, axis] < border.line) != (legs[:, 1, axis] < border.line)
    start, end = np.moveaxis(legs[is_across & (legs[..., axis] != border.line).all(axis=1)], 1, 0)
    share = (border.line - start[:, axis]) / (end - start)[:, axis]
    at = start[:, other] + share * (end - start)[:, other]
    return np.sort(at[(at > border.low) & (at <= border.high)])


def _spans(border: Border, passed: FloatArray) -> Sequence[tuple[float, float]]:
    """Return the openings of a wall, from the first to the last; each is within the wall."""
    low, high, half = border.low, border.high, DOOR_WIDTH / 2
    found: list[tuple[float, float]] = []
    for at in passed.tolist():
        if found and at <= found[-1][1] + _BESIDE:
            continue
        middle = min(max(at, low + half), max(high - half, (low + high) / 2))
        begin, end = max(middle - half, low), min(middle + half, high)
        if found and begin - found[-1][1] < _POST:
            begin, _ = found.pop()
        found.append((begin, end))
    width, length = sum(end - begin for begin, end in found), high - low
    is_open = width >= _MOSTLY * length if width > DOOR_WIDTH else length - width < _LEFT
    return [(low, high)] if found and border.is_inner and is_open else found


def _is_held(piece: Border, standing: Sequence[Border]) -> bool:
    """Whether a wall across it touches one of its ends."""
    return any(
        wall.line in (piece.low, piece.high) and wall.low <= piece.line <= wall.high
        for wall in standing
        if wall.axis != piece.axis
    )


# Rooms.


Evidence = tuple[FloatArray, FloatArray]
"""The objects and the cameras of a room, each of shape (n, 2)."""


class Plan(NamedTuple):
    """The rooms of a storey: cells between the lines of walls, in the axes of the building."""

    lines: tuple[FloatArray, FloatArray]
    """Coordinates of the walls along each axis, ascending."""
    room: IntArray
    """Shape (n_x + 1, n_y + 1): the room of each cell between lines; -1 outside, as in the first
    and the last row and column."""

    @classmethod
    def of(cls, boxes: FloatArray, points: Sequence[Evidence], legs: FloatArray) -> Self:
        """Lay out the rooms of a storey, by boxes, shape (n, 2, 2), around the points in each.

        Where legs, shape (n, 2, 2), lead through none of them, there are halls, numbered after
        these rooms. Clefts between rooms are closed.
        """
        boxes = boxes.copy()
        _cut_apart(boxes, [np.vstack(its) for its in points])
        boxes = np.stack([_snapped(boxes[..., 0]), _snapped(boxes[..., 1])], axis=-1)
        halls = np.array([*_halls(boxes, legs)]).reshape(-1, 2, 2)
        for axis in (0, 1):
            halls[..., axis] = _moved_to(boxes[..., axis], halls[..., axis])
        number = [*(len(boxes) + _touching(halls)), *range(len(boxes))]
        # Small rooms are cut out of large ones, and all of them out of halls.
        by_size = np.argsort(-np.diff(boxes, axis=1)[:, 0].prod(axis=1), kind="stable")
        order = [*range(len(halls)), *(len(halls) + by_size)]
        boxes = np.concatenate([halls, boxes])
        lines = np.unique(boxes[..., 0]), np.unique(boxes[..., 1])
        room = np.full((len(lines[0]) + 1, len(lines[1]) + 1), -1)
        for index in order:
            (left, bottom), (right, top) = (
                [int(np.searchsorted(lines[axis], corner[axis])) + 1 for axis in (0, 1)]
                for corner in boxes[index]
            )
            room[left:right, bottom:top] = number[index]
        plan = cls(lines, room)
        plan._close_clefts()
        plan._close_nooks()
        plan._straighten(points, legs)
        return plan

    def _close_clefts(self) -> None:
        """Give what is narrow between two rooms, in place, to the larger of them."""
        for axis in (0, 1):
            for row in np.moveaxis(self.room, axis, 1):
                rooms = np.flatnonzero(row >= 0)
                for first, last in pairwise(rooms.tolist()):
                    # The cell after the first begins at the line of the first's number.
                    width = self.lines[axis][last - 1] - self.lines[axis][first]
                    if last - first > 1 and width <= CLEFT:
                        row[first + 1 : last] = max(row[first], row[last], key=self.area)

    def _close_nooks(self) -> None:
        """Give what is small and has rooms all around, in place, to that with the longest side."""
        is_empty = self.room < 0
        while is_empty.any():
            nook = _spread(is_empty, tuple(np.argwhere(is_empty)[0]))
            is_empty &= ~nook
            # All around the rooms is one more empty cell.
            if not nook[0, 0] and self._area(nook) <= _NOOK:
                beyond = [
                    self.room[np.roll(nook, step, axis) & ~nook]
                    for axis in (0, 1)
                    for step in (-1, 1)
                ]
                self.room[nook] = np.bincount(np.concatenate(beyond)).argmax()

    def _straighten(self, points: Sequence[Evidence], legs: FloatArray) -> None:
        """Take corners away, in place: a camera stays in its room, and no way leads outside.

        An object that changes its room counts as a square metre.
        """
        area = self._areas()
        held = np.zeros(area.shape)
        for index, (objects, cameras) in enumerate(points):
            for its, metres in ((objects, 1.0), (cameras, np.inf)):
                cells = self._cells_of(its)
                np.add.at(held, cells, np.where(self.room[cells] == index, metres, 0))
        is_way = np.zeros(area.shape, dtype=bool)
        for start, end in legs:
            is_way[self._cells_of(_along(start, end, self.lines))] = True
        is_hall = self.room >= len(points)
        as_room = np.where(is_hall, _VAGUE, 1) * area + held
        straighten(self.room, self.lines, as_room, np.where(is_way, np.inf, area + held))

    def _cells_of(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Return the cells in which points, shape (n, 2), are."""
        x, y = (np.searchsorted(self.lines[axis], points[:, axis]) for axis in (0, 1))
        return x, y

    @property
    def n_rooms(self) -> int:
        """The rooms and the halls."""
        return int(self.room.max()) + 1

    def area(self, room: int) -> float:
        """Return the square metres of a room."""
        return self._area(self.room == room)

    def _area(self, cells: BoolArray) -> float:
        return float(self._areas()[cells].sum())

    def _areas(self) -> FloatArray:
        """Return the square metres of each cell; 0 around the outermost lines."""
        wide, high = (np.diff(lines, prepend=lines[:1], append=lines[-1:]) for lines in self.lines)
        return np.asarray(wide[:, None] * high)

    def outlines(self, room: int) -> Iterator[FloatArray]:
        """Yield the corners of a room's outlines, with the room on the left."""
        is_inside = self.room == room
        ways: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for x, y in np.argwhere(is_inside).tolist():
            # The lines around cell (x, y) have the indexes x - 1 and x, y - 1 and y.
            corners = [(x - 1, y - 1), (x, y - 1), (x, y), (x - 1, y)]
            beyond = [(x, y - 1), (x + 1, y), (x, y + 1), (x - 1, y)]
            for side, its in enumerate(beyond):
                if not is_inside[its]:
                    ways.setdefault(corners[side], []).append(corners[(side + 1) % 4])
        while ways:
            here = start = next(iter(ways))
            corners = []
            while True:
                ends = ways[here]
                there = ends.pop()
                if not ends:
                    del ways[here]
                corners.append(here)
                here = there
                if here == start:
                    break
            loop = np.array(corners)
            before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
            turns = before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]
            x, y = loop[turns].T
            yield np.column_stack([self.lines[0][x], self.lines[1][y]])

    def doors(self, legs: FloatArray) -> Iterator[FloatArray]:
        """Yield the ends of the openings in walls that legs of shape (n, 2, 2) pass."""
        return openings([*self._borders()], legs)

    def _borders(self) -> Iterator[Border]:
        """Yield the walls between two rooms, and those between one and the outside, along lines."""
        for axis in (0, 1):
            room, along = np.moveaxis(self.room, axis, 0), self.lines[1 - axis]
            for line, at in enumerate(self.lines[axis].tolist()):
                sides = room[line : line + 2].T.tolist()
                for (before, after), group in groupby(range(len(sides)), sides.__getitem__):
                    cells = [*group]
                    if before != after:
                        ends = along[cells[0] - 1], along[cells[-1]]
                        yield Border(axis, at, *ends, is_inner=min(before, after) >= 0)


def _cut_apart(boxes: FloatArray, points: Sequence[FloatArray]) -> None:
    """Cut overlapping boxes, in place, where the least evidence of their rooms is lost."""
    for first, second in combinations(range(len(boxes)), 2):
        low = np.maximum(boxes[first, 0], boxes[second, 0])
        high = np.minimum(boxes[first, 1], boxes[second, 1])
        if not (low < high).all():
            continue
        cuts = []
        for axis in (0, 1):
            line = np.linspace(low[axis], high[axis], _CUTS)
            for left, right in ((first, second), (second, first)):
                lost = (points[left][:, axis, None] > line).sum(axis=0)
                lost += (points[right][:, axis, None] < line).sum(axis=0)
                best = int(lost.argmin())
                # A cut must leave each room its side.
                if boxes[left, 0, axis] < line[best] < boxes[right, 1, axis]:
                    cuts.append((int(lost[best]), axis, float(line[best]), left, right))
        if cuts:
            fewest, axis, cut, left, right = min(cuts)
            if fewest <= _MOST_LOST * min(len(points[first]), len(points[second])):
                boxes[left, 1, axis] = min(boxes[left, 1, axis], cut)
                boxes[right, 0, axis] = max(boxes[right, 0, axis], cut)


def _halls(boxes: FloatArray, legs: FloatArray) -> Iterator[FloatArray]:
    """Yield boxes, shape (2, 2), around the parts of legs that are in none of the boxes."""
    for start, end in legs:
        count = int(np.ceil(np.hypot(*(end - start)) / _STEP)) + 1
        along: FloatArray = np.linspace(start, end, count)
        inside = (along[:, None] >= boxes[:, 0]) & (along[:, None] <= boxes[:, 1])
        is_inside = np.any(np.all(inside, axis=2), axis=1).tolist()
        for is_in, rows in groupby(range(count), is_inside.__getitem__):
            if not is_in:
                its = along[[*rows]]
                yield np.stack([its.min(axis=0) - _HALL, its.max(axis=0) + _HALL])


def _along(start: FloatArray, end: FloatArray, lines: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return a point, shape (n, 2), in each cell that a leg leads through."""
    along = end - start
    share = [(lines[axis] - start[axis]) / along[axis] for axis in (0, 1) if along[axis]]
    marks = np.unique(np.clip(np.concatenate([[0.0, 1.0], *share]), 0, 1))
    return np.asarray(start + ((marks[1:] + marks[:-1]) / 2)[:, None] * along)


def _moved_to(lines: FloatArray, values: FloatArray) -> FloatArray:
    """Return numbers, those that are close to one of some lines moved to it."""
    if not lines.size:
        return values
    # Not the number and its distance: what is on the same line has to be equal.
    nearest = lines.ravel()[np.abs(lines.ravel() - values[..., None]).argmin(axis=-1)]
    return np.where(np.abs(nearest - values) <= _WALL, nearest, values)


def _touching(boxes: FloatArray) -> IntArray:
    """Return a number from 0 for each box, shape (n, 2, 2); those that touch have the same."""
    low, high = boxes[:, None, 0], boxes[None, :, 1]
    touch = (low <= high).all(axis=2)
    touch &= touch.T
    number = np.arange(len(boxes))
    while (touch & (number[:, None] != number)).any():
        number = np.where(touch, number, len(boxes)).min(axis=1)
    return np.unique(number, return_inverse=True)[1]


def _spread(free: BoolArray, cell: tuple[int, ...]) -> BoolArray:
    """Return the free cells that can be reached from one of them."""
    reached = np.zeros_like(free)
    reached[cell] = True
    count = 0
    while count < (count := int(reached.sum())):
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        reached = grown & free
    return reached


def _snapped(values: FloatArray) -> FloatArray:
    """Return numbers with those that are close together replaced by their mean."""
    flat = np.sort(values, axis=None)
    group, first = np.zeros(flat.size, dtype=np.int64), -np.inf
    for index, value in enumerate(flat.tolist()):
        is_far = value - first > _WALL
        group[index] = group[index - 1] + is_far if index else 0
        first = value if is_far else first
    mean = np.bincount(group, flat) / np.maximum(np.bincount(group), 1)
    return np.asarray(mean[group[np.searchsorted(flat, values)]])
