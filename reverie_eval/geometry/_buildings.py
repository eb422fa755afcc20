"""Model a building from its navigation graph and the objects that are seen from its viewpoints.

Nothing published says where the rooms of a building are. But object ids follow the order of the
``.house`` files, which list a building region by region [1]_: a room is a run of ids close
together in space. All thresholds below are lengths and counts of houses; they were chosen on the 90
buildings of Matterport3D, and ``benchmarks/buildings.py`` prints how well they do.

The world is metric with z up; plans are seen from above.

References
----------
.. [1] ``data_organization.md`` of niessner/Matterport.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby
from typing import Literal, NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.geometry._plans import DOOR_WIDTH, Plan, axes_of, without_outliers
from reverie_eval.geometry._polygons import are_inside
from reverie_eval.geometry._room_names import is_outdoors, name_room
from reverie_eval.geometry._room_parts import RoomParts
from reverie_eval.geometry._solids import CAMERA_HEIGHT, Solids
from reverie_eval.geometry._views import FOCAL_LENGTH, HEIGHT, VIEW_AXES, WIDTH, rays_of

# Storeys: the spread of camera heights on one floor, the least distance between two floors, and the
# least number and share of viewpoints on a floor; fewer are a landing.
_FLOOR_SPREAD, _STOREY_HEIGHT = 0.25, 1.9
_LEAST_ON_STOREY, _LEAST_SHARE = 2, 0.02
# Objects: the usual distance from the camera, and how much it weighs against a ray.
_USUAL_DISTANCE, _GUESS = 1.45, 0.005
# Rooms: the least spread of objects along an axis, the cost of another room, objects in a room.
_LEAST_SPREAD, _PENALTY = 0.6, 9.0
_FEWEST, _MOST = 3, 250
# The room of a viewpoint: metres that tell near objects, and the area whose room counts half.
_AT_HAND, _NEAR, _LARGE = 0.5, 1.5, 50.0
# Metres from a viewpoint to what it lists, at most: boxes are released of objects so near.
_IN_SIGHT = 3.0
# Stairs: the least climb of an edge, its slopes, the least climb of edges that lead on from each
# other, metres up from tread to tread, and the least metres between treads of two edges.
_CLIMB, _SLOPES, _FLIGHT, _TREAD, _APART = 0.4, (0.25, 2.5), 1.0, 0.19, 0.3
# The part of a flight that is not seen from the storey above.
_BELOW = 0.5
# Metres between a door and its wall, at most.
_IN_WALL = 0.05
# Decimals of a metre to which the lines of two rooms' walls are the same.
_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class Sightings:
    """Which objects are seen from which viewpoints, a row for each pair."""

    viewpoint: IntArray
    """Shape (n,): row of the viewpoint."""
    object_id: IntArray
    """Shape (n,): in the order of the ``.house`` file."""
    direction: FloatArray
    """Shape (n, 3): unit vectors from the viewpoint to the object."""
    distance: FloatArray
    """Shape (n,): metres to the object's centre; inf if unknown."""
    extent: FloatArray
    """Shape (n, 2): how wide and high the object looks, in metres for each metre of distance."""
    names: Sequence[str]
    """The name of the object, for people."""

    @classmethod
    def of_boxes(
        cls,
        *,
        viewpoint: IntArray,
        object_id: IntArray,
        distance: FloatArray,
        names: Sequence[str],
        row: IntArray,
        view: IntArray,
        xywh: IntArray,
    ) -> Self:
        """Look at the middle of each object: of its whole boxes, weighted by their areas.

        ``row``, ``view`` and ``xywh`` have a row for each box: the sighting that it belongs to, its
        view and its pixels. If all boxes of an object are cut by their images' edges, all count.
        """
        corner, size = xywh[:, :2].astype(np.float64), xywh[:, 2:].astype(np.float64)
        is_whole = ((corner > 0) & (corner + size < (WIDTH, HEIGHT))).all(axis=1)
        has_whole = np.bincount(row[is_whole], minlength=len(names)) > 0
        area = size.prod(axis=1) * (is_whole | ~has_whole[row])
        rays = rays_of(corner + size / 2)
        away = np.linalg.norm(rays, axis=1)
        rays *= (area / away)[:, None]
        direction = np.zeros((len(names), 3))
        np.add.at(direction, row, np.einsum("ni,nij->nj", rays, VIEW_AXES[view]))
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        extent = np.zeros((len(names), 2))
        np.add.at(extent, row, (area / away)[:, None] * size / FOCAL_LENGTH)
        extent /= np.bincount(row, area, minlength=len(names))[:, None]
        return cls(viewpoint, object_id, direction / length, distance, extent, names)

    def none(self) -> Self:
        """Return no sightings."""
        return type(self)(
            viewpoint=self.viewpoint[:0],
            object_id=self.object_id[:0],
            direction=self.direction[:0],
            distance=self.distance[:0],
            extent=self.extent[:0],
            names=(),
        )


