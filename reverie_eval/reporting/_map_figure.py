"""A map drawn with matplotlib, for notebooks and papers."""

from collections.abc import Mapping
from textwrap import wrap
from types import MappingProxyType
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting._figure_style import BLUE, GREEN, GREY, INK, VERMILION
from reverie_eval.reporting._map_frame import HEIGHT, WIDTH, Frame, arrows
from reverie_eval.reporting._maps import EpisodeMap, Route, Sign, map_signs

_ROUTES = (BLUE, VERMILION)
_FAINT = 0.35
"""How opaque storeys are where the episode has no viewpoint."""
_TITLE_LETTERS, _TITLE_LINES = 60, 3


def _mark(shape: str, size: float, face: str, edge: str, width: float) -> dict[str, Any]:
    return {
        "marker": shape,
        "markersize": size,
        "markerfacecolor": face,
        "markeredgecolor": edge,
        "markeredgewidth": width,
        "linestyle": "none",
    }


_STYLES: Mapping[str, dict[str, Any]] = MappingProxyType(
    {
        "annotated": {"color": GREEN, "alpha": 0.3, "linewidth": 9},
        "goal": _mark("o", 12, "white", GREEN, 2),
        "jump": {"color": INK, "linewidth": 2, "linestyle": ":"},
        "start": _mark("o", 6, "white", INK, 2),
        "end": _mark("*", 12, GREEN, "white", 0.8),
        "elsewhere": _mark("o", 3.5, GREY, GREY, 1) | {"alpha": _FAINT},
    }
)
"""By kind of sign, on the map and in its key; a stop has the colour of its route."""


def draw_map(episode_map: EpisodeMap, axes: Axes) -> None:
    """Draw a map with its key below."""
    frame = Frame.around(episode_map)
    place = frame.place(episode_map.position)
    _draw_graph(episode_map, place, axes)
    axes.plot(*place[episode_map.annotated_path].T, zorder=2, **_STYLES["annotated"])
    axes.plot(*place[episode_map.goal_viewpoints].T, zorder=3, **_STYLES["goal"])
    for route in episode_map.routes[: len(_ROUTES)]:
        _draw_route(episode_map, route, frame, axes)
        axes.plot(*place[route.stop], zorder=7, **_stop_style(route.number))
    axes.plot(*place[episode_map.start], zorder=5, **_STYLES["start"])
    axes.plot(*place[episode_map.path_end], zorder=6, **_STYLES["end"])
    bar = frame.bar_metres
    axes.plot([12, 12 + bar * frame.scale], [HEIGHT - 12] * 2, color=INK, linewidth=1.5)
    axes.text(12, HEIGHT - 17, f"{bar} m", fontsize="small")
    axes.set_xlim(0, WIDTH)
    axes.set_ylim(HEIGHT, 0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    signs = map_signs([route.name for route in episode_map.routes])
    axes.legend(
        handles=list(map(_key_entry, signs)),
        frameon=False,
        loc="upper left",
        bbox_to_anchor=(0, 0),
        ncols=2,
        fontsize="small",
    )
    title = f"{episode_map.instr_id}: {episode_map.instruction}"
    lines = wrap(title, _TITLE_LETTERS, max_lines=_TITLE_LINES, placeholder=" ...")
    axes.set_title("\n".join(lines), loc="left", fontsize="small")


def _draw_graph(episode_map: EpisodeMap, place: FloatArray, axes: Axes) -> None:
    """Draw viewpoints and edges, those of other storeys faintly."""
    hidden = episode_map.is_elsewhere
    across = hidden[episode_map.edges].any(axis=1)
    for viewpoints, edges, alpha in ((hidden, across, _FAINT), (~hidden, ~across, 1.0)):
        lines = place[episode_map.edges[edges]]
        axes.add_collection(LineCollection(list(lines), colors=GREY, linewidths=0.8, alpha=alpha))
        axes.plot(*place[viewpoints].T, zorder=1.5, **_STYLES["elsewhere"] | {"alpha": alpha})


def _draw_route(episode_map: EpisodeMap, route: Route, frame: Frame, axes: Axes) -> None:
    """Draw the legs with arrows; jumps are dotted."""
    colour = _ROUTES[route.number - 1]
    lanes, is_jump = frame.lanes(episode_map, route), episode_map.is_jump(route)
    for legs, style in ((lanes[~is_jump], "-"), (lanes[is_jump], ":")):
        drawn: dict[str, Any] = {"colors": colour, "linestyles": style, "capstyle": "round"}
        axes.add_collection(LineCollection(list(legs), linewidths=2, zorder=4, **drawn))
    for arrow in arrows(lanes):
        if arrow is not None:
            axes.fill(*arrow.T, color=colour, zorder=4)


def _stop_style(number: int) -> dict[str, Any]:
    colour = _ROUTES[number - 1]
    return _mark("s", 6, colour, "white", 1) | {"color": colour}


def _key_entry(sign: Sign) -> Line2D:
    """Return a sign for the key; a stop comes with the line of its route."""
    if sign.kind == "stop":
        style = _stop_style(sign.route) | {"linestyle": "-", "linewidth": 2}
    else:
        style = _STYLES[sign.kind]
    return Line2D([], [], label=sign.meaning, **style)
