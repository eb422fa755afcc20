"""A map as SVG: a string that stands for itself, readable in light and dark, on screen and paper.

Nothing here knows of pages or of matplotlib; the same map has the same bytes.
"""

from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.reporting import _map_shapes as shapes
from reverie_eval.reporting._map_frame import Frame, arrows
from reverie_eval.reporting._maps import EpisodeMap, Route, Sign, key_of
from reverie_eval.reporting.resources import text_of

WIDTH, HEIGHT = 400, 300
MAP_STYLE = text_of("shared/map.css")
"""What :func:`map_element` needs once on its page."""


def map_svg(episode_map: EpisodeMap) -> str:
    """Draw a map as a picture of its own, with all that it needs inside.

    Returns
    -------
    str
        An ``svg`` element, to be put on a page or written to a file.
    """
    return _svg(episode_map, ' xmlns="http://www.w3.org/2000/svg"', f"<style>{MAP_STYLE}</style>")


def map_element(episode_map: EpisodeMap) -> str:
    """Draw a map for a page that has ``MAP_STYLE`` among its styles."""
    return _svg(episode_map, "", "")


def map_key(names: Sequence[str]) -> str:
    """Explain the signs of a map, in HTML; of the submissions with these names if there are any."""
    explained = "".join(
        f"<span>{_sign(sign)} {escape(sign.meaning)}</span>" for sign in key_of(names)
    )
    return f'<p class="map-key">{explained}</p>'


def _svg(episode_map: EpisodeMap, attributes: str, style: str) -> str:
    frame = Frame.around(episode_map, WIDTH, HEIGHT)
    return "".join(
        [
            f'<svg class="episode-map" role="img" viewBox="0 0 {WIDTH} {HEIGHT}"{attributes}>',
            f"<title>{escape(f'Map of episode {episode_map.instr_id}')}</title>",
            f"<desc>{escape(episode_map.description)}</desc>",
            style,
            f'<rect class="ground" width="{WIDTH}" height="{HEIGHT}"/>',
            *_graph(episode_map, frame),
            *_annotation(episode_map, frame),
            *(
                part
                for number, route in enumerate(episode_map.routes, 1)
                for part in _route(episode_map, route, number, frame)
            ),
            *_ends(episode_map, frame),
            *shapes.scale(frame),
            "</svg>",
        ]
    )


def _graph(episode_map: EpisodeMap, frame: Frame) -> Iterator[str]:
    """Draw the scan's navigation graph, other storeys faintly and below."""
    place = frame.place(episode_map.position)
    viewpoints = np.arange(len(place))
    hidden = episode_map.is_elsewhere
    across = hidden[episode_map.edges].any(axis=1)
    parts = ((" elsewhere", hidden, across), ("", ~hidden, ~across))
    for kind, of_viewpoints, of_edges in parts:
        yield shapes.path(f"edge{kind}", map(shapes.line, place[episode_map.edges[of_edges]]))
        yield shapes.path(
            f"viewpoint{kind}",
            (f"M{shapes.coordinates(place[v])}h0" for v in viewpoints[of_viewpoints]),
        )


def _annotation(episode_map: EpisodeMap, frame: Frame) -> Iterator[str]:
    place = frame.place(episode_map.position)
    yield shapes.path("annotated", [shapes.line(place[episode_map.annotated_path])])
    for viewpoint in episode_map.success:
        yield shapes.circle(
            "success", place[viewpoint], f"a stop here is a success: {_id(episode_map, viewpoint)}"
        )


def _route(episode_map: EpisodeMap, route: Route, number: int, frame: Frame) -> Iterator[str]:
    """Draw where an agent went: a line on its lane, with an arrow on every leg."""
    lane, is_jump = frame.lane_of(episode_map, route), episode_map.is_jump(route)
    if len(lane):
        yield shapes.path(f"route route-{number}", _walked(lane, is_jump))
        yield shapes.path(
            f"arrow route-{number}", (f"{shapes.line(tip)}z" for tip in arrows(lane, 9.0))
        )
    if is_jump.any():
        yield shapes.path(f"route jump route-{number}", map(shapes.line, lane[is_jump]))


def _walked(lane: FloatArray, is_jump: BoolArray) -> Iterator[str]:
    """Join the legs that were walked to one line, interrupted where the agent jumped."""
    goes_on = np.concatenate([[False], ~is_jump[:-1]])
    for leg in np.flatnonzero(~is_jump):
        yield shapes.line(lane[leg]).replace("M", "L" if goes_on[leg] else "M")


def _ends(episode_map: EpisodeMap, frame: Frame) -> Iterator[str]:
    place = frame.place(episode_map.position)
    yield shapes.circle(
        "start", place[episode_map.start], f"start: {_id(episode_map, episode_map.start)}"
    )
    yield shapes.goal(
        place[episode_map.goal], f"end of the annotated path: {_id(episode_map, episode_map.goal)}"
    )
    for number, route in enumerate(episode_map.routes, 1):
        whose = f" of {route.name}" if route.name else ""
        shift = np.array([6.0 * (number - 1), 0.0])
        title = f"stop{whose}: {_id(episode_map, route.stop)}"
        yield shapes.stop(place[route.stop] + shift, number, title)


def _sign(sign: Sign) -> str:
    drawn = _drawn(sign)
    return f'<svg class="episode-map sign" viewBox="0 0 40 16" aria-hidden="true">{drawn}</svg>'


def _drawn(sign: Sign) -> str:
    middle = np.array([20.0, 8.0])
    match sign.kind:
        case "stop":
            line = shapes.path(f"route route-{sign.route}", ["M2 8H30"])
            return line + shapes.stop(np.array([33.0, 8.0]), sign.route)
        case "start" | "success":
            return shapes.circle(sign.kind, middle)
        case "jump":
            return shapes.path("route jump", ["M4 8H36"])
        case "annotated":
            return shapes.path("annotated", ["M6 8H34"])
        case "goal":
            return shapes.goal(middle)
        case "elsewhere":
            return shapes.path("viewpoint elsewhere", ["M12 8h0M28 8h0"])


def _id(episode_map: EpisodeMap, viewpoint: int) -> str:
    return episode_map.viewpoint_ids[viewpoint]
