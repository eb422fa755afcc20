"""The levels of a building that an episode visits, as stacked sheets in parallel projection.

The lowest is at the bottom: what is above something is drawn above it, and no level takes up more
than it needs. Each has the floors of its rooms, low walls with gaps for doors, furniture as solids,
stairs and a title. What an episode does on them is drawn by others.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.geometry import BLOCK, Solids, Tread, floor_joints, floors_of, kind_of, sides_of
from reverie_eval.reporting.drawing import element, path, path_data
from reverie_eval.reporting.map_layout import WIDTH, Mark, text_box
from reverie_eval.reporting.map_marks import draw_mark
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.reporting.walls import FLATTENED, HIGH, LOW, WallPiece, off_the_walls, walls_of

# Degrees: how the building may be turned on the page, and how far down the camera looks; how many
# times as large it has to be for another turn than the first.
_TURNS, _TILT = np.deg2rad([-24.0, 24.0, 66.0, -66.0]), np.deg2rad(50.0)
_LARGER = 1.1
# Metres: what is smaller is left out, what begins higher above the floor, and what is larger though
# its name does not tell what it is: stairs, beams, fences.
_SMALL, _HANGS, _BULKY = 0.35, 0.9, 1.2
# Kinds of such objects; the building has stairs of its own.
_UNKNOWN = (BLOCK, kind_of("stairs"))
# Square metres: parts of furniture whose largest side is smaller are left out: knobs, thin legs.
_TINY = 0.04
# Metres above the floor where what stands on it begins, at most.
_STANDS = 0.15
# Forms that reach down to the floor where nothing is beneath them.
_REACHING = ("sink", "cabinet", "shelves")
# Stairs rise this much of their height, so that a flight ends as high as the walls.
_RISE = 0.3
# Metres: the width of boards and tiles, and units of the page between joints at least.
_BOARD, _FINEST = 0.4, 5.0
# Metres: the width of the floor beneath a way that leads through no room.
_WAY = 1.2
# Decimals of a metre to which the ends of two pieces of a wall are the same.
_DECIMALS = 3
# How many heights are tried for a title.
_HEIGHTS = 9
# Points along a wall: close enough that a title on it covers one.
_ALONG = 64
# The greatest height, and the space around and between sheets, in units of the page; where titles
# begin, left of the sheets of a column.
_HIGHEST, _MARGIN, _GAP, _TITLE_LEFT = 560, 14, 12, 4.0
# Two columns are for levels that are this many times as large then, and have room for titles: so
# many more units of the page are free left of each.
_BETTER, _TITLE = 1.05, 16
_FACING = np.array([0.0, -np.cos(_TILT), np.sin(_TILT)])
"""From what is drawn to the eye: to the right, away and up."""


class _Faces(NamedTuple):
    """Faces of walls or solids."""

    far: FloatArray
    """Shape (n,): what is farther is drawn earlier."""
    kinds: Sequence[str]
    outlines: FloatArray
    """Shape (n, 4, 2): corners on the page."""


class Floors:
    """The floors of an episode, for maps and walks: a projection of its building on a page."""

    def __init__(self, episode_map: EpisodeMap, below: float = 0.0) -> None:
        """Lay out the floors of a cropped map; leave so many units of the page free below them."""
        self._map, self._building = episode_map, episode_map.building
        self._is_near = episode_map.is_near
        self.levels = sorted(set(episode_map.storey[episode_map.visited].tolist()), reverse=True)
        self._floor = floors_of(episode_map.position[:, 2], episode_map.storey)
        self._ground = {level: self._ground_of(level) for level in self.levels}
        """What each level takes up, shape (n, 2): near viewpoints, and corners of rooms."""
        self._axes, self._sheets = self._turned(below)
        self.scale = self._sheets.scale
        """Units of the page per metre."""
        self.height = self._sheets.height
        """In units of the page."""

    @cached_property
    def shapes(self) -> str:
        """The floors with their furniture and titles, as SVG on a ground."""
        ground = f'<rect class="ground" width="{WIDTH}" height="{self.height:.0f}"/>'
        levels = (shape for level in self.levels for shape in self._level(level))
        return f"{ground}{''.join(levels)}"

    def _turned(self, below: float) -> tuple[FloatArray, "Sheets"]:
        """Turn the building so that it is large: return its axes on the page, and its sheets."""
        found = []
        for turn in _TURNS:
            across = np.array([(np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))])
            axes = across @ self._building.solids.axes
            corners = {
                level: np.concatenate([_flat(ground @ axes.T, up) for up in (0.0, HIGH)])
                for level, ground in self._ground.items()
            }
            found.append((axes, Sheets.of(corners, below)))
        first, best = found[0], max(found, key=lambda each: each[1].scale)
        return best if best[1].scale >= _LARGER * first[1].scale else first

    def _ground_of(self, level: int) -> FloatArray:
        is_its = (self._map.storey == level) & self._is_near
        return np.vstack([self._map.position[is_its, :2], *self._outlines_on(level)])

    def _outlines_on(self, level: int) -> Sequence[FloatArray]:
        """Return the outlines of the rooms of a level, each of shape (n, 2)."""
        return [its for room in self._building.rooms_on(level) for its in room.outlines]

    def _level(self, level: int) -> Iterator[str]:
        ways = [self._page(each, level) for each in self._ways_outside(level)]
        if ways:
            width = f'stroke-width="{_WAY * self.scale:.1f}"'
            yield element("path", f'class="way" d="{path_data("way", ways)}" {width}')
        for room in self._building.rooms_on(level):
            of = "outdoors" if room.is_outdoors else room.name.partition(" ")[0]
            kind = f"room {of}".strip()
            yield path(kind, path_data(kind, [self._page(its, level) for its in room.outlines]))
        axes, step = self._building.solids.axes, max(_BOARD, _FINEST / self.scale)
        joints = [
            self._page(ends, level)
            for room in self._building.rooms_on(level)
            if not room.is_outdoors
            for ends in floor_joints(room.outlines, axes, room.name, step)
        ]
        if joints:
            yield path("joint", path_data("joint", joints))
        holes = [_corners(each) for each in self._building.treads_on(level) if each.height <= 0]
        if holes:
            data = _outlines_data(np.array([self._page(each, level) for each in holes]))
            yield path("tread", "".join(data))
        yield f'<g class="solids">{"".join(self._solids(level))}</g>'
        yield draw_mark(self._titles[level])

    def _solids(self, level: int) -> Iterator[str]:
        """Draw walls and furniture, the farthest first."""
        furniture = self._furniture(self._shown(level), level)
        faces = [self._walls(level), self._stairs(level), furniture]
        kinds = [kind for each in faces for kind in each.kinds]
        data = _outlines_data(np.concatenate([each.outlines for each in faces]))
        far = np.concatenate([each.far for each in faces])
        order = np.argsort(-far, kind="stable").tolist()
        for kind, rows in groupby(order, key=kinds.__getitem__):
            yield path(kind, "".join(data[row] for row in rows))

    def _ways_outside(self, level: int) -> Iterator[FloatArray]:
        """Yield the ends, shape (2, 2), of edges beside rooms; a viewpoint there, twice."""
        on_level = (self._map.storey == level) & self._is_near
        here = self._map.position[:, :2]
        is_outside = on_level.copy()
        for room in self._building.rooms_on(level):
            is_outside &= ~room.contains(here)
        edges = self._map.edges
        is_way = on_level[edges].all(axis=1) & is_outside[edges].any(axis=1)
        alone = np.repeat(np.flatnonzero(is_outside)[:, None], 2, axis=1)
        yield from here[np.vstack([edges[is_way], alone])]

    @cached_property
    def _titles(self) -> Mapping[int, Mark]:
        return {level: self._title(level) for level in self.levels}

    def _title(self, level: int) -> Mark:
        """Place a title at the left: as low as it is beside the sheet, or else at its foot."""
        down = self._page(self._ground[level], level)[:, 1]
        heights = np.linspace(down.max() - 2, down.min(), _HEIGHTS)
        left, text = self._sheets.title_left[level], f"level {level + 1}"
        marks = [Mark("right of", np.array([left, y]), text=text) for y in heights]
        outline = self._along_outlines(level)
        return next((each for each in marks if not _is_on(text_box(each), outline)), marks[0])

    def _along_outlines(self, level: int) -> FloatArray:
        """Return points, shape (n, 2), close together along the feet and the tops of walls."""
        share = np.linspace(0, 1, _ALONG)[:, None, None]
        lines = [its + share * (np.roll(its, -1, axis=0) - its) for its in self._outlines_on(level)]
        along = np.concatenate([np.zeros((0, 2)), *(each.reshape(-1, 2) for each in lines)])
        return np.concatenate([self._page(along, level, z) for z in (0.0, LOW, HIGH)])

    def _walls(self, level: int) -> _Faces:
        pieces = [*walls_of(self._building, level, self._axes, float(self._floor[level]))]
        corners = np.array([each.corners(self._axes) for each in pieces]).reshape(-1, 8, 3)
        far = corners[..., 1].mean(axis=1)
        materials = [each.material for each in pieces]
        return self._faces(corners, far, materials, level, _are_cut(pieces))

    def _stairs(self, level: int) -> _Faces:
        steps = [each for each in self._building.treads_on(level) if each.height > 0]
        corners = np.zeros((len(steps), 8, 3))
        # The corners of a box: those of its left side before those of its right, feet before tops.
        around = np.array([_corners(each) for each in steps]).reshape(-1, 4, 2)
        corners[..., :2] = (around @ self._axes.T)[:, [0, 0, 3, 3, 1, 1, 2, 2]]
        top = np.array([each.height for each in steps]) * _RISE
        corners[:, 1::2, 2] = np.minimum(top, LOW)[:, None]
        return self._faces(corners, corners[..., 1].mean(axis=1), ["stair"] * len(steps), level)

    def _shown(self, level: int) -> Solids:
        """Return the furniture of a level."""
        solids = self._building.solids
        bottom = solids.centre[:, 2] - solids.half[:, 2] - self._floor[level]
        is_shown: BoolArray = (solids.storey == level) & (bottom < _HANGS)
        is_shown &= (2 * solids.half[:, :2] >= _SMALL).all(axis=1)
        is_unknown = np.array([kind_of(name) in _UNKNOWN for name in solids.names], dtype=bool)
        is_shown &= ~is_unknown | (2 * solids.half[:, :2] <= _BULKY).any(axis=1)
        is_within = np.zeros(len(solids.names), dtype=bool)
        for room in self._building.rooms_on(level):
            is_within |= room.contains(solids.centre[:, :2])
        is_shown &= is_within
        shown = self._without_floating(solids.take(is_shown), level)
        return off_the_walls(shown, self._building, level)

    def _without_floating(self, solids: Solids, level: int) -> Solids:
        """Let some furniture that rests on nothing reach down to the floor; leave out the rest."""
        above = np.maximum(solids.centre[:, 2] - solids.half[:, 2] - self._floor[level], 0)
        flat, stands = solids.centre[:, :2] @ solids.axes.T, above <= _STANDS
        is_over = np.abs(flat[:, None] - flat[stands]) <= solids.half[stands, :2]
        floats = ~stands & ~is_over.all(axis=2).any(axis=1)
        down = np.where(floats, above, 0)[:, None] * (0, 0, 0.5)
        reaches = np.array([kind_of(name).form in _REACHING for name in solids.names], dtype=bool)
        grounded = replace(solids, centre=solids.centre - down, half=solids.half + down)
        return grounded.take(~floats | reaches)

    def _furniture(self, shown: Solids, level: int) -> _Faces:
        corners, of_solid, parts, _ = shown.parts()
        sides = np.sort(np.ptp(corners, axis=1), axis=1)
        is_drawn = sides[:, 1] * sides[:, 2] >= _TINY
        corners, of_solid = corners[is_drawn], of_solid[is_drawn]
        materials = [parts[row].material for row in np.flatnonzero(is_drawn).tolist()]
        flat = corners[..., :2] @ self._axes.T
        up = np.maximum(corners[..., 2] - self._floor[level], 0) * FLATTENED
        far = (shown.centre[:, :2] @ self._axes[1])[of_solid] - 1e-3 * up.mean(axis=1)
        corners = np.concatenate([flat, up[..., None]], axis=2)
        return self._faces(corners, far, materials, level)

    def _faces(
        self,
        corners: FloatArray,
        far: FloatArray,
        materials: Sequence[str],
        level: int,
        is_cut: BoolArray | None = None,
    ) -> _Faces:
        """Return the faces of boxes, corners of shape (n, 8, 3), that are turned to the eye.

        ``is_cut``, shape (n, 2), tells whether their first and second sides are cuts.
        """
        sides, normal = sides_of(corners)
        shade = np.where(normal[..., 2] > 1e-9, "top", np.where(normal[..., 0] > 0, "lit", "dim"))
        if is_cut is not None:
            shade[:, :2][is_cut] = "cut"
        box, side = np.nonzero(normal @ _FACING > 1e-9)
        kinds = [
            f"{materials[row]} {its}"
            for row, its in zip(box.tolist(), shade[box, side].tolist(), strict=True)
        ]
        across, away, height = np.moveaxis(sides[box, side], -1, 0)
        return _Faces(far[box], kinds, self._placed(_flattened(across, away, height), level))

    # Projection.

    @property
    def taken(self) -> Sequence[FloatArray]:
        """Boxes, shape (2, 2), of the titles of levels."""
        return [*map(text_box, self._titles.values())]

    def points(self, position: FloatArray, storey: int) -> FloatArray:
        """Return where positions are: on the floor of their storey; beside the page without it."""
        if storey not in self.levels:
            return np.full((*position.shape[:-1], 2), -WIDTH)
        return self._page(position[..., :2], storey)

    def _page(self, points: FloatArray, level: int, height: float = 0.0) -> FloatArray:
        return self._placed(_flat(points @ self._axes.T, height), level)

    def _placed(self, flat: FloatArray, level: int) -> FloatArray:
        """Put projected points where their level is on the page."""
        return np.asarray(self.scale * flat + self._sheets.origin[level])


def _are_cut(pieces: Sequence[WallPiece]) -> BoolArray:
    """Return which ends of pieces are of a wall where no other goes on, shape (n, 2)."""
    ends = np.array([each.ends for each in pieces]).reshape(-1, 2).round(_DECIMALS)
    _, point, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    is_wall = np.array([each.material == "wall" for each in pieces], dtype=bool)
    return np.asarray((count[point].reshape(-1, 2) == 1) & is_wall[:, None])


def _is_on(box: FloatArray, points: FloatArray) -> bool:
    """Whether a box, shape (2, 2), has a point, of shape (n, 2), in it.

    A box that begins left of a sheet is on it only if it is on its outline.
    """
    low, high = box
    return bool(((low < points) & (points < high)).all(axis=1).any())


def _flat(points: FloatArray, height: float) -> FloatArray:
    """Project points to the right and away, shape (..., 2), at a height, all in metres."""
    return _flattened(points[..., 0], points[..., 1], height)


def _flattened(across: FloatArray, away: FloatArray, up: FloatArray | float) -> FloatArray:
    """Project what is to the right, away and up, metres: to the right and down."""
    return np.stack([across, -away * np.sin(_TILT) - up * np.cos(_TILT)], axis=-1)


def _outlines_data(outlines: FloatArray) -> Sequence[str]:
    """Return the data of each outline, shape (n, n_corners, 2), by its sides: many are the same."""
    # Differences of what was rounded add up to what was rounded.
    corners = np.diff(outlines.round(1), axis=1, prepend=0)
    data = "M%.1f %.1fl" + " ".join(["%.1f"] * (2 * outlines.shape[1] - 2)) + "z"
    return [data % tuple(each) for each in corners.reshape(len(corners), data.count("%")).tolist()]


def _corners(tread: Tread) -> FloatArray:
    """Return the corners, shape (4, 2), of a tread seen from above."""
    back = tread.step / 2
    return np.concatenate([tread.ends - back, tread.ends[::-1] + back])


# Where the sheets are on the page.


class Sheets(NamedTuple):
    """Where the sheets of levels are."""

    scale: float
    """Units of the page per metre."""
    height: float
    """The height of the page, in its units."""
    origin: Mapping[int, FloatArray]
    """Shape (2,): where the origin of a level's projection is."""
    title_left: Mapping[int, float]
    """Where the title of a level begins."""

    @classmethod
    def of(cls, corners: Mapping[int, FloatArray], below: float) -> Self:
        """Stack levels, in two columns if they are clearly larger then.

        Parameters
        ----------
        corners : mapping of int to float array of shape (n, 2)
            What each level takes up, the highest first: projected to the right and down, metres.
        below : float
            Units of the page that stay free below the sheets.
        """
        columns = _largest(corners, below)
        scale, stacks = columns.scale, columns.stacks
        high = {level: scale * float(np.ptp(each[:, 1])) for level, each in corners.items()}
        tall = [sum(high[level] + _GAP for level in each) - _GAP for each in stacks]
        height = below + 2 * _MARGIN + max(tall)
        wide = [scale * (last - first) for first, last in columns.across]
        free, beside = (WIDTH - sum(wide)) / len(wide), _beside(stacks)
        origin, title_left, left = {}, {}, 0.0
        for stack, its_tall, its_wide, (first, _) in zip(
            stacks, tall, wide, columns.across, strict=True
        ):
            # The lowest level is at the foot of the page, and the highest at its top.
            is_last = stack is stacks[-1]
            foot = height - below - _MARGIN - (max(tall) - its_tall if is_last else 0)
            for level in reversed(stack):
                down = foot - scale * float(corners[level][:, 1].max())
                origin[level] = np.array([left + (free + beside) / 2 - scale * first, down])
                title_left[level] = left + _TITLE_LEFT
                foot -= high[level] + _GAP
            left += its_wide + free
        return cls(scale, height, origin, title_left)