class Room(NamedTuple):
    """A room on its storey."""

    name: str
    """What its objects tell; empty if they do not."""
    storey: int
    """From 0 for the lowest."""
    outlines: Sequence[FloatArray]
    """Corners, each of shape (n, 2): the outline, and those of holes and separate parts."""
    area: float
    """Square metres."""
    is_outdoors: bool = False
    """Whether its objects tell that it has no walls of its own."""
    is_hall: bool = False
    """Whether it has no objects, only ways between other rooms."""
    is_side_part: bool = False
    """Whether another part of the same room has more of its objects."""

    def contains(self, points: FloatArray) -> BoolArray:
        """Whether points of shape (n, 2) are in the room: within an odd number of outlines.

        A point on a wall is outside; on the wall around a hole, it is inside.
        """
        corners = (np.broadcast_to(each, (len(points), *each.shape)) for each in self.outlines)
        return np.asarray(np.logical_xor.reduce([are_inside(points, each) for each in corners]))


class Line(NamedTuple):
    """A door in a wall."""

    storey: int
    ends: FloatArray
    """Shape (2, 2)."""


class Tread(NamedTuple):
    """A tread of stairs."""

    storey: int
    ends: FloatArray
    """Shape (2, 2): across its middle."""
    step: FloatArray
    """Shape (2,): from the middle of one tread to that of the next, which is higher."""
    height: float
    """Metres from the floor of the storey; below it, less than 0."""


class Wall(NamedTuple):
    """A straight wall, as far as it has a room on one side, or as far as it has one on both."""

    ends: FloatArray
    """Shape (2, 2); a room is on the left."""
    is_outer: bool
    """Whether none is on the right."""


