"""What is on a map and where: layers of lines and marks, for whatever draws them.

Points are in units of the page, to the right and down. The class of a line says how it looks, in
the words of the style sheet: ``route climb route-1``.
"""

import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.geometry import FOCAL_LENGTH, Building, Room
from reverie_eval.geometry import WIDTH as VIEW_WIDTH
from reverie_eval.reporting.charts import round_numbers
from reverie_eval.reporting.drawing import CLOSED, Lines
from reverie_eval.reporting.maps import EpisodeMap, Route

WIDTH, HEIGHT = 400, 300
"""Size of a map, in units of the page."""
MOST_POSES = 1000
"""Poses of a route that are drawn, at most; ten times as many as agents in the literature walk."""
# Smallest margin around the viewpoints of the episode, in metres.
_MARGIN = 2.5
# Smallest width of a map, in metres.
_LEAST_METRES = 10.0
# Viewpoints farther from the middle than this, in widths and heights, are not drawn.
_SIGHT = 0.75
# Units of the page between two routes; the first is half of it to the right of the edges, so that
# the way there and the way back are two lines.
_LANE = 3.4
# Units of the page between the stops of two agents at the same viewpoint.
_ASIDE = 6.0
# Units of the page between a viewpoint and its label, and from its height to other lines.
_Side = Literal["left of", "right of"]
_BESIDE: Mapping[_Side, float] = MappingProxyType({"left of": -10.0, "right of": 10.0})
_LABEL_LINES = (0, 13, -13, 26, -26)
# Units between a name and the sides of the page, at least: some fonts are wider.
_SIDE = 4.0
# Size of a letter of a label, and the part of it that is above the baseline.
_LETTER, _ASCENT = np.array([6.8, 13.0]), 10.5
# How large the letters of rooms' names are beside others.
_NAME = 11 / 13
# Half of the size of the largest mark.
_MARK = 8.0
# Points of the upper and the lower edge of a name that tell whether it is within the walls.
_BORDER = np.array([(across, down) for across in np.linspace(0, 1, 5) for down in (0, 1)])
_ARROW_SIZE = 9.0
# Position along a leg: beyond its middle, so that arrows of both directions are side by side.
_ARROW_SHARE = 0.62
# Greatest length of the scale's bar, as a fraction of the width.
_BAR_SHARE = 0.25
# Horizontal field of view of a view, radians.
_VIEW_ANGLE = 2 * np.arctan(VIEW_WIDTH / 2 / FOCAL_LENGTH)
_SIGHT_RADIUS, _SIGHT_POINTS = 30.0, 9
_NO_LINES: Mapping[str, Sequence[FloatArray]] = MappingProxyType({})


class Mark(NamedTuple):
    """A sign at a point."""

    kind: Literal["start", "goal", "end", "stop", "left of", "right of", "name"]
    """The last three are texts: beside a viewpoint, where they end or begin at the point, and in
    the middle of a room."""
    point: FloatArray
    route: int = 0
    """The number of the submission whose stop this is, from 1; 0 for other marks."""
    text: str = ""


class Piece(NamedTuple):
    """Something on a map."""

    viewpoints: Sequence[int]
    """The viewpoint where it is, or the two that it connects."""
    lines: Lines = _NO_LINES
    mark: Mark | None = None
    title: str = ""
    """The tooltip of the piece."""
    viewpoint_id: str = ""
    """The viewpoint that it marks, if it marks one."""
    leg: tuple[int, int] | None = None
    """The numbers of the route and of the move in it, from 1; None if the piece is not a move."""
    storey: int | None = None
    """The storey of whose plan it is a part; None for what belongs to viewpoints."""


class Projection(typing.Protocol):
    """Where things of a building are on a page."""

    @property
    def scale(self) -> float:
        """Units of the page per metre, from left to right."""

    @property
    def height(self) -> float:
        """Height of the page, in its units."""

    @property
    def taken(self) -> Sequence[FloatArray]:
        """Boxes, shape (2, 2), of what is on the page whatever is drawn on it."""

    def points(self, position: FloatArray, storey: int) -> FloatArray:
        """Return where positions of a storey, metres with x and y first, are: shape (..., 2)."""


