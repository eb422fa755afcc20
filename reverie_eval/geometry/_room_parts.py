"""Parts of rooms: rooms are cut where there must be walls, and where nobody can have been.

Where few objects have names, a run of them may be of many rooms, and a rectangle around it is
mostly empty. What viewpoints tell goes further: two beside each other without a way between them
have a wall there, and where neither viewpoints nor objects are, nothing is known of a floor.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import FloatArray, IntArray

AROUND, CLEFT = 0.7, 1.5
"""Metres of free space around a camera, at least; what is narrower than the second between two
rooms is a part of them."""
# Metres between cameras that mostly have a way between them within a room, and mostly none if they
# are in two.
_CLOSE = 2.5
# Square metres: what a wall between two such cameras without a way is worth, and what a cut and
# each door in it cost; otherwise, a cut is worth the floor of which nothing is known any more.
_PAIR, _CUT, _DOOR = 2.0, 9.0, 4.0
# Cameras on each side of a cut, at least; metres between these, and between two doors, at least.
_FEWEST, _STRAIGHT, _POST = 2, 0.3, 1.3
_ENDLESS = np.array([(-np.inf, -np.inf), (np.inf, np.inf)])


class RoomParts(NamedTuple):
    """The parts of rooms, in the order of these."""

    room: IntArray
    """Shape (n_parts,): the room of each."""
    home: IntArray
    """Shape (n_viewpoints,): the part of each; -1 for none."""
    objects: Sequence[FloatArray]
    """The objects of each part, shape (n, 2)."""
    cameras: Sequence[FloatArray]
    """The cameras of each part, shape (n, 2)."""
    boxes: FloatArray
    """Shape (n_parts, 2, 2): the low and the high corner of each."""

    @classmethod
    def of(
        cls,
        objects: Sequence[FloatArray],
        camera: FloatArray,
        edges: IntArray,
        home: IntArray,
        is_whole: Sequence[bool],
    ) -> Self:
        """Cut rooms into parts; some are left whole.

        ``objects`` are those that tell where each room is, and ``home`` is the room of each camera;
        all along the axes of the building.
        """
        room: list[int] = []
        found: list[_Part] = []
        part_of = np.full(len(home), -1)
        for index, its in enumerate(objects):
            rows = np.flatnonzero(home == index)
            inside = np.searchsorted(rows, edges[(home[edges] == index).all(axis=1)])
            whole = _Part(its, camera[rows], np.arange(len(rows)), _ENDLESS)
            for part in [whole] if is_whole[index] else _parts_of(whole, inside):
                part_of[rows[part.rows]] = len(found)
                room.append(index)
                found.append(part)
        return cls(
            np.array(room, dtype=np.int64),
            part_of,
            [part.objects for part in found],
            [part.cameras for part in found],
            np.array([part.box for part in found]).reshape(-1, 2, 2),
        )

    @property
    def main(self) -> set[int]:
        """The part of each room with the most objects."""
        count = np.array([len(its) for its in self.objects], dtype=np.int64)
        by_count = np.argsort(-count, kind="stable")
        return set(by_count[np.unique(self.room[by_count], return_index=True)[1]].tolist())

    def nearest(self, points: FloatArray, room: IntArray) -> IntArray:
        """Return the part of its room that is nearest to each point, shape (n, 2)."""
        if not len(points):
            return room
        low, high = self.boxes[:, 0], self.boxes[:, 1]
        off = np.maximum(np.maximum(low - points[:, None], points[:, None] - high), 0)
        away = np.where(room[:, None] == self.room, np.hypot(off[..., 0], off[..., 1]), np.inf)
        return np.asarray(away.argmin(axis=1))


class _Part(NamedTuple):
    """A part of a room."""

    objects: FloatArray
    """Shape (n_objects, 2): metres."""
    cameras: FloatArray
    """Shape (n_cameras, 2)."""
    rows: IntArray
    """Shape (n_cameras,): the cameras' rows among those of the whole room."""
    limits: FloatArray
    """Shape (2, 2): the cuts below and above it along each axis; infinite without."""

    @property
    def box(self) -> FloatArray:
        """The low and the high corner, shape (2, 2), around what is in it, and up to near cuts."""
        points = np.vstack([self.objects, self.cameras - AROUND, self.cameras + AROUND])
        low, high = points.min(axis=0), points.max(axis=0)
        # No room is narrower than one that a camera stands in.
        middle, half = (low + high) / 2, np.maximum((high - low) / 2, AROUND)
        box = np.clip([middle - half, middle + half], *self.limits)
        return np.where(np.abs(box - self.limits) <= CLEFT / 2, self.limits, box)

    def cut(self, axis: int, line: float) -> tuple["_Part", "_Part"]:
        """Return the parts on both sides of a line across an axis."""
        is_object, is_camera = self.objects[:, axis] < line, self.cameras[:, axis] < line
        below, above = self.limits.copy(), self.limits.copy()
        below[1, axis] = above[0, axis] = line
        sides = (is_object, is_camera, below), (~is_object, ~is_camera, above)
        first, second = (
            _Part(self.objects[its], self.cameras[stand], self.rows[stand], limits)
            for its, stand, limits in sides
        )
        return first, second