@dataclass(frozen=True, eq=False)
class Building:
    """The storeys of a building with their rooms, doors and stairs."""

    storey: IntArray
    """Shape (n_viewpoints,): from 0 for the lowest."""
    room: IntArray
    """Shape (n_viewpoints,): index into ``rooms``; -1 outside of all."""
    rooms: Sequence[Room]
    doors: Sequence[Line]
    treads: Sequence[Tread]
    solids: Solids
    """The objects."""

    def shade_of(self, wall: FloatArray) -> Literal["lit", "dim"]:
        """Return the light on a wall of a direction, shape (2,): ``lit`` along the first axis."""
        along, across = np.abs(self.solids.axes @ wall)
        return "lit" if along > across else "dim"

    def rooms_on(self, storey: int) -> Sequence[Room]:
        """Return the rooms of a storey."""
        return [room for room in self.rooms if room.storey == storey]

    def doors_on(self, storey: int) -> Sequence[Line]:
        """Return the doors of a storey."""
        return [door for door in self.doors if door.storey == storey]

    def walls_on(self, storey: int) -> Iterator[Wall]:
        """Yield the walls of a storey, each once, although it is in the outlines of both rooms."""
        lines: dict[tuple[int, float], list[tuple[float, float]]] = {}
        within = [room.outlines for room in self.rooms_on(storey) if not room.is_outdoors]
        for outline in chain.from_iterable(within):
            corners = (outline @ self.solids.axes.T).round(_DECIMALS)
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                along = int(np.abs(end - start).argmax())
                span = float(start[along]), float(end[along])
                lines.setdefault((along, float(start[1 - along])), []).append(span)
        for (along, at), spans in lines.items():
            for first, last, is_outer in _by_sides(spans):
                ends = np.full((2, 2), at)
                ends[:, along] = first, last
                yield Wall(ends @ self.solids.axes, is_outer)

    def treads_on(self, storey: int) -> Sequence[Tread]:
        """Return the treads of stairs that begin or end on a storey."""
        return [tread for tread in self.treads if tread.storey == storey]

    def around(self, points: FloatArray, storey: IntArray, metres: float) -> Self:
        """Return the building with the rooms and treads that are at most so far from some points.

        Points have the shape (n_points, 2), and a storey each. A room is in the rectangle around
        it, along the walls of the building.
        """
        axes = self.solids.axes

        def is_near(corners: FloatArray, on: int) -> bool:
            corners, here = corners @ axes.T, points[storey == on] @ axes.T
            off = np.maximum(corners.min(axis=0) - here, here - corners.max(axis=0))
            return bool((np.hypot(*np.maximum(off, 0).T) <= metres).any())

        shown = np.array([is_near(np.vstack(its.outlines), its.storey) for its in self.rooms], bool)
        number = np.append(np.where(shown, np.cumsum(shown) - 1, -1), -1)
        return replace(
            self,
            room=number[self.room],
            rooms=[room for room, is_shown in zip(self.rooms, shown, strict=True) if is_shown],
            treads=[tread for tread in self.treads if is_near(tread.ends, tread.storey)],
            solids=replace(self.solids, room=number[self.solids.room]),
        )


def model_building(position: FloatArray, edges: IntArray, seen: Sightings) -> Building:
    """Find the storeys, rooms, doors and stairs of a building.

    Parameters
    ----------
    position : float array of shape (n_viewpoints, 3)
        Where the cameras were, metres.
    edges : int array of shape (n_edges, 2)
        Pairs of viewpoints between which one can walk, each once.
    seen : Sightings
        The objects; fewer than three make no room.
    """
    storey = find_storeys(position[:, 2])
    if len(np.unique(seen.object_id)) < _FEWEST:
        seen = seen.none()
    objects = _Objects.of(position, seen)
    axes = axes_of(np.vstack([objects.centre[:, :2], position[:, :2]]))
    centre, camera = objects.centre[:, :2] @ axes.T, position[:, :2] @ axes.T
    room_storey = objects.storeys_of_rooms(storey)
    evidence = [without_outliers(centre[objects.room == n]) for n in range(objects.n_rooms)]
    boxes = np.array([[each.min(axis=0), each.max(axis=0)] for each in evidence]).reshape(-1, 2, 2)
    on_storey = storey[:, None] == room_storey
    home = _rooms_of_viewpoints(objects.votes_of_viewpoints(), camera, boxes, on_storey)
    ways = _ways_of_rooms(home[edges], len(room_storey))
    evidence = [_within_sight(its, camera[home == room]) for room, its in enumerate(evidence)]
    things = [objects.names_in(room) for room in range(objects.n_rooms)]
    outdoors = [is_outdoors(names) for names in things]
    parts = RoomParts.of(evidence, camera, edges, home, outdoors)
    main = parts.main
    flights = _flights(position, edges) if storey.any() else []
    found: list[Room] = []
    doors: list[Line] = []
    number = np.full(len(parts.room), -1)
    for level in range(int(storey.max()) + 1):
        here = np.flatnonzero(room_storey[parts.room] == level)
        inside = edges[(storey[edges] == level).all(axis=1)]
        alone = np.repeat(np.flatnonzero(storey == level)[:, None], 2, axis=1)
        legs = np.concatenate([camera[inside], *_seen_on(level, flights, camera, storey)])
        # A building without objects has no rooms at all.
        ways_there = np.concatenate([legs, camera[alone]]) if evidence else legs[:0]
        points = [(parts.objects[part], parts.cameras[part]) for part in here.tolist()]
        plan = Plan.of(parts.boxes[here], points, ways_there)
        for index in range(plan.n_rooms):
            outlines = list(plan.outlines(index))
            if not outlines:
                continue
            turned = [corners @ axes for corners in outlines]
            its = Room("", level, turned, plan.area(index), is_hall=index >= len(here))
            if not its.is_hall:
                part = int(here[index])
                room = int(parts.room[part])
                number[part] = len(found)
                siblings = np.flatnonzero(parts.room[here] == room).tolist()
                corners = np.vstack([each for row in siblings for each in plan.outlines(row)])
                sides = np.ptp(corners, axis=0)
                name = name_room(things[room], int(ways[room]), float(sides.max() / sides.min()))
                its = its._replace(
                    name=name if len(parts.objects[part]) else "",
                    is_outdoors=outdoors[room],
                    is_side_part=part not in main,
                )
            found.append(its)
        doors += [Line(level, ends @ axes) for ends in plan.doors(legs)]
    part_of_object = parts.nearest(centre, objects.room)
    return Building(
        storey=storey,
        room=np.append(number, -1)[parts.home],
        rooms=found,
        doors=doors,
        treads=[
            each for each in _treads(position, flights, storey, axes) if _is_within(each, found)
        ],
        solids=Solids.of(
            object_id=np.unique(seen.object_id),
            names=objects.names,
            storey=room_storey[objects.room],
            room=number[part_of_object],
            centre=objects.centre,
            size=objects.sizes(),
            bounds=parts.boxes[part_of_object],
            floors=floors_of(position[:, 2], storey),
            axes=axes,
        ),
    )


