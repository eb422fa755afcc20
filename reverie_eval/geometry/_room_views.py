"""Views of rooms: what a room looks like in a view, as flat faces from the farthest to the nearest.

The walls are those of the viewpoint's room. Solids of objects that are seen from the viewpoint are
fitted to their boxes; the others of the room are where its other viewpoints see them, if they are
far enough to have no box here.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray
from reverie_eval.geometry._buildings import Building, Line, door_spans
from reverie_eval.geometry._polygons import clip_at_depth
from reverie_eval.geometry._solids import CAMERA_HEIGHT, SIDES, Solids, kind_of, sides_of
from reverie_eval.geometry._views import (
    HEIGHT,
    VIEW_AXES,
    WIDTH,
    pixels_of,
    world_to_camera,
)

# Metres: from a camera to the ceiling, of a door, of a frame, of a skirting board.
_CEILING, _DOOR_HEIGHT, _FRAME, _SKIRTING = 1.1, 2.05, 0.08, 0.1
# Released boxes are of what is visible within so many metres: what is nearer, and has none, is not.
_LISTED = 2.0
# Metres around a viewpoint that stands in no room, and from any other to a wall, at least: where no
# object is, walls are guessed, and nobody sees a room in a wall that fills the view.
_AROUND, _FREE = 1.5, 1.2
_MIN_DEPTH = 0.05
# A side faces an axis if the cosine of the angle between them is larger.
_HALF = 0.5
# Points around a crown of leaves.
_CIRCLE = 14
# The part of a box that lies within another if its object lies in front.
_WITHIN = 0.8


class Face(NamedTuple):
    """A flat face in a view."""

    kind: str
    """Material and light, ``wood top``, or the part of the room, ``floor``."""
    outlines: Sequence[FloatArray]
    """Pixels, each of shape (n, 2); every other part of what they overlap is empty."""
    object_id: int = -1
    """The object that it is of; -1 for the room."""


class Seen(NamedTuple):
    """The objects that are seen from a viewpoint."""

    object_id: IntArray
    """Shape (n,)."""
    view: IntArray
    """Shape (n,): a view that shows it."""
    xywh: Array
    """Shape (n, 4): its box there."""


class RoomView:
    """A view of a room and its objects."""

    def __init__(
        self, building: Building, position: FloatArray, row: int, view: int, seen: Seen
    ) -> None:
        """Look from the viewpoint in a row of the positions of a building's viewpoints."""
        self._building, self._camera, self._axes = building, position[row], VIEW_AXES[view]
        self._storey, self._room = int(building.storey[row]), int(building.room[row])
        solids = building.solids
        is_known = np.isin(seen.object_id, solids.object_id)  # two objects make no building
        seen = self._seen = Seen(*(column[is_known] for column in seen))
        rows = np.searchsorted(solids.object_id, seen.object_id)
        known = solids.take(rows)
        self._around = np.vstack([self._camera[None, :2], known.centre[:, :2]])
        self.fitted = known.fitted(self._camera, seen.view, seen.xywh)
        """The solids of the objects that are seen, in their order."""
        is_unseen = (solids.room == self._room) & (self._room >= 0)
        is_unseen[rows] = False
        is_unseen &= np.linalg.norm(solids.centre - self._camera, axis=1) > _LISTED
        self._unseen = solids.take(is_unseen)

    def faces(self, last: Sequence[int] = ()) -> Sequence[Face]:
        """Return what the view shows, the farthest first, and objects of ``last`` after all.

        These are in their order: nothing hides the last of them.
        """
        return [*self._shell(), *self._objects(last)]

    # The room.

    @property
    def _outlines(self) -> Sequence[FloatArray]:
        """The walls around the camera: of its room, or around what is seen."""
        here = self._camera[None, :2]
        if self._room >= 0 and self._building.rooms[self._room].contains(here)[0]:
            return [self._kept_off(each) for each in self._building.rooms[self._room].outlines]
        axes = self._building.solids.axes
        points = self._around @ axes.T
        (left, bottom), (right, top) = (
            np.minimum(points.min(axis=0), points[0] - _AROUND),
            np.maximum(points.max(axis=0), points[0] + _AROUND),
        )
        return [np.array([(left, bottom), (right, bottom), (right, top), (left, top)]) @ axes]

    def _kept_off(self, points: FloatArray, along: Sequence[int] = (0, 1)) -> FloatArray:
        """Move points away from the camera, along some axes of the building, if they are near."""
        axes = self._building.solids.axes
        off = (points - self._camera[:2]) @ axes.T
        for axis in along:
            away = np.maximum(np.abs(off[:, axis]), _FREE)
            off[:, axis] = np.where(off[:, axis] < 0, -away, away)
        return np.asarray(self._camera[:2] + off @ axes)

    def _doors(self) -> Sequence[Line]:
        """Return the doors of the storey, in walls that are far enough from the camera."""
        axes = self._building.solids.axes
        doors = []
        for door in self._building.doors_on(self._storey):
            across = int(np.abs(axes @ (door.ends[1] - door.ends[0])).argmin())
            doors.append(door._replace(ends=self._kept_off(door.ends, [across])))
        return doors

    def _shell(self) -> Iterator[Face]:
        """Yield floor, ceiling, walls and doors."""
        floor, ceiling = self._camera[2] - CAMERA_HEIGHT, self._camera[2] + _CEILING
        outlines = self._outlines
        for kind, height in (("floor", floor), ("ceiling", ceiling)):
            flat = [
                self._pixels(np.column_stack([each, np.full(len(each), height)]))
                for each in outlines
            ]
            if any(map(len, flat)):
                yield Face(kind, [each for each in flat if len(each)])
        walls = [
            wall
            for each in outlines
            for wall in zip(each, np.roll(each, -1, axis=0), strict=True)
            if _is_left(self._camera[:2], *wall)
        ]
        doors = self._doors()
        for start, end in sorted(walls, key=lambda it: -_distance(self._camera[:2], *it)):
            length = np.linalg.norm(end - start)
            along = (end - start) / length
            kind = f"wall {self._building.shade_of(end - start)}"
            yield from self._upright(kind, start, end, floor, ceiling)
            yield from self._upright("skirting", start, end, floor, floor + _SKIRTING)
            for low, high in door_spans(doors, start, end):
                if not 0 < low + high < 2 * length:  # its middle is in another wall
                    continue
                first, last = start + low * along, start + high * along
                aside, top = _FRAME * along, floor + _DOOR_HEIGHT
                frame = first - aside, last + aside, floor, top + _FRAME
                yield from self._upright("frame", *frame)
                yield from self._upright("opening", first, last, floor, top)

    def _upright(
        self, kind: str, start: FloatArray, end: FloatArray, low: float, high: float
    ) -> Iterator[Face]:
        corners = [(*start, low), (*end, low), (*end, high), (*start, high)]
        outline = self._pixels(np.array(corners))
        if len(outline):
            yield Face(kind, [outline])

    # Objects.

    def _objects(self, last: Sequence[int]) -> Iterator[Face]:
        """Yield the faces of solids, those of the same object next to each other."""
        away = [np.linalg.norm(its.centre - self._camera, axis=1) for its in self._groups]
        away[1] = np.minimum(away[1], self._in_front_of(away[1]))
        rank = {object_id: index for index, object_id in enumerate(last, 1)}
        found = [
            (rank.get(faces[0].object_id, 0), -float(distance[row]), faces)
            for its, distance in zip(self._groups, away, strict=True)
            for row, faces in self._faces_of(its)
        ]
        for *_, faces in sorted(found, key=lambda each: each[:2]):
            yield from faces

    @property
    def _groups(self) -> Sequence[Solids]:
        return self._unseen, self.fitted

    def _in_front_of(self, away: FloatArray) -> FloatArray:
        """Return just less than the distance of the nearest object whose box contains an object's.

        ``away`` has the distances of all centres, shape (n_seen,), as the result; inf if no box
        contains it. By their centres alone, a table would hide the book that lies on it.
        """
        low = self._seen.xywh[:, :2].astype(np.float64)
        size = self._seen.xywh[:, 2:].astype(np.float64)
        first, last = np.maximum(low[:, None], low), np.minimum((low + size)[:, None], low + size)
        shared, area = np.maximum(last - first, 0).prod(axis=2), size.prod(axis=1)
        is_same_view = self._seen.view[:, None] == self._seen.view
        is_within = is_same_view & (shared >= _WITHIN * area[:, None]) & (area[:, None] < area)
        nearest = np.where(is_within, away, np.inf).min(axis=1, initial=np.inf)
        return np.asarray(np.nextafter(nearest, 0))

    def _faces_of(self, solids: Solids) -> Iterator[tuple[int, list[Face]]]:
        """Yield the faces of each solid that is in the view, with its row."""
        corners, of_solid, materials = solids.parts()
        if not len(corners):
            return
        seen = world_to_camera(corners, self._camera, self._axes)
        depth = seen[..., 2]
        is_whole = depth.min(axis=1) >= _MIN_DEPTH
        pixels = pixels_of(np.where(is_whole[:, None, None], seen, 1.0))
        is_beside = (pixels.max(axis=1) < 0) | (pixels.min(axis=1) > (WIDTH, HEIGHT))
        in_view = (depth.max(axis=1) >= _MIN_DEPTH) & ~(is_whole & is_beside.any(axis=1))
        quads, normal = sides_of(corners)
        faces_camera = ((self._camera - quads[:, :, 0]) * normal).sum(axis=2) > 0
        length = np.maximum(np.linalg.norm(normal, axis=2), 1e-12)
        up = normal[..., 2] / length
        along = np.abs((normal[..., :2] @ solids.axes[0]) / length)
        shades = np.where(
            up > _HALF, "top", np.where((along > _HALF) | (up < -_HALF), "dim", "lit")
        )
        away = np.linalg.norm(corners.mean(axis=1) - self._camera, axis=1)
        order = np.lexsort((-away, of_solid))
        rows = [row for row in order.tolist() if in_view[row]]
        for solid, parts in groupby(rows, key=lambda row: int(of_solid[row])):
            faces = []
            object_id = int(solids.object_id[solid])
            for part in parts:
                for side in np.flatnonzero(faces_camera[part]).tolist():
                    outline = (
                        pixels[part, SIDES[side]]
                        if is_whole[part]
                        else self._pixels(quads[part, side])
                    )
                    if len(outline):
                        kind = f"{materials[part]} {shades[part, side]}"
                        faces.append(Face(kind, [outline], object_id))
            if kind_of(solids.names[solid]).form == "plant":
                faces += self._crown(solids, solid)
            if faces:
                yield solid, faces

    def _crown(self, solids: Solids, row: int) -> Iterator[Face]:
        """Yield the leaves of a plant: three balls."""
        object_id = int(solids.object_id[row])
        wide, _, high = solids.half[row]
        for x, z, shade in ((-0.4, -0.05, "dim"), (0.4, -0.05, "dim"), (0.0, 0.4, "top")):
            right = self._axes[0]
            centre = solids.centre[row] + right * x * wide + np.array([0, 0, z * high])
            seen = world_to_camera(centre, self._camera, self._axes)
            if seen[2] < _MIN_DEPTH:
                continue
            turns = np.linspace(0, 2 * np.pi, _CIRCLE, endpoint=False)
            radius = np.column_stack([0.6 * wide * np.cos(turns), 0.6 * high * np.sin(turns)])
            ring = seen + np.column_stack([radius, np.zeros(_CIRCLE)])
            yield Face(f"leaf {shade}", [pixels_of(ring)], object_id)

    def _pixels(self, corners: FloatArray) -> FloatArray:
        """Project a flat outline; shape (0, 2) if it is behind the camera or beside the view."""
        seen = clip_at_depth(world_to_camera(corners, self._camera, self._axes), _MIN_DEPTH)
        if not len(seen):
            return np.zeros((0, 2))
        pixels = pixels_of(seen)
        is_beside = (pixels.max(axis=0) < 0).any() or (pixels.min(axis=0) > (WIDTH, HEIGHT)).any()
        return np.zeros((0, 2)) if is_beside else pixels


def _is_left(point: FloatArray, start: FloatArray, end: FloatArray) -> bool:
    """Whether a point is to the left of a wall, where its room is."""
    (x, y), (to_x, to_y) = end - start, point - start
    return bool(x * to_y - y * to_x > 0)


def _distance(point: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Return the metres from a point to a wall."""
    along = end - start
    share = np.clip((point - start) @ along / (along @ along), 0, 1)
    return float(np.linalg.norm(start + share * along - point))
