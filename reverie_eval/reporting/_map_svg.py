"""Maps as SVG: still ones for reports and notebooks, interactive ones for pages with a script.

Both consist of the same pieces. A still map joins them and is small. An interactive map keeps them
apart and says where each belongs: ``data-levels`` are its storeys, ``data-leg`` is the move of the
route, ``data-viewpoint`` the viewpoint. Without a script it shows what the still map shows.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from itertools import chain, groupby
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from reverie_eval.analysis import Episode, Gallery
from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.reporting._answer_svg import answer_picture
from reverie_eval.reporting._answer_views import answer_views
from reverie_eval.reporting._map_frame import (
    HEIGHT,
    STAIRS,
    WIDTH,
    Frame,
    arrows,
    level_labels,
    sector,
)
from reverie_eval.reporting._maps import EpisodeMap, Route, Sign
from reverie_eval.reporting.resources import text_of

MAP_STYLE = text_of("shared/map.css")
"""The style sheet for pages with maps and their keys; :func:`map_picture` includes it."""
MOST_POSES = 1000
"""Poses of a route that are drawn, at most; ten times as many as agents in the literature walk."""
_SIGHT = 0.75
"""Viewpoints farther from the middle than this, in widths and heights, are not drawn."""
_STAR = np.array(
    [
        (radius * np.sin(turn), -radius * np.cos(turn))
        for turn, radius in zip(np.arange(10) * np.pi / 5, [7.5, 3.2] * 5, strict=True)
    ]
)
_LABEL_WIDTH, _ASIDE = 50.0, 10.0
_RADIUS = {"start": 5.5, "goal": 7.0}
_SIGN_LINES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "sight": ("sight", "M8 8L34 0V16z"),
        "jump": ("route jump", "M4 8H36"),
        "annotated": ("annotated", "M6 8H34"),
        "off-level": ("route off-level", "M4 8H36"),
        "elsewhere": ("viewpoint elsewhere", "M12 8h0M28 8h0"),
    }
)
"""Class and path data in a key, by kind of sign."""
_NO_LINES: Mapping[str, str] = MappingProxyType({})


def map_svg(episode_map: EpisodeMap) -> str:
    """Draw a still map for a page that includes ``MAP_STYLE``."""
    return _Drawing(episode_map).still()


def map_picture(episode_map: EpisodeMap) -> str:
    """Draw a still map that includes its style sheet, for a file or any page."""
    own = ' xmlns="http://www.w3.org/2000/svg"', f"<style>{MAP_STYLE}</style>"
    return _Drawing(episode_map).still(*own)


def interactive_map_svg(episode_map: EpisodeMap) -> str:
    """Draw an interactive map for a page that includes ``MAP_STYLE``."""
    return _Drawing(episode_map).interactive()


def map_key(*maps: EpisodeMap) -> str:
    """Explain the signs on maps of the same submissions in HTML."""
    signs = dict.fromkeys(sign for each in maps for sign in each.signs)
    entries = "".join(
        f'<span><svg class="episode-map sign" viewBox="0 0 40 16" aria-hidden="true">'
        f"{_sign(sign)}</svg> {escape(sign.meaning)}</span>"
        for sign in signs
    )
    return f'<p class="map-key">{entries}</p>'


def episode_html(episode: Episode) -> str:
    """Show an episode in a notebook: its map with instruction, outcome and key, and its answer."""
    instruction = f"<q>{escape(episode.instruction)}</q>" if episode.instruction else ""
    episode_map = EpisodeMap.of({"": episode})
    caption = "; ".join(filter(None, [episode.caption, *episode_map.level_notes]))
    answers = "".join(
        f'<figure style="margin: 1rem 0">{answer_picture(shown)}'
        f"<figcaption>{escape(shown.caption)}</figcaption></figure>"
        for _, shown in answer_views({"": episode})
    )
    return (
        '<figure style="margin: 0; max-width: 36rem">'
        f"{map_picture(episode_map)}<figcaption>"
        f"<code>{escape(episode.instr_id)}</code> {instruction}<br>"
        f"{escape(caption)}</figcaption>{map_key(episode_map)}{answers}</figure>"
    )


def gallery_html(gallery: Gallery) -> str:
    """Show near misses in a notebook, side by side for each outcome."""
    return "".join(
        f"<h4>{escape(outcome.capitalize())}</h4>"
        '<div style="display: grid; gap: 1.5rem; '
        'grid-template-columns: repeat(auto-fill, minmax(18rem, 1fr))">'
        f"{''.join(map(episode_html, episodes))}</div>"
        for outcome, episodes in gallery.items()
    )


class _Piece(NamedTuple):
    """Something on a map."""

    viewpoints: Sequence[int]
    """The viewpoint where it is, or the two that it connects."""
    lines: Mapping[str, str] = _NO_LINES
    """The data of paths, by class; a still map joins those of the same class."""
    title: str = ""
    """Tooltip of the lines, on an interactive map."""
    sign: str = ""
    """Elements that are never joined."""
    attributes: str = ""
    """Attributes for the script of an interactive map."""


class _Drawing:
    def __init__(self, episode_map: EpisodeMap) -> None:
        self._map = episode_map
        self._frame = Frame.around(episode_map)
        self._place = self._frame.place(episode_map.position)
        self._is_elsewhere = episode_map.is_elsewhere
        size = np.array([WIDTH, HEIGHT])
        far = np.abs(self._place - size / 2) / size
        self._in_sight: BoolArray = (far < _SIGHT).all(axis=1)

    def still(self, attributes: str = "", style: str = "") -> str:
        shapes = (shape for layer in self._layers() for shape in self._joined(layer))
        return self._svg("episode-map", shapes, attributes, style)

    def interactive(self) -> str:
        edges, annotated, *others = (map(self._apart, layer) for layer in self._layers())
        shapes = [
            *edges,
            '<g class="annotation" opacity="0.3">',  # as a group: not darker where pieces meet
            *annotated,
            "</g>",
            *chain.from_iterable(others),
        ]
        return self._svg("episode-map walkable", shapes)

    def _layers(self) -> Sequence[Iterator[_Piece]]:
        """Draw the layers of the map, the lowest first."""
        return [
            self._edges(),
            self._annotated_path(),
            self._viewpoints(),
            self._goals(),
            self._sights(),
            *map(self._legs, self._map.routes),
            self._ends(),
            self._level_marks(),
        ]

    def _svg(self, kind: str, shapes: Iterable[str], attributes: str = "", style: str = "") -> str:
        metres = self._frame.bar_metres
        bar = f"M10 {HEIGHT - 14}v4h{metres * self._frame.scale:.1f}v-4"
        return "".join(
            [
                f'<svg class="{kind}" role="img" viewBox="0 0 {WIDTH} {HEIGHT}"{attributes}>',
                f"<title>{escape(f'Map of episode {self._map.instr_id}')}</title>",
                f"<desc>{escape(self._map.description)}</desc>{style}",
                f'<rect class="ground" width="{WIDTH}" height="{HEIGHT}"/>',
                *shapes,
                f'<path class="scale" d="{bar}"/>',
                f'<text class="scale" x="14" y="{HEIGHT - 16}">{metres} m</text></svg>',
            ]
        )

    def _joined(self, layer: Iterable[_Piece]) -> Iterator[str]:
        """Draw pieces as few elements, those of other storeys first and faintly."""
        paths: dict[str, str] = {}
        signs = []
        for piece in layer:
            faint = " elsewhere" if self._is_elsewhere[piece.viewpoints].any() else ""
            for kind, data in piece.lines.items():
                before = paths.get(kind + faint, "")
                start, _, rest = data.partition("L")
                goes_on = rest and before.endswith(f"L{start[1:]}")
                paths[kind + faint] = f"{before}L{rest}" if goes_on else before + data
            signs.append(piece.sign)
        for kind in sorted(paths, key=lambda kind: "elsewhere" not in kind):
            yield _path(kind, paths[kind])
        yield from signs

    def _apart(self, piece: _Piece) -> str:
        """Draw a piece as a group that says which storeys it is on."""
        levels = " ".join(map(str, self._map.levels(piece.viewpoints)))
        is_faint = self._is_elsewhere[piece.viewpoints].any()
        faint = ' data-elsewhere="" opacity="0.35"' if is_faint else ""
        lines = "".join(_path(kind, data, piece.title) for kind, data in piece.lines.items())
        group = f'<g data-levels="{levels}"{piece.attributes}{faint}>'
        return f"{group}{lines}{piece.sign}</g>"

    def _edges(self) -> Iterator[_Piece]:
        """Draw the edges between the same storeys as one piece."""
        edges = self._map.edges[self._in_sight[self._map.edges].any(axis=1)]
        storeys = np.sort(self._map.storey[edges], axis=1)
        for pair in np.unique(storeys, axis=0):
            same = edges[(storeys == pair).all(axis=1)]
            yield _Piece(same[0].tolist(), {"edge": "".join(map(_line, self._place[same]))})

    def _annotated_path(self) -> Iterator[_Piece]:
        """Draw the annotated path, a piece for each stretch on one storey."""
        for _, same in groupby(self._map.annotated_legs.tolist(), key=self._map.levels):
            first, *others = same
            rows = first + [end for _, end in others]
            off_level = " off-level" if self._map.is_off_level(np.array([first]))[0] else ""
            yield _Piece(first, {f"annotated{off_level}": _line(self._place[rows])})

    def _viewpoints(self) -> Iterator[_Piece]:
        for row in np.flatnonzero(self._in_sight).tolist():
            dot = f"M{_point(self._place[row])}h0"
            yield self._at(row, lines={"viewpoint": dot}, title=self._map.viewpoint_ids[row])

    def _goals(self) -> Iterator[_Piece]:
        for row in self._map.goal_viewpoints.tolist():
            title = self._title("goal viewpoint", row)
            yield self._at(row, _circle("goal", self._place[row], title))

    def _legs(self, route: Route) -> Iterator[_Piece]:
        """Draw a route; a walked leg is drawn from the end of the walked leg before it."""
        shown = route
        if len(route.viewpoint) > MOST_POSES:
            cut = np.append(route.viewpoint[: MOST_POSES - 1], route.stop)
            shown = replace(route, viewpoint=cut)
        lanes, is_jump = self._frame.lanes(self._map, shown), self._map.is_jump(shown).tolist()
        off_level = self._map.is_off_level(shown.legs).tolist()
        number = route.number
        for leg, (ends, arrow) in enumerate(zip(lanes, arrows(lanes), strict=True)):
            goes_on = leg > 0 and not is_jump[leg - 1] and not is_jump[leg]
            way_of = " jump" if is_jump[leg] else " off-level" if off_level[leg] else ""
            way = np.vstack([lanes[leg - 1][1:], ends]) if goes_on else ends
            lines = {f"route{way_of} route-{number}": _line(way)}
            if arrow is not None:
                lines[f"arrow route-{number}"] = f"{_line(arrow)}z"
            place = f' class="leg" data-route="{number}" data-leg="{leg + 1}"'
            yield _Piece(shown.legs[leg].tolist(), lines, attributes=place)

    def _sights(self) -> Iterator[_Piece]:
        """Draw the views of the answers as sectors around the stops."""
        for route in self._map.routes:
            if route.sight is not None:
                shape = self._stop_place(route) + sector(route.sight)
                sign = _path(f"sight route-{route.number}", f"{_line(shape)}z")
                yield _Piece([route.stop], sign=sign)

    def _level_marks(self) -> Iterator[_Piece]:
        """Mark stairs, and say on which levels the episode's ends are if it has several."""
        for label, rows in level_labels(self._map):
            place = self._place[rows].mean(axis=0)
            is_stairs = len(rows) > 1
            yield _Piece(rows, sign=_stairs(place, label) if is_stairs else _label(place, label))

    def _stop_place(self, route: Route) -> FloatArray:
        """Return where a stop is drawn: beside that of another agent at the same viewpoint."""
        aside = np.array([6.0 * (route.number - 1), 0.0])
        return np.asarray(self._place[route.stop] + aside)

    def _ends(self) -> Iterator[_Piece]:
        """Draw the start, the end of the annotated path, and where agents stopped."""
        start, end, place = self._map.start, self._map.path_end, self._place
        yield self._at(start, _circle("start", place[start], self._title("start", start)))
        yield self._at(end, _star(place[end], self._title("end of the annotated path", end)))
        for route in self._map.routes:
            whose = f" of {route.name}" if route.name else ""
            title = self._title(f"stop{whose}", route.stop)
            yield self._at(route.stop, _square(self._stop_place(route), route.number, title))

    def _at(
        self, row: int, sign: str = "", lines: Mapping[str, str] = _NO_LINES, title: str = ""
    ) -> _Piece:
        name = f' data-viewpoint="{escape(self._map.viewpoint_ids[row])}"'
        return _Piece([row], lines, title, sign, name)

    def _title(self, meaning: str, row: int) -> str:
        return f"{meaning}: {self._map.viewpoint_ids[row]}"