class Layout:
    """A map on its page."""

    def __init__(self, episode_map: EpisodeMap, frame: Projection) -> None:
        """Lay out a map, seen from above, or on floors that are drawn already."""
        self._map, self.frame = episode_map, frame
        self._is_flat = isinstance(frame, Frame)
        self.point = np.empty((len(episode_map.position), 2))
        """Where the viewpoints of the map are on the page, shape (n_viewpoints, 2)."""
        for storey in np.unique(episode_map.storey).tolist():
            on = episode_map.storey == storey
            self.point[on] = self.frame.points(episode_map.position[on], storey)
        self._is_elsewhere = episode_map.is_elsewhere
        size = np.array([WIDTH, frame.height])
        far = np.abs(self.point - size / 2) / size
        self._in_sight: BoolArray = (
            (far < _SIGHT).all(axis=1) if self._is_flat else episode_map.is_near
        )

    def layers(self) -> Sequence[Iterator[Piece]]:
        """Return the pieces of each layer, the lowest first."""
        return [
            self._edges(),
            self._annotated_path(),
            self._viewpoints(),
            self._goals(),
            self._sights(),
            *map(self._legs, self._map.routes),
            self.ends(),
            self._labels(),
        ]

    def plan(self, storey: int) -> Iterator[Piece]:
        """Yield the plan of a storey as far as it is on the page; none on floors, which have it."""
        if self._is_flat:
            yield from plan_of(self._map.building, storey, self.frame)

    def room_names(
        self, storey: int, occupied: Iterable[FloatArray] | None = None
    ) -> Iterator[Piece]:
        """Yield the names of rooms, each where no other and none of these boxes is.

        Boxes have the shape (2, 2); without any, they are those of what the layers have.
        """
        taken = [*(self._occupied(storey) if occupied is None else occupied)]
        for room in sorted(self._map.building.rooms_on(storey), key=lambda each: -each.area):
            outlines = [self.frame.points(corners, storey) for corners in room.outlines]
            drawn = room._replace(outlines=outlines)
            has_name = room.name and not room.is_outdoors and not room.is_side_part
            mark = put_name(drawn, taken, (WIDTH, self.frame.height)) if has_name else None
            if mark:
                taken.append(text_box(mark))
                yield Piece([], mark=mark, storey=storey)

    def _occupied(self, storey: int) -> Iterator[FloatArray]:
        """Yield the boxes, shape (2, 2), of treads, marks, texts, and pieces of routes."""
        yield from self.frame.taken
        for piece in self._labels():
            if piece.mark:
                yield text_box(piece.mark)
        sights = [its for piece in self._sights() for (its,) in piece.lines.values()]
        steps = self._map.building.treads_on(storey)
        treads = [self.frame.points(each.ends, storey) for each in steps]
        for points in (*sights, *treads):
            yield np.stack([points.min(axis=0), points.max(axis=0)])
        yield from map(self._around, self._map.visited.tolist())
        legs = [self._map.annotated_legs, *(route.legs for route in self._map.routes)]
        for start, end in self.point[np.unique(np.vstack(legs), axis=0)]:
            count = int(np.hypot(*(end - start)) // 5) + 1
            for share in np.linspace(0, 1, count):
                at = start + share * (end - start)
                yield np.stack([at - 4, at + 4])

    def _around(self, row: int) -> FloatArray:
        """Return the box of a mark at a viewpoint."""
        return np.stack([self.point[row] - _MARK, self.point[row] + _MARK])

    def is_faint(self, piece: Piece) -> bool:
        """Whether a piece is on a storey without a viewpoint of the episode, or of its plan."""
        if not self._is_flat:
            return False
        if piece.storey is not None:
            return piece.storey != self._map.start_storey
        return bool(self._is_elsewhere[piece.viewpoints].any())

    def joined(self, layer: Iterable[Piece]) -> Lines:
        """Join the lines of the same class, those of other storeys apart and first."""
        found: dict[str, list[FloatArray]] = {}
        for piece in layer:
            faint = " elsewhere" if self.is_faint(piece) else ""
            for kind, (first, *others) in piece.lines.items():
                lines = found.setdefault(kind + faint, [])
                if lines and len(first) > 1 and _goes_on(kind, lines[-1], first):
                    lines[-1] = np.vstack([lines[-1], first[1:]])
                else:
                    lines.append(first)
                lines += others
        return {kind: found[kind] for kind in sorted(found, key=lambda it: "elsewhere" not in it)}

    def _edges(self) -> Iterator[Piece]:
        """Draw the edges between the same storeys as one piece, where no walls say where to go."""
        if self._map.building.rooms_on(self._map.start_storey):
            return
        edges = self._map.edges[self._in_sight[self._map.edges].any(axis=1)]
        storeys = np.sort(self._map.storey[edges], axis=1)
        for pair in np.unique(storeys, axis=0):
            if not self._is_flat and pair[0] != pair[1]:
                continue
            same = edges[(storeys == pair).all(axis=1)]
            yield Piece(same[0].tolist(), {"edge": list(self.point[same])})

    def _annotated_path(self) -> Iterator[Piece]:
        """Draw the annotated path, a piece for each stretch on one storey."""
        for _, same in groupby(self._map.annotated_legs.tolist(), key=self._map.levels):
            first, *others = same
            rows = first + [end for _, end in others]
            climb = " climb" if self._map.is_climb(np.array([first]))[0] else ""
            yield Piece(first, {f"annotated{climb}": [self.point[rows]]})

    def _viewpoints(self) -> Iterator[Piece]:
        for row in np.flatnonzero(self._in_sight).tolist():
            name = self._map.viewpoint_ids[row]
            lines = {"viewpoint": [self.point[[row]]]}
            yield Piece([row], lines, title=name, viewpoint_id=name)

    def _goals(self) -> Iterator[Piece]:
        for row in self._map.goal_viewpoints.tolist():
            yield self._at(row, Mark("goal", self.point[row]), "goal viewpoint")

    def _sights(self) -> Iterator[Piece]:
        """Draw the views of the answers as sectors around the stops."""
        for route in self._map.routes:
            if route.sight is not None:
                metres = sector(route.sight) * (1, -1) / self.frame.scale
                here = self._map.position[route.stop, :2] + metres
                outline = self.frame.points(here, int(self._map.storey[route.stop]))
                outline = outline + self._stop_point(route) - self.point[route.stop]
                yield Piece([route.stop], {f"sight route-{route.number}": [outline]})

    def _legs(self, route: Route) -> Iterator[Piece]:
        """Draw a route; a walked leg is drawn from the end of the walked leg before it."""
        shown = route
        if len(route.viewpoint) > MOST_POSES:
            cut = np.append(route.viewpoint[: MOST_POSES - 1], route.stop)
            shown = replace(route, viewpoint=cut)
        number = route.number
        sides, is_jump = lanes(self.point[shown.legs], number), self._map.is_jump(shown).tolist()
        is_climb = self._map.is_climb(shown.legs).tolist()
        for leg, (ends, arrow) in enumerate(zip(sides, arrows(sides), strict=True)):
            # Lanes of legs in different directions do not meet: the line also goes from one to the
            # next.
            goes_on = leg > 0 and not is_jump[leg - 1] and not is_jump[leg]
            way_of = " jump" if is_jump[leg] else " climb" if is_climb[leg] else ""
            way = np.vstack([sides[leg - 1][1:], ends]) if goes_on else ends
            lines = {f"route{way_of} route-{number}": [way]}
            if arrow is not None:
                lines[f"arrow route-{number}"] = [arrow]
            yield Piece(shown.legs[leg].tolist(), lines, leg=(number, leg + 1))

    def ends(self) -> Iterator[Piece]:
        """Mark the start, the end of the annotated path, and where agents stopped."""
        start, end = self._map.start, self._map.path_end
        yield self._at(start, Mark("start", self.point[start]), "start")
        yield self._at(end, Mark("end", self.point[end]), "end of the annotated path")
        for route in self._map.routes:
            whose = f" of {route.name}" if route.name else ""
            mark = Mark("stop", self._stop_point(route), route.number)
            yield self._at(route.stop, mark, f"stop{whose}")

    def _labels(self) -> Iterator[Piece]:
        """Yield the numbers of logged steps."""
        if len(self._map.routes) != 1:  # those of two agents would cover each other
            return
        taken = [self._around(row) for row in self._map.goal_viewpoints.tolist()]
        for row, steps in self._map.routes[0].steps.items():
            mark = self._label(row, ", ".join(map(str, steps)), taken)
            taken.append(text_box(mark))
            yield Piece([row], mark=mark)

    def _label(self, row: int, text: str, taken: Sequence[FloatArray]) -> Mark:
        """Put a label beside a viewpoint: away from the routes, and where no other text is."""
        legs = np.vstack([self._map.annotated_legs, *(route.legs for route in self._map.routes)])
        ends = legs[(legs == row).any(axis=1)]
        routes_lead_right = (self.point[ends, 0] - self.point[row, 0]).sum() > 0
        sides = sorted(_BESIDE, key=lambda side: (side == "left of") != routes_lead_right)
        marks = [
            Mark(side, self.point[row] + (_BESIDE[side], 4 + down), text=text)
            for down in _LABEL_LINES
            for side in sides
        ]
        is_free = [_is_free(mark, taken) for mark in marks]
        return marks[is_free.index(True) if any(is_free) else 0]

    def _stop_point(self, route: Route) -> FloatArray:
        """Return where a stop is drawn: beside that of another agent at the same viewpoint."""
        return np.asarray(self.point[route.stop] + np.array([_ASIDE * (route.number - 1), 0.0]))

    def _at(self, row: int, mark: Mark, meaning: str) -> Piece:
        name = self._map.viewpoint_ids[row]
        return Piece([row], mark=mark, title=f"{meaning}: {name}", viewpoint_id=name)


@dataclass(frozen=True, slots=True)
class Frame:
    """The part of a scan that is shown."""

    left: float
    """Metres."""
    top: float
    """Metres."""
    scale: float
    """Units of the page per metre."""

    @classmethod
    def around(cls, position: FloatArray) -> Self:
        """Show all of some viewpoints, shape (n, 3), as large as possible."""
        low = position[:, :2].min(axis=0) - _MARGIN
        high = position[:, :2].max(axis=0) + _MARGIN
        across, down = high - low
        metres = max(across, down * WIDTH / HEIGHT, _LEAST_METRES)
        x, y = (low + high) / 2
        scale = WIDTH / metres
        return cls(float(x - metres / 2), float(y + HEIGHT / scale / 2), scale)

    @property
    def height(self) -> float:
        """Height of a map, in units of the page."""
        return HEIGHT

    @property
    def taken(self) -> Sequence[FloatArray]:
        """The box of the scale."""
        bar = self.bar_metres * self.scale
        return [np.array([[0.0, HEIGHT - 30.0], [14.0 + bar, float(HEIGHT)]])]

    def points(self, position: FloatArray, storey: int = 0) -> FloatArray:  # noqa: ARG002
        """Return where positions are on the page, whatever their storey."""
        x, y = position[..., 0] - self.left, self.top - position[..., 1]
        return self.scale * np.stack([x, y], axis=-1)

    @property
    def bar_metres(self) -> int:
        """The length of the scale's bar, a round number of metres."""
        most = _BAR_SHARE * WIDTH / self.scale
        length = 1
        for metres in round_numbers():
            if metres > most:
                break
            length = metres
        return length


def lanes(ends: FloatArray, number: int) -> FloatArray:
    """Move the legs of a route, shape (n_legs, 2, 2), aside for those of other routes."""
    along = ends[:, 1] - ends[:, 0]
    # Between viewpoints one above the other, a leg has no length on the page.
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
    # A quarter turn clockwise, as y grows downwards.
    to_the_right = np.stack([-along[:, 1], along[:, 0]], axis=-1) / length
    return np.asarray(ends + _LANE * (number - 0.5) * to_the_right[:, None])


def plan_of(building: Building, storey: int, frame: Projection) -> Iterator[Piece]:
    """Yield the plan of a storey as far as it is on the page: rooms, doors, stairs."""
    size = np.array([WIDTH, HEIGHT])
    for room in building.rooms_on(storey):
        outlines = [frame.points(corners, storey) for corners in room.outlines]
        corners = np.vstack(outlines)
        if ((corners.max(axis=0) > 0) & (corners.min(axis=0) < size)).all():
            kind = room.name.partition(" ")[0]
            yield Piece([], {f"room {kind}".strip(): outlines}, storey=storey)
    for kind, lines in (("door", building.doors_on(storey)), ("tread", building.treads_on(storey))):
        ends = [frame.points(line.ends, storey) for line in lines]
        near = [its for its in ends if ((its > 0) & (its < size)).any()]
        if near:
            yield Piece([], {kind: near}, storey=storey)


def arrows(lanes: FloatArray) -> Iterator[FloatArray | None]:
    """Yield an arrowhead for each leg, a triangle of shape (3, 2); None if it has no room."""
    for start, end in lanes:
        length = float(np.hypot(*(end - start)))
        if length <= 2 * _ARROW_SIZE:
            yield None
            continue
        ahead = _ARROW_SIZE * (end - start) / length
        aside = np.array([-ahead[1], ahead[0]])
        middle = start + _ARROW_SHARE * (end - start)
        tip, tail = middle + 0.6 * ahead, middle - 0.6 * ahead
        yield np.array([tip, tail + 0.55 * aside, tail - 0.55 * aside])


def sector(heading: float) -> FloatArray:
    """Return the outline, shape (n, 2), of a view's field of view, relative to its camera."""
    turns = heading + _VIEW_ANGLE * np.linspace(-0.5, 0.5, _SIGHT_POINTS)
    arc = _SIGHT_RADIUS * np.column_stack([np.sin(turns), -np.cos(turns)])
    return np.vstack([np.zeros(2), arc])


def put_name(room: Room, taken: Sequence[FloatArray], size: tuple[float, float]) -> Mark | None:
    """Put the name of a room near its middle; None if there is no space for it.

    Its outlines are on a page of this size; ``taken`` has the boxes, shape (2, 2), of what it must
    not cover.
    """
    corners = np.vstack(room.outlines)
    low = np.maximum(corners.min(axis=0), _SIDE)
    high = np.minimum(corners.max(axis=0), np.array(size) - _SIDE)
    steps = [np.arange(low[axis] + 4, high[axis], 4.0) for axis in (0, 1)]
    points = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    box = text_box(Mark("name", np.zeros(2), text=room.name))
    first, last = points + box[0] - 1, points + box[1] + 1
    is_free = ((first >= low) & (last <= high)).all(axis=1)
    boxes = np.array(taken).reshape(-1, 2, 2)
    is_near = ((boxes[:, 0] < high) & (low < boxes[:, 1])).all(axis=1)  # few are
    for its_low, its_high in boxes[is_near]:
        is_free &= ~((first < its_high) & (its_low < last)).all(axis=1)
    border = first[is_free, None] + _BORDER * (last - first)[is_free, None]
    is_within = room.contains(border.reshape(-1, 2)).reshape(-1, len(_BORDER))
    is_free[is_free] = is_within.all(axis=1)
    if not is_free.any():
        return None
    away = np.hypot(*((first + last) / 2 - (low + high) / 2)[is_free].T)
    return Mark("name", points[is_free][int(away.argmin())], text=room.name)


def text_box(mark: Mark) -> FloatArray:
    """Return the corners, shape (2, 2), of the text of a mark, about as large as it is."""
    size = _NAME if mark.kind == "name" else 1.0
    width, height = size * _LETTER * (len(mark.text), 1)
    share = {"left of": 1.0, "right of": 0.0}.get(mark.kind, 0.5)
    corner = np.array([mark.point[0] - share * width, mark.point[1] - size * _ASCENT])
    return np.stack([corner, corner + np.array([width, height])])


def _is_free(mark: Mark, taken: Sequence[FloatArray]) -> bool:
    """Whether the text of a mark is between the sides of the page, and on no other text."""
    low, high = text_box(mark)
    is_on = ((low < its_high).all() and (its_low < high).all() for its_low, its_high in taken)
    return bool(low[0] >= 0 and high[0] <= WIDTH) and not any(is_on)


def _goes_on(kind: str, line: FloatArray, following: FloatArray) -> bool:
    """Whether a line begins where the one before it ends; closed lines have no end."""
    return not kind.startswith(CLOSED) and np.array_equal(line[-1], following[0])