def find_storeys(height: FloatArray) -> IntArray:
    """Assign the viewpoints of a building to storeys by the heights of their cameras.

    Cameras stand at one height above each floor, so a floor is a peak of the density of heights. A
    viewpoint between two storeys, on stairs, belongs to the nearer one. Heights are in metres, and
    the lowest storey is 0; both have the shape (n_viewpoints,).

    Examples
    --------
    >>> find_storeys(np.array([1.5, 1.5, 1.6, 2.9, 4.3, 4.3, 4.4]))
    array([0, 0, 0, 0, 1, 1, 1])
    """
    density = np.exp(-(((height[:, None] - height) / _FLOOR_SPREAD) ** 2) / 2).sum(axis=1)
    least = max(_LEAST_ON_STOREY, _LEAST_SHARE * len(height))
    floors: list[float] = []
    for row in np.argsort(-density, kind="stable").tolist():
        is_apart = all(abs(height[row] - floor) >= _STOREY_HEIGHT for floor in floors)
        # The most common height is a floor, even if only one viewpoint has it.
        if is_apart and (density[row] >= least or not floors):
            floors.append(float(height[row]))
    storey: IntArray = np.abs(height[:, None] - np.sort(floors)).argmin(axis=1)
    return storey


def door_spans(doors: Sequence[Line], start: FloatArray, end: FloatArray) -> FloatArray:
    """Return where doors are in a wall: metres from its start, shape (n_doors, 2).

    They are in it if both ends are on its line; a span may begin before the wall, or end after it.
    """
    along = (end - start) / np.linalg.norm(end - start)
    offset = np.array([door.ends for door in doors]).reshape(-1, 2, 2) - start
    across = np.abs(offset[..., 0] * along[1] - offset[..., 1] * along[0])
    return np.asarray(np.sort(offset @ along, axis=1)[(across < _IN_WALL).all(axis=1)])


def _by_sides(spans: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float, bool]]:
    """Yield the parts of a line on which spans are, and whether only one is there.

    Spans lead up or down; so do the parts with one.
    """
    marks = sorted(set(chain.from_iterable(spans)))
    over = [
        sorted(begin < end for begin, end in spans if min(begin, end) <= mark < max(begin, end))
        for mark in marks
    ]
    for leads_up, group in groupby(range(len(marks)), key=over.__getitem__):
        rows = [*group]
        if leads_up:
            low, high = marks[rows[0]], marks[rows[-1] + 1]
            first, last = (low, high) if any(leads_up) else (high, low)
            yield first, last, len(leads_up) == 1


