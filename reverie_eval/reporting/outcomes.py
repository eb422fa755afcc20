"""How the walks of many methods end: a pixel for each episode, and stops and turns on plans."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from typing_extensions import Self

from reverie_eval.analysis import WalkOutcomes
from reverie_eval.arrays import Array, FloatArray, IntArray
from reverie_eval.errors import naming_missing_parts
from reverie_eval.geometry import Building
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.reporting.buildings import building_of
from reverie_eval.reporting.drawing import (
    element,
    image_svg,
    path,
    path_data,
    text_across,
    wide_svg,
)
from reverie_eval.reporting.map_layout import HEIGHT, WIDTH, Frame, arrows, plan_of
from reverie_eval.scoring import CORRECT, OUTCOMES
from reverie_eval.text import count_text

_OPACITIES = (0x50, 0x70, 0x70, 0x70, 0xFF)
OPACITIES = tuple(round(each / 0xFF, 2) for each in _OPACITIES)
"""How opaque the outcomes are drawn, from worst to best: paler where an episode was not solved."""
# The outcomes from worst to best, as in `charts.css`, and the gap between two buildings.
_COLOURS = np.array(
    [
        (0x7D, 0x87, 0x91, _OPACITIES[0]),
        (0xCC, 0x79, 0xA7, _OPACITIES[1]),
        (0xE6, 0x9F, 0x00, _OPACITIES[2]),
        (0x56, 0xB4, 0xE9, _OPACITIES[3]),
        (0x00, 0x9E, 0x73, _OPACITIES[4]),
        (0, 0, 0, 0),
    ],
    dtype=np.uint8,
)
_BETWEEN = len(_COLOURS) - 1
# Pixels, as high as a method's name in `style.css`.
_ROW = 17
# Percent: the gap between two buildings (of the number of episodes), and the width that a
# building's name needs.
_GAP, _BUILDING = 0.4, 12.0


def outcome_matrix(outcome: IntArray, scans: Sequence[str]) -> str:
    """Draw a row for each method and a column for each episode.

    Episodes are grouped by building, the one that most are solved in at the right; within it, what
    most methods solve is at the right.

    Parameters
    ----------
    outcome : int array of shape (n_methods, n_episodes)
        Indices into ``OUTCOMES``; the first method is at the top.
    scans : sequence of str
        The building of each episode.

    Returns
    -------
    str
        SVG around a picture with a pixel for each outcome: 3,521 episodes of 54 methods take about
        60 kB, as elements they would take megabytes.

    Raises
    ------
    MissingPartError
        If Pillow is not installed.
    """
    solved = (outcome == CORRECT).sum(axis=0)
    columns, buildings = _arranged(solved, np.asarray(scans))
    height = _ROW * len(outcome)
    picture = f'height="{height}" preserveAspectRatio="none" href="{_picture(outcome, columns)}"'
    shapes = [
        # Not smoothed: colours that run into each other would be outcomes that there are not.
        f'<image width="100%" image-rendering="pixelated" {picture}/>',
        *_named(buildings, len(columns), height + 14),
    ]
    title = f"Outcomes of {count_text(len(outcome), 'method')} in {outcome.shape[1]:,} episodes"
    return wide_svg(title, height + 18, shapes)


def _arranged(solved: IntArray, scan: Array) -> tuple[IntArray, Mapping[str, tuple[int, int]]]:
    """Return the episode of each column, -1 between buildings, and the columns of each building."""
    by_ease = sorted(np.unique(scan).tolist(), key=lambda each: solved[scan == each].mean())
    gap = np.full(int(np.ceil(_GAP / 100 * len(solved))), -1)
    columns: list[IntArray] = []
    buildings, count = {}, 0
    for name in by_ease:
        rows = np.flatnonzero(scan == name)
        columns += [rows[np.argsort(solved[rows], kind="stable")], gap]
        buildings[name] = count, count + len(rows)
        count += len(rows) + len(gap)
    return np.concatenate(columns[:-1]), buildings


def _picture(outcome: IntArray, columns: IntArray) -> str:
    with naming_missing_parts():
        from PIL import Image

    shown = np.where(columns < 0, _BETWEEN, outcome[:, columns])
    written = BytesIO()
    Image.fromarray(_COLOURS[shown], "RGBA").save(written, "WEBP", lossless=True, method=6)
    return f"data:image/webp;base64,{base64.b64encode(written.getvalue()).decode()}"


def _named(buildings: Mapping[str, tuple[int, int]], count: int, y: float) -> Iterator[str]:
    """Name the buildings below the picture whose columns have room for it."""
    scale = 100 / count
    for name, (first, last) in buildings.items():
        if scale * (last - first) >= _BUILDING:
            yield text_across(scale * (first + last) / 2, y, name, "middle", "column")


# Where walks stop and turn wrong, on the plans of a building.

STOPS = {
    "at-goal": "stopped at the goal",
    "moved-on": "stopped elsewhere after the goal was reached",
    "gave-up": "stopped without having reached the goal",
}
"""The kinds of stops by class, each with its meaning."""
# The kind of each outcome. A correct object at the wrong stop is nearly always predicted before the
# goal was reached.
_KIND = {
    "never reached": "gave-up",
    "overshot": "moved-on",
    "wrong object": "at-goal",
    "correct object at the wrong stop": "gave-up",
    "correct": "at-goal",
}
_KINDS = np.array([list(STOPS).index(_KIND[outcome]) for outcome in OUTCOMES])
# Units of the page.
_LARGEST = 13.0
_THICKEST, _THINNEST = 7.0, 1.2
# Wrong turns that are drawn on a storey, at most: the most frequent.
_MOST_TURNS = 14


@dataclass(frozen=True, eq=False)
class WalkFaults:
    """How often walks in a building ended at each viewpoint, and how often they turned wrong."""

    scan: str
    building: Building
    position: FloatArray
    """Shape (n_viewpoints, 3): metres."""
    stops: IntArray
    """Shape (n_kinds, n_viewpoints): the number of stops, in the order of :data:`STOPS`."""
    turns: IntArray
    """Shape (n_turns, 2): moves by which walks first left the way to the goal."""
    times: IntArray
    """Shape (n_turns,): how often each occurred, the most frequent first."""

    @classmethod
    def of(cls, truth: GroundTruth, scan: str, methods: Sequence[WalkOutcomes]) -> Self:
        """Count the stops and wrong turns of methods in the episodes of a scan."""
        graph = truth.graph
        viewpoints = graph.viewpoints_of(scan)
        first, count = int(viewpoints[0]), len(viewpoints)
        is_here = np.isin(truth.episodes.start, viewpoints)
        kind = np.concatenate([_KINDS[each.outcome[is_here]] for each in methods])
        stop = np.concatenate([each.stop[is_here] for each in methods]) - first
        turns = np.vstack([each.wrong_turn[is_here] for each in methods])
        turns, times = np.unique(turns[turns[:, 0] >= 0] - first, axis=0, return_counts=True)
        order = np.argsort(-times, kind="stable")
        return cls(
            scan=scan,
            building=building_of(graph, truth.require_solution(), scan),
            position=graph.viewpoint_position[viewpoints],
            stops=np.bincount(kind * count + stop, minlength=len(STOPS) * count).reshape(-1, count),
            turns=turns[order],
            times=times[order],
        )

    def pictures(self) -> Sequence[tuple[str, str]]:
        """Return the name of each storey with its picture, for a page with ``map.css``."""
        count = int(self.building.storey.max()) + 1
        names = [f"level {storey + 1} of {count}" if count > 1 else "" for storey in range(count)]
        return [(name, self._picture(storey, name)) for storey, name in enumerate(names)]

    def _picture(self, storey: int, name: str) -> str:
        is_on = self.building.storey == storey
        frame = Frame.around(self.position[is_on])
        at_goal, moved_on, gave_up = self.stops[:, is_on].sum(axis=1).tolist()
        told = (
            f"{at_goal:,} stops at the goal, {moved_on:,} after it, {gave_up:,} without reaching it"
        )
        title = f"Walks in {self.scan}{f', {name}' if name else ''}: {told}"
        shapes = [
            f'<rect class="ground" width="{WIDTH}" height="{HEIGHT}"/>',
            *(
                path(kind, path_data(kind, lines))
                for piece in plan_of(self.building, storey, frame)
                for kind, lines in piece.lines.items()
            ),
            *self._stops(np.flatnonzero(is_on), frame),
            *self._turns(storey, frame),
        ]
        return image_svg("episode-map faults", (WIDTH, HEIGHT), "".join(shapes), title)

    def _stops(self, viewpoints: IntArray, frame: Frame) -> Iterator[str]:
        """Draw a circle for each kind of stop at a viewpoint, by area; smaller ones lie on top."""
        scale = _LARGEST / np.sqrt(max(self.stops.max(), 1))
        for row in viewpoints.tolist():
            x, y = frame.points(self.position[row])
            numbers = dict(zip(STOPS, self.stops[:, row].tolist(), strict=True))
            told = "; ".join(f"{STOPS[kind]}: {number:,}" for kind, number in numbers.items())
            for kind, number in sorted(numbers.items(), key=lambda each: -each[1]):
                if number:
                    radius = f'r="{max(scale * np.sqrt(number), 1):.1f}"'
                    shape = f'class="stops {kind}" cx="{x:.1f}" cy="{y:.1f}" {radius}'
                    yield element("circle", shape, told)

    def _turns(self, storey: int, frame: Frame) -> Iterator[str]:
        """Draw the most frequent wrong turns as arrows, as thick as they are frequent."""
        here = np.flatnonzero(self.building.storey[self.turns[:, 0]] == storey)[:_MOST_TURNS]
        ends = frame.points(self.position[self.turns[here]])
        shown = zip(ends, arrows(ends), self.times[here].tolist(), strict=True)
        for line, arrow, times in reversed(list(shown)):
            width = max(_THICKEST * times / self.times[0], _THINNEST)
            told = count_text(times, "wrong turn")
            shape = f'class="turn" stroke-width="{width:.1f}" d="{path_data("turn", [line])}"'
            yield element("path", shape, told)
            if arrow is not None:
                yield path("turn-arrow", path_data("arrow", [arrow]))
