"""Maps as SVG: still ones for reports and notebooks, interactive ones for pages with a script.

Both consist of the same pieces. A still map joins them and is small. An interactive map keeps them
apart and says where each belongs: ``data-levels`` are its storeys, ``data-leg`` is the move of the
route, ``data-viewpoint`` the viewpoint. Without a script it shows what the still map shows. Beside
a map stands a list of the agent's steps.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from itertools import chain
from math import degrees, inf

import numpy as np

from reverie_eval.analysis import Episode, Gallery
from reverie_eval.arrays import FloatArray
from reverie_eval.geometry import level_view
from reverie_eval.logs import COSTS, Step, cost_text
from reverie_eval.reporting.answer_svg import answer_picture, view_svg
from reverie_eval.reporting.answers import AnswerView, answer_views
from reverie_eval.reporting.building_svg import BUILDING_STYLE
from reverie_eval.reporting.drawing import image_svg, path, path_data
from reverie_eval.reporting.floors_svg import Floors
from reverie_eval.reporting.map_layout import HEIGHT, WIDTH, Frame, Layout, Mark, Piece
from reverie_eval.reporting.map_marks import MAP_STYLE, draw_mark, sign_shapes
from reverie_eval.reporting.maps import EpisodeMap
from reverie_eval.text import count_text


def map_svg(episode_map: EpisodeMap) -> str:
    """Draw a still map for a page that includes ``BUILDING_STYLE``."""
    return _Drawing(episode_map).still()


def map_picture(episode_map: EpisodeMap) -> str:
    """Draw a still map that includes its style sheet, for a file or any page."""
    return _Drawing(episode_map).still(has_style=True)


def interactive_map_svg(episode_map: EpisodeMap) -> str:
    """Draw an interactive map for a page that includes ``BUILDING_STYLE``."""
    return _Drawing(episode_map).interactive()


def map_shapes(episode_map: EpisodeMap) -> tuple[str, str, float]:
    """Draw what a still map consists of, and return it after its class and before its height."""
    drawing = _Drawing(episode_map)
    return drawing.kind, drawing.shapes(), drawing.height


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
    title = f"The walk so far: {number}"
    return image_svg("episode-map", (WIDTH, HEIGHT), _on_scale(shapes, frame), title)


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
    """A map from above; if the episode is on several levels, on the stacked floors of each."""

    def __init__(self, episode_map: EpisodeMap) -> None:
        self._map = episode_map.cropped() if episode_map.leaves_level else episode_map
        self._frame = (
            Floors(self._map)
            if episode_map.leaves_level
            else Frame.around(episode_map.position[episode_map.visited])
        )
        self._layout = Layout(self._map, self._frame)
        self.kind = "episode-map building" if episode_map.leaves_level else "episode-map"
        self.height = self._frame.height

    def still(self, *, has_style: bool = False) -> str:
        return self._svg(self.kind, self.shapes(), has_style=has_style)

    def shapes(self) -> str:
        edges, *others = self._layout.layers()
        plans, names = self._rooms([self._map.start_storey])
        layers = map(list, (plans, edges, names, *others))
        return self._on_ground(shape for layer in layers for shape in self._joined(layer))

    def interactive(self) -> str:
        edges, annotated, *others = (map(self._apart, layer) for layer in self._layout.layers())
        plans, names = self._rooms(range(self._map.storey.max() + 1))
        shapes = [
            *map(self._apart, plans),
            *edges,
            *map(self._apart, names),
            '<g class="annotation" opacity="0.3">',  # as a group: not darker where pieces meet
            *annotated,
            "</g>",
            *chain.from_iterable(others),
        ]
        return self._svg(f"{self.kind} walkable", self._on_ground(shapes))

    def _rooms(self, storeys: Iterable[int]) -> tuple[Iterator[Piece], Iterator[Piece]]:
        """Return the plans of storeys, and the names of their rooms; on floors, those of these."""
        shown = self._frame.levels if isinstance(self._frame, Floors) else list(storeys)
        layout = self._layout
        plans, names = map(layout.plan, shown), map(layout.room_names, shown)
        return chain.from_iterable(plans), chain.from_iterable(names)

    def _svg(self, kind: str, shapes: str, *, has_style: bool = False) -> str:
        # A page has the style sheet once; a file has to bring its own.
        style = BUILDING_STYLE if self._map.leaves_level else MAP_STYLE
        return image_svg(
            kind,
            (WIDTH, self.height),
            shapes,
            f"Map of episode {self._map.instr_id}",
            description=self._map.description,
            style=style if has_style else "",
        )

    def _on_ground(self, shapes: Iterable[str]) -> str:
        if isinstance(self._frame, Frame):
            return _on_scale(shapes, self._frame)
        return f"{self._frame.shapes}{''.join(shapes)}"

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


def _on_scale(shapes: Iterable[str], frame: Frame) -> str:
    """Lay shapes on the ground, with the scale above both."""
    metres = frame.bar_metres
    return (
        f'<rect class="ground" width="{WIDTH}" height="{HEIGHT}"/>{"".join(shapes)}'
        f'<path class="scale" d="M10 {HEIGHT - 14}v4h{metres * frame.scale:.1f}v-4"/>'
        f'<text class="scale" x="14" y="{HEIGHT - 16}">{metres} m</text>'
    )


# Replays: what an agent saw, did and said in an episode, step by step.

# Letters of a viewpoint's id, which tell those of a scan apart.
_SHOWN_OF_ID = 8
_VIEW = "max-width: 20rem; margin: 0.4em 0"
_NOTE = "margin: 0.2em 0; max-height: 14em; overflow: auto; white-space: pre-wrap"


def replay_html(episode: Episode, episode_map: EpisodeMap) -> str:
    """List the steps of an episode, folded; empty if its run has no log of them.

    The map has the numbers of the steps where they were made.
    """
    if not episode.steps:
        return ""
    steps = "".join(
        f'<li value="{step.step}">{_seen(step, episode, episode_map)}'
        f"{_view(step, episode, episode_map)}{_done(step, episode)}{''.join(_said(step))}</li>"
        for step in episode.steps
    )
    count = count_text(len(episode.steps), "step")
    return f"<details><summary>Replay {count}</summary><ol>{steps}</ol></details>"


def _seen(step: Step, episode: Episode, episode_map: EpisodeMap) -> str:
    """Say where the agent was, and what there was to see."""
    parts = [f"{_viewpoint(step.viewpoint_id)}, facing {degrees(step.heading) % 360:.0f}°"]
    if step.viewpoint_id in episode_map.viewpoint_ids:  # a log may be of other buildings
        row = episode_map.viewpoint_ids.index(step.viewpoint_id)
        neighbours = len(episode.graph.neighbours(int(episode_map.graph_row[row])))
        objects = len(episode.visible_objects(step.viewpoint_id))
        to_goal = float(episode_map.to_goal(np.array([row]))[0])
        parts += [
            count_text(neighbours, "neighbour"),
            count_text(objects, "object"),
            *([] if to_goal == inf else [f"{to_goal:.1f} m to the goal"]),
        ]
    return "; ".join(parts)


def _view(step: Step, episode: Episode, episode_map: EpisodeMap) -> str:
    """Draw the level view nearest to where the agent faced; a line break without one.

    A task without objects has no rooms to draw.
    """
    is_here = step.viewpoint_id in episode_map.viewpoint_ids
    if not is_here or episode.target_object is None:
        return "<br>"
    view = level_view(step.heading)
    drawing = view_svg(AnswerView.at_step(episode, step.viewpoint_id, view))
    return f'<div style="{_VIEW}">{drawing}</div>'


def _done(step: Step, episode: Episode) -> str:
    """Say what the agent did, and what that cost."""
    arguments = [
        escape(episode.object_name(value)) if name == "object_id" else _viewpoint(str(value))
        for name, value in dict(step.arguments or {}).items()
    ]
    costs = [
        cost_text(key, value) for key in COSTS if (value := getattr(step, key, None)) is not None
    ]
    action = escape(step.action) or "no action"
    return f"<b>{action}</b> {', '.join(arguments)} <small>{', '.join(costs)}</small>"


def _said(step: Step) -> Iterator[str]:
    for name, value in step.notes.items():
        text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
        yield f'<p style="{_NOTE}"><em>{escape(name)}</em> {escape(text)}</p>'


def _viewpoint(text: str) -> str:
    return f'<code title="{escape(text)}">{escape(text[:_SHOWN_OF_ID])}</code>'