def floors_of(height: FloatArray, storey: IntArray) -> FloatArray:
    """Return the height of the floor of each storey, metres: below the median of its cameras."""
    return np.array(
        [np.median(height[storey == level]) - CAMERA_HEIGHT for level in range(storey.max() + 1)]
    )


# Objects and rooms.


class _Objects(NamedTuple):
    """The objects of a building, and the viewpoints that see them."""

    position: FloatArray
    """Shape (n_viewpoints, 3)."""
    seen: Sightings
    row: IntArray
    """Shape (n_sightings,): the object of each sighting."""
    names: Sequence[str]
    """In the order of ids, as all that follows."""
    centre: FloatArray
    """Shape (n_objects, 3)."""
    room: IntArray
    """Shape (n_objects,)."""

    @classmethod
    def of(cls, position: FloatArray, seen: Sightings) -> Self:
        """Find where the objects are, and which are in the same room."""
        ids, first, row = np.unique(seen.object_id, return_index=True, return_inverse=True)
        names = [seen.names[index] for index in first.tolist()]
        centre = _centres(position[seen.viewpoint], seen, row, len(ids))
        return cls(position, seen, row, names, centre, _split_into_rooms(centre))

    @property
    def n_rooms(self) -> int:
        return int(self.room.max(initial=-1)) + 1

    def storeys_of_rooms(self, storey: IntArray) -> IntArray:
        """Return the storey of the viewpoints that see most of each room."""
        votes = np.zeros((self.n_rooms, int(storey.max()) + 1))
        rooms = self.room[self.row]
        np.add.at(votes, (rooms, storey[self.seen.viewpoint]), self._nearness)
        return np.asarray(votes.argmax(axis=1))

    def names_in(self, room: int) -> Sequence[str]:
        """Return the names of the objects of a room."""
        return [self.names[row] for row in np.flatnonzero(self.room == room).tolist()]

    def sizes(self) -> FloatArray:
        """Return how wide and high the objects look, shape (n_objects, 2), metres: medians."""
        offset = self.centre[self.row] - self.position[self.seen.viewpoint]
        size = self.seen.extent * np.linalg.norm(offset, axis=1, keepdims=True)
        order = np.argsort(self.row, kind="stable")
        begin = np.searchsorted(self.row[order], np.arange(1, len(self.names)))
        groups = np.split(size[order], begin)
        return np.array([np.median(its, axis=0) for its in groups if len(its)]).reshape(-1, 2)

    def votes_of_viewpoints(self) -> FloatArray:
        """Return how much the objects that a viewpoint sees, and those near it, are of each room.

        Shape (n_viewpoints, n_rooms).
        """
        votes = np.zeros((len(self.position), self.n_rooms))
        np.add.at(votes, (self.seen.viewpoint, self.room[self.row]), self._nearness)
        away = np.linalg.norm(self.position[:, None] - self.centre, axis=2)
        np.add.at(votes.T, self.room, np.exp(-((away / _NEAR) ** 2)).T / 2)
        return votes

    @property
    def _nearness(self) -> FloatArray:
        """The weight of each sighting: near viewpoints are more likely in the object's room."""
        offset = self.centre[self.row] - self.position[self.seen.viewpoint]
        return np.asarray(1 / (_AT_HAND + np.linalg.norm(offset, axis=1)))


def _centres(camera: FloatArray, seen: Sightings, row: IntArray, count: int) -> FloatArray:
    """Return the points nearest to all rays to each object, by least squares.

    Along its ray an object is at its distance if that is known; otherwise at the usual one, with so
    little weight that two rays decide.
    """
    is_known = np.isfinite(seen.distance)
    distance = np.where(is_known, seen.distance, _USUAL_DISTANCE)
    weight = np.where(is_known, 1.0, _GUESS)[:, None, None]
    along = seen.direction[:, :, None] * seen.direction[:, None]
    matrix = np.eye(3) - (1 - weight) * along
    there = camera + distance[:, None] * seen.direction
    left, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(left, row, matrix)
    np.add.at(right, row, np.einsum("nij,nj->ni", matrix, there))
    return np.asarray(np.linalg.solve(left, right[..., None])[..., 0])