class _Columns(NamedTuple):
    """Levels in columns, and how large they are."""

    stacks: Sequence[Sequence[int]]
    """The levels of each column, the highest first."""
    scale: float
    across: Sequence[tuple[float, float]]
    """From where to where the levels of each column reach, metres."""

    @classmethod
    def of(
        cls, stacks: Sequence[Sequence[int]], corners: Mapping[int, FloatArray], below: float
    ) -> Self:
        """Make levels as large as the page allows."""
        across = [_reach([corners[level][:, 0] for level in each]) for each in stacks]
        free = WIDTH - sum(2 * _MARGIN + _beside(stacks) for _ in stacks)
        scales = [free / sum(last - first for first, last in across)]
        for stack in stacks:
            high = sum(float(np.ptp(corners[level][:, 1])) for level in stack)
            scales.append((_HIGHEST - 2 * _MARGIN - below - _GAP * (len(stack) - 1)) / high)
        return cls(stacks, min(scales), across)


def _largest(corners: Mapping[int, FloatArray], below: float) -> _Columns:
    """Return the columns in which levels are largest; one, if two are hardly better."""
    levels = list(corners)
    one = _Columns.of([levels], corners, below)
    # The lowest levels are in the first column.
    splits = [(levels[count:], levels[:count]) for count in range(1, len(levels))]
    two = [_Columns.of(each, corners, below) for each in splits]
    best = max(two, key=lambda each: each.scale, default=one)
    return best if best.scale >= _BETTER * one.scale else one


def _beside(stacks: Sequence[Sequence[int]]) -> float:
    """Return the units of the page that are kept for titles left of each column."""
    return _TITLE if len(stacks) > 1 else 0.0


def _reach(values: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the least and the greatest of values."""
    together = np.concatenate(values)
    return float(together.min()), float(together.max())
