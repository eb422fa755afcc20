"""A map drawn with matplotlib, for notebooks and papers."""

from collections.abc import Mapping
from textwrap import wrap
from types import MappingProxyType
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from reverie_eval.reporting._figure_style import INK
from reverie_eval.reporting._map_frame import Frame, arrows
from reverie_eval.reporting._maps import EpisodeMap, Route, Sign, SignKind, key_of

_ROUTES = ("#0072B2", "#D55E00")
_RIGHT, _GRAPH = "#009E73", "#B3BAC4"
_HIDDEN = 0.35
"""How opaque storeys are that the episode has no part in."""
_WIDTH, _HEIGHT = 400, 300
_TITLE_WIDTH, _TITLE_LINES = 60, 3
"""In letters, in lines."""


def _mark(shape: str, size: float, face: str, edge: str, width: float) -> dict[str, Any]:
    return {
        "marker": shape,
        "markersize": size,
        "markerfacecolor": face,
        "markeredgecolor": edge,
        "markeredgewidth": width,
        "linestyle": "none",
    }


_STYLES: Mapping[SignKind, dict[str, Any]] = MappingProxyType(
    {
        "annotated": {"color": _RIGHT, "alpha": 0.3, "linewidth": 9},
        "success": _mark("o", 12, "white", _RIGHT, 2),
        "jump": {"color": INK, "linewidth": 2, "linestyle": ":"},
        "start": _mark("o", 6, "white", INK, 2),
        "goal": _mark("*", 12, _RIGHT, "white", 0.8),
        "elsewhere": _mark("o", 3.5, _GRAPH, _GRAPH, 1) | {"alpha": _HIDDEN},
    }
)
"""How signs look, on the map and in its key; a stop has the colour of its route."""


def draw_map(episode_map: EpisodeMap, axes: Axes) -> None:
    """Draw the navigation graph from above, and what happened on it."""
    frame = Frame.around(episode_map, _WIDTH, _HEIGHT)
    place = frame.place(episode_map.position)
    _draw_graph(episode_map, frame, axes)
    axes.plot(*place[episode_map.annotated_path].T, zorder=2, **_STYLES["annotated"])
    axes.plot(*place[episode_map.success].T, zorder=3, **_STYLES["success"])
    for number, route in enumerate(episode_map.routes[: len(_ROUTES)], 1):
        _draw_route(episode_map, route, number, frame, axes)
    axes.plot(*place[episode_map.start], zorder=5, **_STYLES["start"])
    axes.plot(*place[episode_map.goal], zorder=6, **_STYLES["goal"])
    _finish(episode_map, frame, axes)


def _draw_graph(episode_map: EpisodeMap, frame: Frame, axes: Axes) -> None:
    """Draw viewpoints and edges, those of other storeys faintly."""
    place = frame.place(episode_map.position)
    hidden = episode_map.is_elsewhere
    across = hidden[episode_map.edges].any(axis=1)
    for viewpoints, edges, alpha in ((hidden, across, _HIDDEN), (~hidden, ~across, 1.0)):
        lines = place[episode_map.edges[edges]]
        axes.add_collection(LineCollection(list(lines), colors=_GRAPH, linewidths=0.8, alpha=alpha))
        axes.plot(*place[viewpoints].T, zorder=1.5, **_STYLES["elsewhere"] | {"alpha": alpha})


def _draw_route(
    episode_map: EpisodeMap, route: Route, number: int, frame: Frame, axes: Axes
) -> None:
    """Draw where an agent went, with an arrow on every leg, dotted where it jumped."""
    colour = _ROUTES[number - 1]
    lane, is_jump = frame.lane_of(episode_map, route), episode_map.is_jump(route)
    for legs, style in ((lane[~is_jump], "-"), (lane[is_jump], ":")):
        drawn: dict[str, Any] = {"colors": colour, "linestyles": style, "capstyle": "round"}
        axes.add_collection(LineCollection(list(legs), linewidths=2, zorder=4, **drawn))
    for triangle in arrows(lane, 9.0):
        axes.fill(*triangle.T, color=colour, zorder=4)
    stop = frame.place(episode_map.position)[route.stop]
    axes.plot(*stop, zorder=7, **_stop_style(number))


def _stop_style(number: int) -> dict[str, Any]:
    colour = _ROUTES[number - 1]
    return _mark("s", 6, colour, "white", 1) | {"color": colour}


def _finish(episode_map: EpisodeMap, frame: Frame, axes: Axes) -> None:
    axes.set_xlim(0, frame.width)
    axes.set_ylim(frame.height, 0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.plot([12, 12 + frame.bar * frame.scale], [frame.height - 12] * 2, color=INK, linewidth=1.5)
    axes.text(12, frame.height - 17, f"{frame.bar} m", fontsize="small")
    axes.legend(
        handles=[_in_key(sign) for sign in key_of([route.name for route in episode_map.routes])],
        frameon=False,
        loc="upper left",
        bbox_to_anchor=(0, 0),
        ncols=2,
        fontsize="small",
    )
    axes.spines[:].set_visible(False)
    title = f"{episode_map.instr_id}: {episode_map.instruction}"
    lines = wrap(title, _TITLE_WIDTH, max_lines=_TITLE_LINES, placeholder=" ...")
    axes.set_title("\n".join(lines), loc="left", fontsize="small")


def _in_key(sign: Sign) -> Line2D:
    """Return what explains a sign; with a stop comes the line that leads there."""
    if sign.kind == "stop":
        style = _stop_style(sign.route) | {"linestyle": "-", "linewidth": 2}
    else:
        style = _STYLES[sign.kind]
    return Line2D([], [], label=sign.meaning, **style)
