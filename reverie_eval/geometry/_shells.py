"""Shells of rooms: floor, ceiling, walls and doors around a camera, as flat faces in a picture.

The model of a building knows where rooms are by their objects alone, so walls are guessed where no
object is; and a wall that fills a picture shows no room. Near walls are therefore moved away from
the camera: more of them ahead than at its sides. Doors are holes in the walls, through which other
rooms of the storey are seen.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.geometry._buildings import Building, Line, Room, door_spans
from reverie_eval.geometry._polygons import clip_at_depth
from reverie_eval.geometry._solids import CAMERA_HEIGHT
from reverie_eval.geometry._views import VIEW_AXES, Picture, pixels_of, world_to_camera

CEILING = 1.1
"""Metres from a camera to the ceiling, if nothing on a wall is higher."""
# Metres from the floor: to the top of a door, a skirting board and a wainscot.
_DOOR, _SKIRTING, _WAINSCOT = 2.05, 0.1, 0.9
# Metres: of the frame of a door and a moulding.
_FRAME, _MOULDING = 0.08, 0.05
# Metres from edges of walls within which less light falls: bands on each other.
_SHADES = {"shade": 0.5, "shade half": 0.33, "shade third": 0.2, "shade last": 0.09}
# Metres: how thick a wall is in a door, and how near to it something hangs that closes it.
_THICK, _CLOSED = 0.14, 0.5
# Metres by which rooms beside each other may overlap.
_OVERLAP = 0.3
# Metres from a camera to the walls at its sides and ahead, at least, and to what moves them.
_BESIDE, _AHEAD, _REACH = 1.6, 2.4, 6.0
# Metres that are seen beyond a door without a room, and between the joints of a floor: of boards
# there, and to where a board ends.
_BEYOND, _JOINT, _BOARD = 2.5, 0.4, 1.8
# Metres within which joints are drawn.
_FINE = 9.0
# Boards end at this part of their length after those beside them.
_SHIFT = 0.618
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
    rise: float = CEILING
    """Metres up to the ceiling."""

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
        return float(self.position[2]) + self.rise

    def is_beside(self, pixels: FloatArray) -> FloatArray:
        """Whether points of shape (..., n, 2) are all at one side of the picture."""
        _, left, top, width, height = self.picture
        is_before = (pixels < (left, top)).all(axis=-2)
        is_after = (pixels > (left + width, top + height)).all(axis=-2)
        return np.asarray((is_before | is_after).any(axis=-1))

    def pixels(self, corners: FloatArray) -> FloatArray:
        """Project a flat outline; shape (0, 2) if it is behind the camera or beside the picture."""
        return next(iter(self.outlines(corners[None])), np.zeros((0, 2)))

    def outlines(self, corners: FloatArray) -> Sequence[FloatArray]:
        """Project flat outlines of shape (n, k, 3); leave out those that are not in the picture."""
        seen = world_to_camera(corners, self.position, self.axes)
        near = seen[..., 2].min(axis=1, initial=np.inf) < NEAREST
        pixels = pixels_of(np.where(near[:, None, None], 1.0, seen))
        is_beside = self.is_beside(pixels) & ~near
        found = []
        for row in np.flatnonzero(~is_beside).tolist():
            outline = pixels[row]
            if near[row]:
                clipped = clip_at_depth(seen[row], NEAREST)
                outline = pixels_of(clipped)
                if not len(clipped) or self.is_beside(outline):
                    continue
            found.append(outline)
        return found

    def flat(self, kind: str, outlines: Sequence[FloatArray], height: float) -> Iterator[Face]:
        """Yield a face of outlines of shape (n, 2) at a height, if it is in the picture."""
        found = [self.pixels(_at(each, height)) for each in outlines]
        if any(map(len, found)):
            yield Face(kind, [each for each in found if len(each)])

    def upright(
        self, kind: str, ends: FloatArray, low: float, high: float, *holes: FloatArray
    ) -> Iterator[Face]:
        """Yield an upright face with ends of shape (2, 2), if it is in the picture.

        Holes have corners of shape (4, 3).
        """
        found = self.pixels(_upright(ends, low, high))
        if len(found):
            yield Face(kind, [found, *filter(len, map(self.pixels, holes))])


class Shell:
    """The walls and doors around a camera."""

    def __init__(
        self, building: Building, storey: int, room: int, camera: Camera, within: FloatArray
    ) -> None:
        """Take the walls of a room, or any; points of shape (n, 2) are within, if they are near."""
        self._building, self._camera = building, camera
        self._storey, self._room = storey, room
        self._here, self._axes = camera.position[:2], building.solids.axes
        self._reach = self._reach_of(within)
        (left, bottom), (right, top) = -self._reach[0], self._reach[1]
        corners = np.array([(left, bottom), (right, bottom), (right, top), (left, top)])
        outlines: Sequence[FloatArray] = [self._here + corners @ self._axes]
        self._name, self._within = "", np.zeros((2, 2))
        if room >= 0 and building.rooms[room].contains(self._here[None])[0]:
            outlines = [self._moved(each) for each in building.rooms[room].outlines]
            off = (np.vstack(building.rooms[room].outlines) - self._here) @ self._axes.T
            self._within = np.array([off.min(axis=0), off.max(axis=0)])
            self._name = building.rooms[room].name
        self._outlines = outlines
        self._walls = [*_walls_of(outlines)]
        moved = [self._moved_door(each) for each in building.doors_on(storey)]
        self._doors = [(wall, ends) for wall in self._walls for ends in _openings(moved, wall)]

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
        walls = np.array(self._walls)
        ray, off = points - self._here, walls[:, 0] - self._here
        along = walls[:, 1] - walls[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            area = _cross(ray[:, None], along)
            far, share = _cross(off, along) / area, _cross(off, ray[:, None]) / area
        far = np.where((far > 0) & (share >= 0) & (share <= 1), far, np.inf)
        wall, far = far.argmin(axis=1), far.min(axis=1)
        out = np.column_stack([along[wall, 1], -along[wall, 0]]) @ self._axes.T
        return np.where(np.isfinite(far), far, 1.0), np.hstack([out, -out]).argmax(axis=1)

    def finish(self, camera: Camera, hung: FloatArray) -> None:
        """Take the camera with its ceiling; close the doors before which something hangs.

        That is at points of shape (n, 2).
        """
        self._camera = camera
        self._doors = [
            (wall, ends) for wall, ends in self._doors if not _is_before(ends, hung).any()
        ]
        top = camera.floor + _DOOR
        corners = [_upright(ends, camera.floor, top) for _, ends in self._doors]
        found = camera.outlines(np.array(corners).reshape(-1, 4, 3))
        rectangles = [(each.min(axis=0), each.max(axis=0)) for each in found]
        self._holes = np.array(rectangles).reshape(-1, 2, 2)

    def is_seen(self, outlines: Sequence[FloatArray]) -> bool:
        """Whether outlines may be seen through a door: the rectangles around them overlap."""
        points = np.concatenate([np.zeros((0, 2)), *outlines])
        low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
        is_seen = (low < self._holes[:, 1]) & (high > self._holes[:, 0])
        return bool(is_seen.all(axis=1).any())

    def beyond(self) -> Iterator[tuple[int, FloatArray, list[Face]]]:
        """Yield the other rooms of the storey that may be seen through doors, the farthest first.

        Each comes as its index, how far it is moved with the walls of this one, shape (2,), and the
        faces of its floor, ceiling and walls.
        """
        if not len(self._holes):
            return
        others = [
            (index, *self._moved_room(room))
            for index, room in enumerate(self._building.rooms)
            if room.storey == self._storey and index != self._room
        ]
        for index, by, room in sorted(others, key=lambda each: -self._metres_to(each[2])):
            faces = list(self._room_faces(room))
            if faces:
                yield index, by, faces

    def _moved_room(self, room: Room) -> tuple[FloatArray, Room]:
        """Move another room as far as the walls of this one that are between; say how far."""
        off = (np.vstack(room.outlines) - self._here) @ self._axes.T
        low, high = off.min(axis=0), off.max(axis=0)
        own_low, own_high = self._within
        up = np.maximum(self._reach[1] - own_high, 0) * (low > own_high - _OVERLAP)
        down = np.maximum(self._reach[0] + own_low, 0) * (high < own_low + _OVERLAP)
        by = (up - down) @ self._axes
        return by, room._replace(outlines=[each + by for each in room.outlines])

    def _metres_to(self, room: Room) -> float:
        """Return the metres to the middle of a room."""
        corners = np.vstack(room.outlines)
        return float(np.linalg.norm((corners.min(axis=0) + corners.max(axis=0)) / 2 - self._here))

    def _room_faces(self, room: Room) -> Iterator[Face]:
        """Yield the faces of another room that may be seen through doors."""
        camera = self._camera
        flat = [
            *camera.flat(_floor_of(room.name), room.outlines, camera.floor),
            *camera.flat("ceiling", room.outlines, camera.ceiling),
        ]
        yield from (face for face in flat if self.is_seen(face.outlines))
        walls = _walls_of(room.outlines)
        for wall in sorted(walls, key=lambda ends: -_distance(self._here, ends)):
            if _cross(wall[1] - wall[0], self._here - wall[0]) > 0:
                whole = camera.outlines(_upright(wall, camera.floor, camera.ceiling)[None])
                if self.is_seen(whole):
                    yield from self._wall(wall, [])

    def faces(self) -> Iterator[Face]:
        """Yield floor and ceiling, and then the walls with their doors, the farthest first."""
        camera = self._camera
        yield from camera.flat(_floor_of(self._name), self._outlines, camera.floor)
        joints = [*self._near(floor_joints(self._outlines, self._axes, self._name, _JOINT))]
        if self._name not in _TILED:
            joints += _board_ends(joints, self._axes)
        yield Face("joint", camera.outlines(_at(np.array(joints).reshape(-1, 2, 2), camera.floor)))
        yield from camera.flat("ceiling", self._outlines, camera.ceiling)
        walls = sorted(self._walls, key=lambda ends: -_distance(self._here, ends))
        # A wall that is seen from outside of the room is not drawn.
        walls = [wall for wall in walls if _cross(wall[1] - wall[0], self._here - wall[0]) > 0]
        for kind, metres in _SHADES.items():
            bands = [np.concatenate([its, its[::-1] - _outwards(its) * metres]) for its in walls]
            corners = [_at(each, z) for each in bands for z in (camera.floor, camera.ceiling)]
            yield Face(kind, camera.outlines(np.array(corners)))
        for wall in walls:
            doors = [ends for its, ends in self._doors if its is wall]
            for ends in doors:
                yield from camera.upright("depth", ends, camera.floor, camera.floor + _DOOR)
                yield from _jambs(ends, camera)
            yield from self._wall(wall, doors)
            for kind, metres in _SHADES.items():
                yield from _wall_shades(kind, wall, metres, camera)
            for ends in doors:
                yield from _casing(ends, camera)

    def _near(self, joints: Iterable[FloatArray]) -> Iterator[FloatArray]:
        """Yield what is near of joints; farther away, they would be a dark spot."""
        for joint in joints:
            off = (joint - self._here) @ self._axes.T
            near = np.clip(off, -_FINE, _FINE)
            across = np.ptp(off, axis=0).argmin()
            if near[0, across] == off[0, across] and np.ptp(near) > 0:
                yield self._here + near @ self._axes

    def _wall(self, wall: FloatArray, doors: Sequence[FloatArray]) -> Iterator[Face]:
        """Yield a wall with holes for its doors, and the boards on it."""
        camera, light = self._camera, self._building.shade_of(wall[1] - wall[0])
        floor, ceiling = camera.floor, camera.ceiling
        wainscot, moulding = floor + _WAINSCOT, ceiling - _MOULDING
        high = [_upright(ends, wainscot, floor + _DOOR) for ends in doors]
        yield from camera.upright(f"wall {light}", wall, wainscot, ceiling, *high)
        low = [_upright(ends, floor, wainscot) for ends in doors]
        yield from camera.upright(f"wainscot {light}", wall, floor, wainscot, *low)
        for piece in _between(wall, doors):
            yield from camera.upright("skirting", piece, floor, floor + _SKIRTING)
            yield from camera.upright("skirting", piece, wainscot, wainscot + _MOULDING)
        yield from camera.upright("skirting", wall, moulding, ceiling)

    def nowhere(self) -> Iterator[Face]:
        """Yield what is behind each door if no room is: a floor, a wall, the ceiling if it is far.

        The sides of what is seen are upright, so they are on the same rays as those of the door.
        """
        camera = self._camera
        for _, ends in self._doors:
            off = ends - self._here
            along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            yield from camera.upright("opening", ends, camera.floor, camera.floor + _DOOR)
            far = self._here + off * (1 + _BEYOND / abs(_cross(along, off[0])))
            yield from camera.flat("beyond", [np.concatenate([ends, far[::-1]])], camera.floor)
            yield from camera.upright("skirting", far, camera.floor, camera.floor + _SKIRTING)
            meets = self._here + off * camera.rise / (_DOOR - CAMERA_HEIGHT)
            if _distance(self._here, far) > _distance(self._here, meets):
                outline = np.concatenate([meets, far[::-1]])
                yield from camera.flat("ceiling", [outline], camera.ceiling)


def _floor_of(room: str) -> str:
    return "floor tiled" if room in _TILED else "floor"


def _walls_of(outlines: Sequence[FloatArray]) -> FloatArray:
    """Return the walls of a room, shape (n, 2, 2); what was moved may have no length any more."""
    walls = np.concatenate(
        [np.stack([each, np.roll(each, -1, axis=0)], axis=1) for each in outlines]
    )
    return np.asarray(walls[np.abs(walls[:, 1] - walls[:, 0]).max(axis=1) > _FRAME])


def _outwards(ends: FloatArray) -> FloatArray:
    """Return the unit vector from a wall out of its room, shape (2,)."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return np.array([along[1], -along[0]])