def _sign(sign: Sign) -> str:
    middle = np.array([20.0, 8.0])
    match sign.kind:
        case "stop":
            line = _path(f"route route-{sign.route}", "M2 8H30")
            return line + _square(np.array([33.0, 8.0]), sign.route)
        case "start" | "goal":
            return _circle(sign.kind, middle)
        case "end":
            return _star(middle)
        case "stairs":
            return _stairs(middle)
        case _:
            return _path(*_SIGN_LINES[sign.kind])


def _path(kind: str, data: str, title: str = "") -> str:
    return _element("path", f'class="{kind}" d="{data}"', title)


def _circle(kind: str, place: FloatArray, title: str = "") -> str:
    x, y = place
    return _element(
        "circle", f'class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{_RADIUS[kind]:g}"', title
    )


def _star(place: FloatArray, title: str = "") -> str:
    return _path("end", f"{_line(_STAR + place)}z", title)


def _stairs(place: FloatArray, label: str = "") -> str:
    """Draw the sign for stairs, with a label above it."""
    x, y = place
    text = f'<text class="level" x="{x:.1f}" y="{y - 8:.1f}" text-anchor="middle">{label}</text>'
    return _path("stairs", _line(place + np.array(STAIRS) * (1, -1))) + (text if label else "")


def _label(place: FloatArray, text: str) -> str:
    """Write a label to the right of a sign, or to its left near the map's right edge."""
    x, y = place
    is_right = x > WIDTH - _LABEL_WIDTH
    x, anchor = (x - _ASIDE, ' text-anchor="end"') if is_right else (x + _ASIDE, "")
    return f'<text class="level" x="{x:.1f}" y="{y + 4:.1f}"{anchor}>{text}</text>'


def _square(place: FloatArray, number: int, title: str = "") -> str:
    x, y = place - 4.5
    size = 'width="9" height="9"'
    return _element("rect", f'class="stop route-{number}" x="{x:.1f}" y="{y:.1f}" {size}', title)


def _element(name: str, attributes: str, title: str) -> str:
    """Write an element, with a tooltip if it has a title."""
    if not title:
        return f"<{name} {attributes}/>"
    return f"<{name} {attributes}><title>{escape(title)}</title></{name}>"


def _line(points: FloatArray) -> str:
    """Return the data of a path through points of shape (n_points, 2)."""
    return "M" + "L".join(map(_point, points))


def _point(point: FloatArray) -> str:
    x, y = point
    return f"{x:.1f} {y:.1f}"