def _split_into_rooms(centre: FloatArray) -> IntArray:
    """Cut the sequence of objects into runs that are close together, by dynamic programming.

    A run costs half its length times the sum over the axes of the logarithms of its variances,
    plus a penalty: the likelihood of a Gaussian for each room.
    """
    count = len(centre)
    zero = np.zeros((1, 3))
    total = np.vstack([zero, np.cumsum(centre, axis=0)])
    square = np.vstack([zero, np.cumsum(centre**2, axis=0)])
    cost, begin = np.full(count + 1, np.inf), np.zeros(count + 1, dtype=np.int64)
    cost[0] = 0.0
    for end in range(_FEWEST, count + 1):
        start = np.arange(max(0, end - _MOST), end - _FEWEST + 1)
        length = (end - start)[:, None]
        variance = (square[end] - square[start]) / length - (
            (total[end] - total[start]) / length
        ) ** 2
        spread = np.log(np.maximum(variance, 0) + _LEAST_SPREAD**2).sum(axis=1)
        whole = cost[start] + length[:, 0] / 2 * spread + _PENALTY
        best = int(whole.argmin())
        cost[end], begin[end] = whole[best], start[best]
    is_first = np.zeros(count, dtype=np.int64)
    end = count
    while end > 0:
        end = int(begin[end])
        is_first[end] = 1
    return np.cumsum(is_first) - 1


def _rooms_of_viewpoints(
    votes: FloatArray, camera: FloatArray, boxes: FloatArray, may_be: BoolArray
) -> IntArray:
    """Let objects and the rooms around it vote on each viewpoint's room; -1 if none is possible.

    Shapes: votes and ``may_be`` (n_viewpoints, n_rooms), cameras (n_viewpoints, 2), boxes
    (n_rooms, 2, 2).
    """
    if not len(boxes):
        return np.full(len(camera), -1)
    is_within = ((camera[:, None] >= boxes[:, 0]) & (camera[:, None] <= boxes[:, 1])).all(axis=2)
    area = (boxes[:, 1] - boxes[:, 0]).prod(axis=1)
    votes = np.where(may_be, votes + is_within / (1 + area / _LARGE), 0)
    return np.where(votes.max(axis=1) > 0, votes.argmax(axis=1), -1)


def _within_sight(objects: FloatArray, cameras: FloatArray) -> FloatArray:
    """Return the objects of a room, shape (n, 2), that its viewpoints can have listed.

    Others are of another room, or not where they seem to be; without any, all are returned. If a
    room has no viewpoint, its objects are near their median.
    """
    if not len(cameras):
        cameras = np.median(objects, axis=0, keepdims=True)
    away = np.hypot(*np.moveaxis(objects[:, None] - cameras, -1, 0)).min(axis=1)
    is_near = away <= _IN_SIGHT
    return objects[is_near] if is_near.any() else objects


def _ways_of_rooms(between: IntArray, count: int) -> IntArray:
    """Count the other rooms to which edges lead from each; -1 is no room."""
    is_way = (between[:, 0] != between[:, 1]) & (between >= 0).all(axis=1)
    pairs = np.unique(np.sort(between[is_way], axis=1), axis=0)
    return np.bincount(pairs.ravel(), minlength=count)


# Stairs.


