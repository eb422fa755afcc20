"""Shells of rooms: floor, ceiling, walls and doors around a camera, as flat faces in a picture.

The model of a building knows where rooms are by their objects alone, so walls are guessed where no
object is; and a wall that fills a picture shows no room. Near walls are therefore moved away from
the camera: more of them ahead than at its sides.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.geometry._buildings import Building, Line, door_spans
from reverie_eval.geometry._polygons import clip_at_depth
from reverie_eval.geometry._solids import CAMERA_HEIGHT
from reverie_eval.geometry._views import VIEW_AXES, Picture, pixels_of, world_to_camera

CEILING = 1.1
"""Metres from a camera to the ceiling."""
# Metres from the floor: to the top of a door, a skirting board and a wainscot.
_DOOR, _SKIRTING, _WAINSCOT = 2.05, 0.1, 0.9
# Metres: of the frame of a door and a moulding.
_FRAME, _MOULDING = 0.08, 0.05
# Metres from a camera to the walls at its sides and ahead, at least, and to what moves them.
_BESIDE, _AHEAD, _REACH = 1.6, 2.4, 6.0
# Metres that are seen beyond a door, and between the joints of a floor.
_BEYOND, _JOINT = 2.5, 0.4
# Rooms whose floors are tiled; others have boards.
_TILED = ("bathroom", "kitchen", "laundry", "spa")
NEAREST = 0.05
"""Metres: what is nearer to a camera is cut off."""


class Face(NamedTuple):
    """A flat face in a picture."""

    kind: str
    """Material and light, ``wood top``, or the part of the room, ``floor``."""
    outlines: Sequence[FloatArray]
    """Pixels, each of shape (n, 2); every other part of what they overlap is empty."""
    object_id: int = -1
    """The object that it is of; -1 for the room."""


class Camera(NamedTuple):
    """A camera that takes a picture."""

    position: FloatArray
    """Shape (3,): metres."""
    picture: Picture

    @property
    def axes(self) -> FloatArray:
        """Right, up and forward, shape (3, 3)."""
        return np.asarray(VIEW_AXES[self.picture.view])

    @property
    def floor(self) -> float:
        """The height of the floor."""
        return float(self.position[2]) - CAMERA_HEIGHT

    @property
    def ceiling(self) -> float:
        """The height of the ceiling."""
        return float(self.position[2]) + CEILING

    def is_beside(self, pixels: FloatArray) -> FloatArray:
        """Whether points of shape (..., n, 2) are all at one side of the picture."""
        _, left, top, width, height = self.picture
        is_before = (pixels < (left, top)).all(axis=-2)
        is_after = (pixels > (left + width, top + height)).all(axis=-2)
        return np.asarray((is_before | is_after).any(axis=-1))

    def pixels(self, corners: FloatArray) -> FloatArray:
        """Project a flat outline; shape (0, 2) if it is behind the camera or beside the picture."""
        seen = clip_at_depth(world_to_camera(corners, self.position, self.axes), NEAREST)
        if not len(seen) or self.is_beside(pixels_of(seen)):
            return np.zeros((0, 2))
        return pixels_of(seen)

    def flat(self, kind: str, outlines: Sequence[FloatArray], height: float) -> Iterator[Face]:
        """Yield a face of outlines of shape (n, 2) at a height, if it is in the picture."""
        found = [
            self.pixels(np.column_stack([each, np.full(len(each), height)])) for each in outlines
        ]
        if any(map(len, found)):
            yield Face(kind, [each for each in found if len(each)])

    def upright(self, kind: str, ends: FloatArray, low: float, high: float) -> Iterator[Face]:
        """Yield an upright face with ends of shape (2, 2), if it is in the picture."""
        start, end = ends
        found = self.pixels(np.array([(*start, low), (*end, low), (*end, high), (*start, high)]))
        if len(found):
            yield Face(kind, [found])


class Shell:
    """The walls and doors around a camera."""

    def __init__(
        self, building: Building, storey: int, room: int, camera: Camera, within: FloatArray
    ) -> None:
        """Take the walls of a room, or any; points of shape (n, 2) are within, if they are near."""
        self._building, self._camera = building, camera
        self._here, self._axes = camera.position[:2], building.solids.axes
        self._reach = self._reach_of(within)
        (left, bottom), (right, top) = -self._reach[0], self._reach[1]
        corners = np.array([(left, bottom), (right, bottom), (right, top), (left, top)])
        outlines: Sequence[FloatArray] = [self._here + corners @ self._axes]
        self._name = ""
        if room >= 0 and building.rooms[room].contains(self._here[None])[0]:
            outlines = [self._moved(each) for each in building.rooms[room].outlines]
            self._name = building.rooms[room].name
        self._outlines = outlines
        walls = np.concatenate(
            [np.stack([each, np.roll(each, -1, axis=0)], axis=1) for each in outlines]
        )
        # What was moved may have no length any more.
        self._walls = walls[np.abs(walls[:, 1] - walls[:, 0]).max(axis=1) > _FRAME]
        self._doors = [self._moved_door(each) for each in building.doors_on(storey)]

    def _reach_of(self, within: FloatArray) -> FloatArray:
        """Return the metres to the nearest walls, shape (2, 2): down and up each axis."""
        off = (within - self._here) @ self._axes.T
        ahead = self._axes @ self._camera.axes[2, :2]
        least = [_BESIDE + (_AHEAD - _BESIDE) * np.maximum(sign * ahead, 0) for sign in (-1, 1)]
        farthest = [(sign * off).max(axis=0, initial=0.0) for sign in (-1, 1)]
        return np.maximum(np.minimum(farthest, _REACH), least)

    def _moved(self, points: FloatArray, along: Sequence[int] = (0, 1)) -> FloatArray:
        """Move points away from the camera, along some axes of the building, if they are near."""
        off = (points - self._here) @ self._axes.T
        for axis in along:
            low, high = -self._reach[0, axis], self._reach[1, axis]
            its = off[:, axis]
            off[:, axis] = np.where(its < 0, np.minimum(its, low), np.maximum(its, high))
        return np.asarray(self._here + off @ self._axes)

    def _moved_door(self, door: Line) -> Line:
        """Move a door with its wall."""
        across = int(np.abs(self._axes @ (door.ends[1] - door.ends[0])).argmin())
        return door._replace(ends=self._moved(door.ends, [across]))

    def behind(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Find the walls behind points of shape (n, 2), as the camera sees them.

        Returns
        -------
        float array of shape (n,)
            How many times as far away as its point each wall is; 1 where there is no wall.
        int array of shape (n,)
            At which side, as the backs of solids.
        """
        ray, off = points - self._here, self._walls[:, 0] - self._here
        along = self._walls[:, 1] - self._walls[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            area = _cross(ray[:, None], along)
            far, share = _cross(off, along) / area, _cross(off, ray[:, None]) / area
        far = np.where((far > 0) & (share >= 0) & (share <= 1), far, np.inf)
        wall, far = far.argmin(axis=1), far.min(axis=1)
        out = np.column_stack([along[wall, 1], -along[wall, 0]]) @ self._axes.T
        return np.where(np.isfinite(far), far, 1.0), np.hstack([out, -out]).argmax(axis=1)

    def faces(self) -> Iterator[Face]:
        """Yield floor and ceiling, and then the walls with their doors, the farthest first."""
        camera = self._camera
        floor = "floor tiled" if self._name in _TILED else "floor"
        yield from camera.flat(floor, self._outlines, camera.floor)
        joints = floor_joints(self._outlines, self._axes, self._name, _JOINT)
        yield from camera.flat("joint", [*joints], camera.floor)
        yield from camera.flat("ceiling", self._outlines, camera.ceiling)
        for wall in sorted(self._walls, key=lambda ends: -_distance(self._here, ends)):
            along = wall[1] - wall[0]
            if _cross(along, self._here - wall[0]) <= 0:  # seen from outside of the room
                continue
            light = self._building.shade_of(along)
            wainscot, moulding = camera.floor + _WAINSCOT, camera.ceiling - _MOULDING
            yield from camera.upright(f"wall {light}", wall, wainscot, camera.ceiling)
            yield from camera.upright(f"wainscot {light}", wall, camera.floor, wainscot)
            yield from camera.upright("skirting", wall, camera.floor, camera.floor + _SKIRTING)
            yield from camera.upright("skirting", wall, wainscot, wainscot + _MOULDING)
            yield from camera.upright("skirting", wall, moulding, camera.ceiling)
            for ends in _openings(self._doors, wall):
                yield from self._door(ends)

    def _door(self, ends: FloatArray) -> Iterator[Face]:
        """Yield a door, and through it the floor beyond, a wall, and the ceiling if that is far."""
        camera = self._camera
        off = ends - self._here
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        aside, top = _FRAME * along, camera.floor + _DOOR
        around = np.array([ends[0] - aside, ends[1] + aside])
        yield from camera.upright("frame", around, camera.floor, top + _FRAME)
        yield from camera.upright("opening", ends, camera.floor, top)
        # The sides of what is seen are upright, so they are on the same rays as those of the door.
        far = self._here + off * (1 + _BEYOND / abs(_cross(along, off[0])))
        yield from camera.flat("beyond", [np.concatenate([ends, far[::-1]])], camera.floor)
        yield from camera.upright("skirting", far, camera.floor, camera.floor + _SKIRTING)
        meets = self._here + off * CEILING / (_DOOR - CAMERA_HEIGHT)
        if _distance(self._here, far) > _distance(self._here, meets):
            yield from camera.flat("ceiling", [np.concatenate([meets, far[::-1]])], camera.ceiling)


def floor_joints(
    outlines: Sequence[FloatArray], axes: FloatArray, room: str, step: float
) -> Iterator[FloatArray]:
    """Yield the joints of a floor, each of shape (2, 2): of boards, or of tiles where it gets wet.

    Outlines are those of a room, along the axes of its building; ``room`` is its name.
    """
    corners = [outline @ axes.T for outline in outlines]
    start = np.vstack(corners)
    end = np.vstack([np.roll(each, -1, axis=0) for each in corners])
    for along in (0, 1) if room in _TILED else (0,):
        low, high = np.sort([start[:, 1 - along], end[:, 1 - along]], axis=0)
        for at in step * np.arange(np.ceil(low.min() / step), np.ceil(high.max() / step)):
            ends = np.sort(start[(low <= at) & (at < high), along])
            for span in ends.reshape(-1, 2):
                joint = np.full((2, 2), at)
                joint[:, along] = span
                yield joint @ axes


def _openings(doors: Sequence[Line], wall: FloatArray) -> Iterator[FloatArray]:
    """Yield the ends of openings in a wall: doors that are beside each other are one."""
    start, end = wall
    length = float(np.linalg.norm(end - start))
    spans = door_spans(doors, start, end)
    middle = spans.mean(axis=1)
    spans = np.clip(spans[(middle > 0) & (middle < length)], _FRAME, length - _FRAME)
    spans = spans[spans[:, 0] < spans[:, 1]]
    spans = spans[np.argsort(spans[:, 0])]
    is_apart = spans[1:, 0] > np.maximum.accumulate(spans[:, 1])[:-1] + 3 * _FRAME
    for first, last in pairwise([0, *(np.flatnonzero(is_apart) + 1).tolist(), len(spans)]):
        if first < last:
            low, high = spans[first, 0], spans[first:last, 1].max()
            yield start + np.array([(low,), (high,)]) * (end - start) / length


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the areas of parallelograms of vectors of shape (..., 2), positive to the left."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _distance(point: FloatArray, ends: FloatArray) -> float:
    """Return the metres from a point to a wall."""
    along = ends[1] - ends[0]
    share = np.clip((point - ends[0]) @ along / (along @ along), 0, 1)
    return float(np.linalg.norm(ends[0] + share * along - point))