def _parts_of(whole: _Part, edges: IntArray) -> Iterator[_Part]:
    """Yield the parts of a room: again and again, the cut is made that is worth most.

    ``edges``, shape (n, 2), are the ways between its cameras.
    """
    away = np.hypot(*np.moveaxis(whole.cameras[:, None] - whole.cameras, -1, 0))
    is_apart = np.triu(away < _CLOSE, 1)
    is_apart[edges.min(axis=1), edges.max(axis=1)] = False
    apart = np.argwhere(is_apart)
    waiting = [whole]
    while waiting:
        part = waiting.pop()
        ways, pairs = (
            whole.cameras[ends[np.isin(ends, part.rows).all(axis=1)]] for ends in (edges, apart)
        )
        worth, axis, line = max(_cuts(part, ways, pairs), default=(0.0, 0, 0.0))
        if worth > 0:
            waiting += part.cut(axis, line)
        else:
            yield part


def _cuts(part: _Part, ways: FloatArray, pairs: FloatArray) -> Iterator[tuple[float, int, float]]:
    """Yield what each cut of a part is worth in square metres, its axis and its line.

    ``ways`` and ``pairs``, shape (n, 2, 2), are from camera to camera: those with a way between
    them, and those close together without one.
    """
    area = _area(part.box)
    for axis in (0, 1):
        along = np.sort(part.cameras[:, axis])
        for row in range(_FEWEST, len(along) - _FEWEST + 1):
            if along[row] - along[row - 1] < _STRAIGHT:
                continue
            line = float(along[row - 1] + along[row]) / 2
            first, second = (each.box for each in part.cut(axis, line))
            worth = area - _area(first) - _area(second) - _CUT
            worth += _PAIR * len(_across(pairs, axis, line)) - _DOOR * _doors(ways, axis, line)
            yield worth, axis, line


def _area(box: FloatArray) -> float:
    return float((box[1] - box[0]).prod())


def _across(legs: FloatArray, axis: int, line: float) -> FloatArray:
    """Return the legs, shape (n, 2, 2), that pass a line across an axis."""
    return np.asarray(legs[(legs[:, 0, axis] < line) != (legs[:, 1, axis] < line)])


def _doors(ways: FloatArray, axis: int, line: float) -> int:
    """Return how many doors a wall has, if each way that passes it has one."""
    start, end = np.moveaxis(_across(ways, axis, line), 1, 0)
    share = (line - start[:, axis]) / (end[:, axis] - start[:, axis])
    at = np.sort(start[:, 1 - axis] + share * (end - start)[:, 1 - axis])
    return int((np.diff(at) > _POST).sum()) + bool(len(at))