def _treads(
    position: FloatArray, flights: Sequence[tuple[int, int]], storey: IntArray, axes: FloatArray
) -> Iterator[Tread]:
    """Yield the treads of flights, along the walls.

    They stand on the storey where they begin, and their upper half is seen on that above.
    """
    foot = position[:, 2] - CAMERA_HEIGHT
    floors = floors_of(position[:, 2], storey)
    drawn: list[tuple[int, FloatArray]] = []
    for run in _straight_runs(position[:, :2] @ axes.T, foot, flights):
        line = position[run, :2] @ axes.T
        across = int(np.abs(line[-1] - line[0]).argmin())
        line[:, across] = line[:, across].mean()
        start, end = line[[0, -1]] @ axes
        climb = float(foot[run[-1]] - foot[run[0]])
        count = max(2, round(climb / _TREAD))
        step = (end - start) / count
        aside = np.array([step[1], -step[0]]) * DOOR_WIDTH / 2 / np.hypot(*step)
        new = []
        for share in (np.arange(count) + 0.5) / count:
            at, height = start + share * (end - start), float(foot[run[0]]) + share * climb
            for level in sorted(
                {int(storey[run[0]]), int(storey[run[-1] if share > _BELOW else run[0]])}
            ):
                near = (np.hypot(*(at - its)) for on, its in drawn if on == level)
                if min(near, default=np.inf) >= _APART:
                    new.append((level, at))
                    ends = np.stack([at - aside, at + aside])
                    yield Tread(level, ends, step, height - float(floors[level]))
        drawn += new


def _is_within(tread: Tread, rooms: Sequence[Room]) -> bool:
    """Whether a tread is in a room of its storey; without rooms, each is."""
    middle = tread.ends.mean(axis=0, keepdims=True)
    around = [room.contains(middle)[0] for room in rooms if room.storey == tread.storey]
    return any(around) or not around


def _straight_runs(
    camera: FloatArray, height: FloatArray, flights: Sequence[tuple[int, int]]
) -> Sequence[Sequence[int]]:
    """Join flights that lead on in the same direction; return the viewpoints of each, upwards."""
    runs: list[list[int]] = []
    last: dict[tuple[int, int, bool], list[int]] = {}
    for start, end in sorted(flights, key=lambda ends: float(height[ends[0]])):
        step = camera[end] - camera[start]
        along = int(np.abs(step).argmax())
        is_up = bool(step[along] > 0)
        run = last.pop((start, along, is_up), [])
        if not run:
            run.append(start)
            runs.append(run)
        run.append(end)
        last[end, along, is_up] = run
    return runs


def _seen_on(
    level: int, flights: Sequence[tuple[int, int]], camera: FloatArray, storey: IntArray
) -> Iterator[FloatArray]:
    """Yield the parts of flights with treads on a storey, shape (1, 2, 2)."""
    for start, end in flights:
        if storey[start] == level:
            yield camera[None, [start, end]]
        elif storey[end] == level:
            landing = camera[start] + _BELOW * (camera[end] - camera[start])
            yield np.stack([landing, camera[end]])[None]


def _flights(position: FloatArray, edges: IntArray) -> Sequence[tuple[int, int]]:
    """Return the steep edges that are the way up, from below, the shortest first.

    Those that lead higher along further ones, or from lower, have to climb the height of a flight
    in all: cameras on one floor stand at several heights too.
    """
    height = position[:, 2]
    is_up = height[edges[:, 1]] >= height[edges[:, 0]]
    ways = np.where(is_up[:, None], edges, edges[:, ::-1])
    along = position[ways[:, 1]] - position[ways[:, 0]]
    climb, run = along[:, 2], np.hypot(along[:, 0], along[:, 1])
    is_steep = (climb > _CLIMB) & (climb >= _SLOPES[0] * run) & (climb <= _SLOPES[1] * run)
    ways, run = ways[is_steep], run[is_steep]
    top, bottom = height.copy(), height.copy()
    for start, end in ways[np.argsort(-height[ways[:, 0]], kind="stable")].tolist():
        top[start] = max(top[start], top[end])
    for start, end in ways[np.argsort(height[ways[:, 1]], kind="stable")].tolist():
        bottom[end] = min(bottom[end], bottom[start])
    parent = list(range(len(position)))

    def root(row: int) -> int:
        while parent[row] != row:
            row = parent[row]
        return row

    flights = []
    for start, end in ways[np.argsort(run, kind="stable")].tolist():
        first, last = root(start), root(end)
        # Only a way that the shorter edges do not give yet.
        if first != last and top[end] - bottom[start] >= _FLIGHT:
            parent[last] = first
            flights.append((start, end))
    return flights