def _at(points: FloatArray, height: float) -> FloatArray:
    """Return points of shape (..., 2) at a height."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), height)], axis=-1)


def _upright(ends: FloatArray, low: float, high: float) -> FloatArray:
    """Return the corners of an upright face, shape (4, 3)."""
    start, end = ends
    return np.array([(*start, low), (*end, low), (*end, high), (*start, high)])


def _is_before(ends: FloatArray, points: FloatArray) -> BoolArray:
    """Whether points of shape (n, 2) are before a door."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    off = points - ends[0]
    is_beside = (off @ along < -_FRAME) | ((points - ends[1]) @ along > _FRAME)
    return np.asarray((np.abs(_cross(along, off)) < _CLOSED) & ~is_beside)


def _between(wall: FloatArray, doors: Sequence[FloatArray]) -> Iterator[FloatArray]:
    """Yield the ends of the pieces of a wall beside its doors."""
    start = wall[0]
    for ends in [*doors, wall[::-1]]:
        if np.abs(ends[0] - start).max() > 0:
            yield np.array([start, ends[0]])
        start = ends[1]


def _wall_shades(kind: str, wall: FloatArray, metres: float, camera: Camera) -> Iterator[Face]:
    """Yield the bands at the sides and the upper edge of a wall on which less light falls."""
    length = np.linalg.norm(wall[1] - wall[0])
    aside = (wall[1] - wall[0]) * min(metres / length, 0.5)
    floor, ceiling = camera.floor, camera.ceiling
    bands = [
        _upright(np.array([wall[0], wall[0] + aside]), floor, ceiling),
        _upright(np.array([wall[1] - aside, wall[1]]), floor, ceiling),
        _upright(wall, ceiling - metres, ceiling),
    ]
    yield Face(kind, camera.outlines(np.array(bands)))


