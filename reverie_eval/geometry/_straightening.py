"""Straight walls: a corner stays where what is known calls for it.

Outlines around objects and cameras, and ways cut into boxes, leave notches, teeth and short offsets
in walls that continue each other. A wall is moved, as far as the next lines of walls, if fewer
corners are worth more than the floor that changes hands.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import itemgetter

import numpy as np

from reverie_eval.arrays import FloatArray, IntArray

# Square metres that a corner of walls is worth, and metres that a wall is moved, at most.
_CORNER, _FARTHEST = 3.0, 3.0
_Cells = tuple[slice, slice]


def straighten(
    room: IntArray,
    lines: tuple[FloatArray, FloatArray],
    as_room: FloatArray,
    as_outside: FloatArray,
) -> None:
    """Move walls, in place, while that is worth something: those first that are worth most.

    Parameters
    ----------
    room : int array of shape (n_x + 1, n_y + 1)
        The room of each cell between lines; -1 outside, as in the first and the last row and
        column.
    lines : tuple of two float arrays, shapes (n_x,) and (n_y,)
        Coordinates of the walls along each axis, metres, ascending.
    as_room, as_outside : float arrays of the shape of ``room``
        What it costs to give each cell to another room, or to none, in square metres; infinite
        where that is impossible.
    """
    original = room.copy()

    def cost(cells: _Cells, number: int | IntArray) -> float:
        its = np.where(np.less(number, 0), as_outside[cells], as_room[cells])
        return float(np.where(original[cells] == number, 0.0, its).sum())

    def worth(cells: _Cells, number: int) -> float:
        costs = cost(cells, number)
        if costs == np.inf:
            return -np.inf
        x, y = cells
        around = room[x.start - 1 : x.stop + 1, y.start - 1 : y.stop + 1]
        moved = around.copy()
        moved[1:-1, 1:-1] = number
        fewer = _count_corners(around) - _count_corners(moved)
        return _CORNER * fewer + cost(cells, room[cells]) - costs

    is_done = False
    while not is_done:
        moves = [(worth(*move), move) for move in _moves(room, lines)]
        is_done = True
        for was_worth, move in sorted(moves, key=itemgetter(0), reverse=True):
            # Not only before the others.
            if was_worth > 0 and worth(*move) > 0:
                cells, number = move
                room[cells] = number
                is_done = False


def _moves(room: IntArray, lines: tuple[FloatArray, FloatArray]) -> Iterator[tuple[_Cells, int]]:
    """Yield cells that a straight wall may be moved over, and the room behind it."""
    for axis in (0, 1):
        rows, at = np.moveaxis(room, axis, 0).tolist(), lines[axis]
        for line, here in enumerate(at.tolist()):
            first = int(np.searchsorted(at, here - _FARTHEST))
            last = int(np.searchsorted(at, here + _FARTHEST, side="right"))
            # Cells that begin at a line are those after it.
            up = [slice(line + 1, end + 1) for end in range(line + 1, last)]
            down = [slice(end + 1, line + 1) for end in range(first, line)]
            for own, other, reach in ((line, line + 1, up), (line + 1, line, down)):
                for begin, end in _stretches(rows[own], rows[other]):
                    along = slice(begin, end)
                    for across in reach:
                        cells = (across, along) if axis == 0 else (along, across)
                        yield cells, rows[own][begin]


def _stretches(own: Sequence[int], other: Sequence[int]) -> set[tuple[int, int]]:
    """Return where straight walls of a room begin and end: as far as it has any other beside it.

    And as far as it has one and the same.
    """
    pairs = [*zip(own, other, strict=True)]
    rooms = [room if room != beside else None for room, beside in pairs]
    found = set()
    for sides in (pairs, rooms):
        for _, group in groupby(range(len(pairs)), sides.__getitem__):
            cells = [*group]
            if rooms[cells[0]] is not None:
                found.add((cells[0], cells[-1] + 1))
    return found


def _count_corners(room: IntArray) -> int:
    """Count the points between four cells where walls meet or turn."""
    first, second, third, last = room[:-1, :-1], room[1:, :-1], room[:-1, 1:], room[1:, 1:]
    is_straight = (first == second) & (third == last) | (first == third) & (second == last)
    return int((~is_straight).sum())
