"""A map for a page on which one can look closer: legs one by one, storeys apart, every id named.

What is drawn is what :mod:`map_svg` draws, in more pieces. ``data-levels`` says which storeys a
piece is on, ``data-leg`` which move of the route it is, ``data-viewpoint`` where it is; a script
picks among them. Without one it is the same map. There is no style in it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from html import escape
from itertools import chain, count, groupby

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.reporting import _map_shapes as shapes
from reverie_eval.reporting._map_frame import Frame, arrows
from reverie_eval.reporting._map_svg import HEIGHT, WIDTH
from reverie_eval.reporting._maps import EpisodeMap, Route

MOST_POSES = 1000
"""Of a route that are drawn; ten times what any agent of the literature walks."""

_SIGHT = 0.75
"""What is farther from the middle than this, in widths and heights, is left out."""


def page_map(episode_map: EpisodeMap) -> str:
    """Draw a map in pieces, for a page that has ``MAP_STYLE`` among its styles."""
    shown = replace(episode_map, routes=[_in_bounds(route) for route in episode_map.routes])
    return _Drawing(shown).svg()


def _in_bounds(route: Route) -> Route:
    """Keep a route's beginning and its end, if it is beyond all measure."""
    if len(route.viewpoint) <= MOST_POSES:
        return route
    kept = np.append(route.viewpoint[: MOST_POSES - 1], route.stop)
    return replace(route, viewpoint=kept)


class _Drawing:
    def __init__(self, episode_map: EpisodeMap) -> None:
        self._map = episode_map
        self._frame = Frame.around(episode_map, WIDTH, HEIGHT)
        self._place = self._frame.place(episode_map.position)
        self._elsewhere = episode_map.is_elsewhere
        size = np.array([WIDTH, HEIGHT])
        off = np.abs(self._place - size / 2) / size
        self._in_sight: BoolArray = (off < _SIGHT).all(axis=1)

    def svg(self) -> str:
        title = escape(f"Map of episode {self._map.instr_id}")
        return "".join(
            [
                f'<svg class="episode-map walkable" role="img" viewBox="0 0 {WIDTH} {HEIGHT}">',
                f"<title>{title}</title><desc>{escape(self._map.description)}</desc>",
                f'<rect class="ground" width="{WIDTH}" height="{HEIGHT}"/>',
                *self._edges(),
                '<g class="annotation" opacity="0.3">',  # as one: where pieces meet is no darker
                *self._annotated(),
                "</g>",
                *self._viewpoints(),
                *self._success(),
                *chain.from_iterable(map(self._legs, self._map.routes, count(1))),
                *self._ends(),
                *shapes.scale(self._frame),
                "</svg>",
            ]
        )

    def _edges(self) -> Iterator[str]:
        """Draw edges together that join the same storeys."""
        edges = self._map.edges[self._in_sight[self._map.edges].any(axis=1)]
        storeys = np.sort(self._map.storey[edges], axis=1)
        for pair in np.unique(storeys, axis=0):
            same = edges[(storeys == pair).all(axis=1)]
            yield self._on(same[0], shapes.path("edge", map(shapes.line, self._place[same])))

    def _viewpoints(self) -> Iterator[str]:
        for row in np.flatnonzero(self._in_sight).tolist():
            dot = f'<path class="viewpoint" d="M{shapes.coordinates(self._place[row])}h0">'
            named = f"{dot}{shapes.title_of(self._map.viewpoint_ids[row])}</path>"
            yield self._at(row, named)

    def _annotated(self) -> Iterator[str]:
        """Draw the annotated path, in a piece for as long as it stays on a storey."""
        path = self._map.annotated_path
        legs = list(zip(path[:-1].tolist(), path[1:].tolist(), strict=True))
        for _, same in groupby(legs, key=lambda leg: self._levels(np.array(leg))):
            (first, second), *others = same
            rows = [first, second, *(end for _, end in others)]
            line = shapes.path("annotated", [shapes.line(self._place[rows])])
            yield self._on(np.array([first, second]), line)

    def _success(self) -> Iterator[str]:
        for row in self._map.success.tolist():
            title = f"a stop here is a success: {self._map.viewpoint_ids[row]}"
            yield self._at(row, shapes.circle("success", self._place[row], title))

    def _legs(self, route: Route, number: int) -> Iterator[str]:
        """Draw every move by itself; it begins where the one before has ended."""
        lane, is_jump = self._frame.lane_of(self._map, route), self._map.is_jump(route)
        for leg, (ends, rows) in enumerate(zip(lane, route.legs, strict=True)):
            follows = leg > 0 and not is_jump[leg] and not is_jump[leg - 1]
            way = np.vstack([lane[leg - 1][1:], ends]) if follows else ends
            jump = " jump" if is_jump[leg] else ""
            line = shapes.path(f"route{jump} route-{number}", [shapes.line(way)])
            yield self._on(
                rows,
                line + _arrow(ends, number, is_jump=bool(is_jump[leg])),
                f' class="leg" data-route="{number}" data-leg="{leg + 1}"',
            )

    def _ends(self) -> Iterator[str]:
        start, goal = self._map.start, self._map.goal
        named = self._map.viewpoint_ids
        yield self._at(start, shapes.circle("start", self._place[start], f"start: {named[start]}"))
        title = f"end of the annotated path: {named[goal]}"
        yield self._at(goal, shapes.goal(self._place[goal], title))
        for number, route in enumerate(self._map.routes, 1):
            whose = f" of {route.name}" if route.name else ""
            shift = np.array([6.0 * (number - 1), 0.0])
            title = f"stop{whose}: {named[route.stop]}"
            yield self._at(route.stop, shapes.stop(self._place[route.stop] + shift, number, title))

    def _at(self, row: int, drawn: str) -> str:
        name = escape(self._map.viewpoint_ids[row])
        return self._on(np.array([row]), drawn, f' data-viewpoint="{name}"')

    def _on(self, rows: IntArray, drawn: str, attributes: str = "") -> str:
        """Say which storeys something is on that lies between viewpoints."""
        faint = ""
        if self._elsewhere[rows].any():
            faint = ' data-elsewhere="" opacity="0.35"'
        levels = " ".join(map(str, self._levels(rows)))
        return f'<g data-levels="{levels}"{attributes}{faint}>{drawn}</g>'

    def _levels(self, rows: IntArray) -> Sequence[int]:
        return sorted({int(storey) + 1 for storey in self._map.storey[rows]})


def _arrow(ends: FloatArray, number: int, *, is_jump: bool) -> str:
    tips = [] if is_jump else [f"{shapes.line(tip)}z" for tip in arrows(ends[None], 9.0)]
    return shapes.path(f"arrow route-{number}", tips) if tips else ""
