"""Maps as SVG: still ones for reports and notebooks, interactive ones for pages with a script.

Both consist of the same pieces. A still map joins them and is small. An interactive map keeps them
apart and says where each belongs: ``data-levels`` are its storeys, ``data-leg`` is the move of the
route, ``data-viewpoint`` the viewpoint. Without a script it shows what the still map shows.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from itertools import chain
from types import MappingProxyType

import numpy as np

from reverie_eval.analysis import Episode, Gallery
from reverie_eval.arrays import FloatArray
from reverie_eval.reporting.answer_svg import answer_picture
from reverie_eval.reporting.answers import answer_views
from reverie_eval.reporting.drawing import element, line_data, path, path_data, text_at
from reverie_eval.reporting.map_layout import (
    HEIGHT,
    KEY_CLASSES,
    WIDTH,
    Frame,
    Layout,
    Mark,
    Piece,
)
from reverie_eval.reporting.maps import EpisodeMap, Sign, SignKind
from reverie_eval.reporting.replay import replay_html
from reverie_eval.reporting.resources import text_of
from reverie_eval.text import count_text

MAP_STYLE = text_of("shared/map.css")
"""The style sheet for pages with maps and their keys; :func:`map_picture` includes it."""
_STAR = np.array(
    [
        (radius * np.sin(turn), -radius * np.cos(turn))
        for turn, radius in zip(np.arange(10) * np.pi / 5, [7.5, 3.2] * 5, strict=True)
    ]
)
_STAIRS = np.array([(-6, 5), (-6, 2), (-2, 2), (-2, -1), (2, -1), (2, -4), (6, -4)])
_RADIUS = {"start": 5.5, "goal": 7.0}
# Path data of the signs in a key that are lines.
_KEY_LINES: Mapping[SignKind, str] = MappingProxyType(
    {
        "sight": "M8 8L34 0V16z",
        "jump": "M4 8H36",
        "annotated": "M6 8H34",
        "off-level": "M4 8H36",
        "elsewhere": "M12 8h0M28 8h0",
        "plan": "M4 13V3H16M26 3H36V13",
    }
)


def map_svg(episode_map: EpisodeMap) -> str:
    """Draw a still map for a page that includes ``MAP_STYLE``."""
    return _Drawing(episode_map).still()


def map_picture(episode_map: EpisodeMap) -> str:
    """Draw a still map that includes its style sheet, for a file or any page."""
    # A page has the style sheet once; a file has to bring its own.
    own = ' xmlns="http://www.w3.org/2000/svg"', f"<style>{MAP_STYLE}</style>"
    return _Drawing(episode_map).still(*own)


def interactive_map_svg(episode_map: EpisodeMap) -> str:
    """Draw an interactive map for a page that includes ``MAP_STYLE``."""
    return _Drawing(episode_map).interactive()


def map_shapes(episode_map: EpisodeMap) -> str:
    """Draw what a still map consists of, for a picture with other things beside it."""
    return _Drawing(episode_map).shapes()


def visited_svg(position: FloatArray) -> str:
    """Draw the way so far, for a page with ``MAP_STYLE``; nothing else of the building.

    Parameters
    ----------
    position : float array of shape (n_poses, 3)
        Where one has been, the start first: metres, x to the right and y up.
    """
    frame = Frame.around(position)
    points = frame.points(position)
    shapes = [
        path("route route-1", path_data("route", [points])) if len(points) > 1 else "",
        path("viewpoint", path_data("viewpoint", list(points[:, None]))),
        draw_mark(Mark("start", points[0]), "start"),
        draw_mark(Mark("stop", points[-1], 1), "here"),
    ]
    number = count_text(len(np.unique(position, axis=0)), "viewpoint")
    return (
        f'<svg class="episode-map" role="img" viewBox="0 0 {WIDTH} {HEIGHT}">'
        f"<title>The walk so far: {number}</title>{_on_ground(shapes, frame)}</svg>"
    )


def map_key(*maps: EpisodeMap) -> str:
    """Explain the signs on maps of the same submissions in HTML."""
    signs = dict.fromkeys(sign for each in maps for sign in each.signs)
    entries = "".join(
        f'<span><svg class="episode-map sign" viewBox="0 0 40 16" aria-hidden="true">'
        f"{sign_shapes(sign)}</svg> {escape(sign.meaning)}</span>"
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
        f"{escape(caption)}</figcaption>{map_key(episode_map)}{answers}"
        f"{replay_html(episode, episode_map)}</figure>"
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


class _Drawing:
    def __init__(self, episode_map: EpisodeMap) -> None:
        self._map = episode_map
        self._layout = Layout(episode_map)

    def still(self, attributes: str = "", style: str = "") -> str:
        return self._svg("episode-map", self.shapes(), attributes, style)

    def shapes(self) -> str:
        edges, *others = self._layout.layers()
        storey = self._map.start_storey
        plan, names = self._layout.plan(storey), self._layout.room_names(storey)
        layers = map(list, (plan, edges, names, *others))
        shapes = (shape for layer in layers for shape in self._joined(layer))
        return _on_ground(shapes, self._layout.frame)

    def interactive(self) -> str:
        edges, rooms, annotated, *others = (
            map(self._apart, layer) for layer in self._layout.layers()
        )
        storeys = range(int(self._map.storey.max()) + 1)
        plans, names = (
            map(self._apart, chain.from_iterable(map(layer, storeys)))
            for layer in (self._layout.plan, self._layout.room_names)
        )
        shapes = [
            *plans,
            *edges,
            *names,
            *rooms,
            '<g class="annotation" opacity="0.3">',  # as a group: not darker where pieces meet
            *annotated,
            "</g>",
            *chain.from_iterable(others),
        ]
        return self._svg("episode-map walkable", _on_ground(shapes, self._layout.frame))

    def _svg(self, kind: str, shapes: str, attributes: str = "", style: str = "") -> str:
        return (
            f'<svg class="{kind}" role="img" viewBox="0 0 {WIDTH} {HEIGHT}"{attributes}>'
            f"<title>{escape(f'Map of episode {self._map.instr_id}')}</title>"
            f"<desc>{escape(self._map.description)}</desc>{style}{shapes}</svg>"
        )

    def _joined(self, layer: Sequence[Piece]) -> Iterator[str]:
        """Draw the pieces of a layer as few elements."""
        for kind, lines in self._layout.joined(layer).items():
            yield path(kind, path_data(kind, lines))
        yield from (draw_mark(piece.mark, piece.title) for piece in layer if piece.mark)

    def _apart(self, piece: Piece) -> str:
        """Draw a piece as a group that says what it is and which storeys it is on."""
        on = self._map.levels(piece.viewpoints) if piece.storey is None else [piece.storey + 1]
        levels = " ".join(map(str, on))
        about = ""
        if piece.viewpoint_id:
            about = f' data-viewpoint="{escape(piece.viewpoint_id)}"'
        if piece.leg:
            route, leg = piece.leg
            about = f' class="leg" data-route="{route}" data-leg="{leg}"'
        faint = ' data-elsewhere="" opacity="0.35"' if self._layout.is_faint(piece) else ""
        shapes = [path(kind, path_data(kind, it), piece.title) for kind, it in piece.lines.items()]
        if piece.mark:
            shapes.append(draw_mark(piece.mark, piece.title))
        return f'<g data-levels="{levels}"{about}{faint}>{"".join(shapes)}</g>'


def _on_ground(shapes: Iterable[str], frame: Frame) -> str:
    """Lay shapes on the ground, with the scale above both."""
    metres = frame.bar_metres
    return (
        f'<rect class="ground" width="{WIDTH}" height="{HEIGHT}"/>{"".join(shapes)}'
        f'<path class="scale" d="M10 {HEIGHT - 14}v4h{metres * frame.scale:.1f}v-4"/>'
        f'<text class="scale" x="14" y="{HEIGHT - 16}">{metres} m</text>'
    )


def sign_shapes(sign: Sign) -> str:
    """Draw a sign for a key, 40 units wide and 16 high."""
    middle = np.array([20.0, 8.0])
    match sign.kind:
        case "stop":
            line = path(f"route route-{sign.route}", "M2 8H30")
            return line + draw_mark(Mark("stop", np.array([33.0, 8.0]), sign.route))
        case "start" | "goal" | "end" | "stairs":
            return draw_mark(Mark(sign.kind, middle))
        case _:
            return path(KEY_CLASSES[sign.kind], _KEY_LINES[sign.kind])


def draw_mark(mark: Mark, title: str = "") -> str:
    """Draw a mark, with a tooltip if it has a title."""
    x, y = mark.point
    match mark.kind:
        case "start" | "goal":
            radius = _RADIUS[mark.kind]
            shape = f'class="{mark.kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}"'
            return element("circle", shape, title)
        case "end":
            return path("end", f"{line_data(_STAR + mark.point)}z", title)
        case "stop":
            corner = f'x="{x - 4.5:.1f}" y="{y - 4.5:.1f}" width="9" height="9"'
            return element("rect", f'class="stop route-{mark.route}" {corner}', title)
        case "stairs":
            shape = path("stairs", line_data(mark.point + _STAIRS))
            return shape + (_label(x, y - 8, mark.text, "middle") if mark.text else "")
        case "name":
            return text_at(x, y, mark.text, 'class="room-name" text-anchor="middle"')
        case "left of" | "right of":
            return _label(x, y, mark.text, "end" if mark.kind == "left of" else "")


def _label(x: float, y: float, text: str, anchor: str) -> str:
    attribute = f' text-anchor="{anchor}"' if anchor else ""
    return text_at(x, y, text, f'class="level"{attribute}')