def _jambs(ends: FloatArray, camera: Camera) -> Iterator[Face]:
    """Yield what is seen of a wall's thickness in a door, before the wall is drawn over it."""
    out = _outwards(ends) * _THICK
    top = camera.floor + _DOOR
    yield from camera.flat("sill", [np.concatenate([ends, ends[::-1] + out])], camera.floor)
    for end in ends:
        yield from camera.upright("jamb", np.array([end, end + out]), camera.floor, top)
    yield from camera.flat("jamb", [np.concatenate([ends, ends[::-1] + out])], top)


def _casing(ends: FloatArray, camera: Camera) -> Iterator[Face]:
    """Yield the frame around a door."""
    aside = _FRAME * (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    top = camera.floor + _DOOR
    around = np.array([ends[0] - aside, ends[1] + aside])
    yield from camera.upright("frame", np.array([ends[0] - aside, ends[0]]), camera.floor, top)
    yield from camera.upright("frame", np.array([ends[1], ends[1] + aside]), camera.floor, top)
    yield from camera.upright("frame", around, top, top + _FRAME)


def _board_ends(joints: Sequence[FloatArray], axes: FloatArray) -> Iterator[FloatArray]:
    """Yield the joints between the ends of boards, each of shape (2, 2): they lie in rows."""
    for row, joint in enumerate(joints):
        (start, across), (end, _) = joint @ axes.T
        low, high = sorted((start, end))
        first = low + _BOARD * (row * _SHIFT % 1)
        for at in np.arange(first, high, _BOARD):
            yield np.array([(at, across - _JOINT), (at, across)]) @ axes


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
