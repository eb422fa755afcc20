"""A map drawn with matplotlib, for notebooks and papers."""

from textwrap import wrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting.figure_style import INK
from reverie_eval.reporting.map_frame import Frame, arrows
from reverie_eval.reporting.maps import EpisodeMap

_ROUTES = ("#0072B2", "#D55E00")
_RIGHT, _GRAPH = "#009E73", "#B3BAC4"
_WIDTH, _HEIGHT = 400, 300
_TITLE_WIDTH, _TITLE_LINES = 60, 3
"""In letters, in lines."""


def draw_map(episode_map: EpisodeMap, axes: Axes) -> None:
    """Draw the navigation graph from above, and what happened on it."""
    frame = Frame.around(episode_map, _WIDTH, _HEIGHT)
    _draw_graph(episode_map, frame, axes)
    place = frame.place(episode_map.position)
    axes.plot(*place[episode_map.annotated_path].T, color=_RIGHT, alpha=0.3, linewidth=9, zorder=2)
    _draw_places(place[episode_map.success], axes)
    for route, colour in zip(episode_map.routes, _ROUTES, strict=False):
        lane = frame.lane_of(episode_map, route)
        label = route.name or "the agent, stop"
        stop = place[route.stop]
        is_jump = episode_map.is_jump(route)
        for legs, style in ((lane[~is_jump], "-"), (lane[is_jump], ":")):
            drawn: dict[str, Any] = {
                "colors": colour,
                "linewidths": 2,
                "linestyles": style,
                "zorder": 4,
            }
            axes.add_collection(LineCollection(list(legs), capstyle="round", **drawn))
        for triangle in arrows(lane, 9.0):
            axes.fill(*triangle.T, color=colour, zorder=4)
        axes.plot(*stop, "s", color=colour, markeredgecolor="white", zorder=7, label=label)
    axes.plot(*place[episode_map.start], "o", zorder=5, label="start", **_hollow(INK))
    goal = place[episode_map.goal]
    label = "end of the annotated path"
    star: dict[str, Any] = {
        "color": _RIGHT,
        "markersize": 12,
        "markeredgecolor": "white",
        "markeredgewidth": 0.8,
    }
    axes.plot(*goal, "*", zorder=6, label=label, **star)
    _finish(episode_map, frame, axes)


def _draw_graph(episode_map: EpisodeMap, frame: Frame, axes: Axes) -> None:
    """Draw viewpoints and edges, those of other storeys faintly."""
    place = frame.place(episode_map.position)
    hidden = episode_map.is_elsewhere
    across = hidden[episode_map.edges].any(axis=1)
    for viewpoints, edges, alpha in ((hidden, across, 0.35), (~hidden, ~across, 1.0)):
        lines = place[episode_map.edges[edges]]
        axes.add_collection(LineCollection(list(lines), colors=_GRAPH, linewidths=0.8, alpha=alpha))
        axes.plot(*place[viewpoints].T, "o", color=_GRAPH, markersize=3.5, alpha=alpha, zorder=1.5)


def _draw_places(success: FloatArray, axes: Axes) -> None:
    label = "a stop here is a success"
    axes.plot(*success.T, "o", zorder=3, markersize=12, label=label, **_hollow(_RIGHT))


def _hollow(colour: str) -> dict[str, Any]:
    return {"markerfacecolor": "white", "markeredgecolor": colour, "markeredgewidth": 2}


def _finish(episode_map: EpisodeMap, frame: Frame, axes: Axes) -> None:
    axes.set_xlim(0, frame.width)
    axes.set_ylim(frame.height, 0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.plot([12, 12 + frame.bar * frame.scale], [frame.height - 12] * 2, color=INK, linewidth=1.5)
    axes.text(12, frame.height - 17, f"{frame.bar} m", fontsize="small")
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(0, 0), ncols=2, fontsize="small")
    axes.spines[:].set_visible(False)
    title = f"{episode_map.instr_id}: {episode_map.instruction}"
    lines = wrap(title, _TITLE_WIDTH, max_lines=_TITLE_LINES, placeholder=" ...")
    axes.set_title("\n".join(lines), loc="left", fontsize="small")
