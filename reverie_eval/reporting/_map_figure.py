"""A map drawn with matplotlib, for notebooks and papers."""

from collections.abc import Mapping
from textwrap import wrap
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting._figure_style import BLUE, GREEN, GREY, INK, VERMILION
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

_ROUTES = (BLUE, VERMILION)
_FAINT = 0.35
"""Opacity of storeys on which the episode has no viewpoint."""
_TITLE_LETTERS, _TITLE_LINES = 60, 3


def _mark(shape: object, size: float, face: str, edge: str, width: float) -> dict[str, Any]:
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
        "sight": {"color": INK, "alpha": 0.2, "linewidth": 9},
        "off-level": {"color": INK, "linewidth": 2, "linestyle": "--"},
        "stairs": _mark(STAIRS, 9, "none", INK, 1.5),
        "goal": _mark("o", 12, "white", GREEN, 2),
        "jump": {"color": INK, "linewidth": 2, "linestyle": ":"},
        "start": _mark("o", 6, "white", INK, 2),
        "end": _mark("*", 12, GREEN, "white", 0.8),
        "elsewhere": _mark("o", 3.5, GREY, GREY, 1) | {"alpha": _FAINT},
    }
)
"""Styles by kind of sign, on the map and in its key; a stop has the colour of its route."""


def draw_map(episode_map: EpisodeMap, axes: Axes) -> None:
    """Draw a map with its key below."""
    frame = Frame.around(episode_map)
    place = frame.place(episode_map.position)
    _draw_graph(episode_map, place, axes)
    _draw_annotated_path(episode_map, place, axes)
    axes.plot(*place[episode_map.goal_viewpoints].T, zorder=3, **_STYLES["goal"])
    for route in episode_map.routes[: len(_ROUTES)]:
        _draw_sight(place[route.stop], route, axes)
        _draw_route(episode_map, route, frame, axes)
        axes.plot(*place[route.stop], zorder=7, **_stop_style(route.number))
    axes.plot(*place[episode_map.start], zorder=5, **_STYLES["start"])
    axes.plot(*place[episode_map.path_end], zorder=6, **_STYLES["end"])
    _draw_levels(episode_map, place, axes)
    bar = frame.bar_metres
    axes.plot([12, 12 + bar * frame.scale], [HEIGHT - 12] * 2, color=INK, linewidth=1.5)
    axes.text(12, HEIGHT - 17, f"{bar} m", fontsize="small")
    axes.set_xlim(0, WIDTH)
    axes.set_ylim(HEIGHT, 0)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.legend(
        handles=list(map(_key_entry, episode_map.signs)),
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


def _draw_annotated_path(episode_map: EpisodeMap, place: FloatArray, axes: Axes) -> None:
    """Draw the annotated path, thin and dashed where it is not on the level of the start."""
    style, legs = _STYLES["annotated"], episode_map.annotated_legs
    off_level = episode_map.is_off_level(legs)
    dashed = style | {"linestyle": "--", "linewidth": style["linewidth"] / 2}
    for is_drawn, look in ((~off_level, style), (off_level, dashed)):
        # A row of NaN between legs leaves a gap.
        lines = np.full((int(is_drawn.sum()), 3, 2), np.nan)
        lines[:, :2] = place[legs[is_drawn]]
        axes.plot(*lines.reshape(-1, 2).T, zorder=2, **look)


def _draw_route(episode_map: EpisodeMap, route: Route, frame: Frame, axes: Axes) -> None:
    """Draw the legs with arrows; jumps are dotted, legs on other levels dashed."""
    colour = _ROUTES[route.number - 1]
    lanes, is_jump = frame.lanes(episode_map, route), episode_map.is_jump(route)
    dashed = episode_map.is_off_level(route.legs) & ~is_jump
    styles = {"-": ~is_jump & ~dashed, "--": dashed, ":": is_jump}
    for style, legs in ((style, lanes[is_drawn]) for style, is_drawn in styles.items()):
        drawn: dict[str, Any] = {"colors": colour, "linestyles": style, "capstyle": "round"}
        axes.add_collection(LineCollection(list(legs), linewidths=2, zorder=4, **drawn))
    for arrow in arrows(lanes):
        if arrow is not None:
            axes.fill(*arrow.T, color=colour, zorder=4)


def _draw_sight(stop: FloatArray, route: Route, axes: Axes) -> None:
    """Draw the view of the answer as a sector around the stop."""
    if route.sight is not None:
        style = _STYLES["sight"] | {"color": _ROUTES[route.number - 1], "linewidth": 0}
        axes.fill(*(stop + sector(route.sight)).T, zorder=3.5, **style)


def _draw_levels(episode_map: EpisodeMap, place: FloatArray, axes: Axes) -> None:
    """Mark stairs, and the levels of the ends if the episode has several."""
    for label, rows in level_labels(episode_map):
        aside = (8, -3) if len(rows) == 1 else (-6, 6)
        x, y = place[rows].mean(axis=0)
        axes.annotate(label, (x, y), aside, textcoords="offset points", fontsize="small", zorder=8)
    axes.plot(*place[episode_map.stairs].mean(axis=1).T, zorder=8, **_STYLES["stairs"])


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
