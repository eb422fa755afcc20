"""Charts: their data, what is drawn on which axes, and SVG for the report.

Notebooks draw the same with matplotlib.

The colours of SVG come from the page. Classes: ``mark series-1`` and ``outline series-2`` for
submissions, ``dot`` for episodes, ``axis`` for grid lines.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from types import MappingProxyType

import numpy as np
from typing_extensions import Self

from reverie_eval.analysis import BudgetCurve
from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.errors import ProtocolError
from reverie_eval.logs import COSTS
from reverie_eval.metrics import CATALOGUE, Metric, Unit
from reverie_eval.reporting.drawing import Lines, image_svg, path, path_data, text_at
from reverie_eval.scoring import Scores

_MOST_BARS = 60
# Percent of the walks that a chart shows: a few walks of hundreds of metres would squeeze all
# others together.
_SHOWN_WALKS = 99
# The share of the solved episodes that a chart of budgets shows: a few may be very expensive.
_SHOWN_SUCCESS = 0.99
MOST_SERIES = 6
"""Colours of the style sheet."""
_MILLIMETRE = 1e-3
WIDTH, HEIGHT = 400, 250
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 12, 10, 40
_INSIDE_WIDTH, _INSIDE_HEIGHT = WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM
_MOST_TICKS = 7


def round_numbers() -> Iterator[int]:
    """Count 1, 2, 5, 10, 20, 50, 100 and so on."""
    return (digit * 10**exponent for exponent in count() for digit in (1, 2, 5))


def bin_edges(values: FloatArray, most: int) -> FloatArray:
    """Divide the range of values into at most ``most`` bins, 1, 2, 5, 10, 20, 50 ... wide.

    >>> bin_edges(np.array([3.2, 5.0]), 3)
    array([3., 4., 5., 6.])
    """
    # The end is above the largest value, also where that is a whole number.
    first, last = np.floor(values.min()), np.floor(values.max()) + 1
    width = next(width for width in round_numbers() if (last - first) / width <= most)
    return np.arange(np.floor(first / width) * width, last + width, width)


def count_edges(counts: FloatArray, most: int) -> FloatArray:
    """Divide a range of counts as :func:`bin_edges` does; bins of a single count are centred on it.

    >>> count_edges(np.array([3.0, 5.0]), 3), count_edges(np.array([3.0, 5.0]), 2)
    (array([2.5, 3.5, 4.5, 5.5]), array([2., 4., 6.]))
    """
    edges = bin_edges(counts, most)
    return edges - 0.5 if edges[1] - edges[0] == 1 else edges


_PERCENT_EDGES = np.arange(0.0, 101.0, 10.0)
_TURN_EDGES = np.arange(0.0, 1.01, 0.1)
_EDGES: Mapping[Unit, Callable[[FloatArray, int], FloatArray]] = MappingProxyType(
    {
        "fraction": lambda *_: _PERCENT_EDGES,
        "metres": bin_edges,
        "count": count_edges,
        "turns": lambda *_: _TURN_EDGES,
    }
)


@dataclass(frozen=True, eq=False)
class Histogram:
    """How a metric's values are distributed, for one submission or several in the same bins."""

    metric: Metric
    edges: FloatArray
    """Shape (n_bins + 1,): in percent for fractions, otherwise in the metric's unit."""
    share: Mapping[str, FloatArray]
    """Percent of each submission's values in each bin, shape (n_bins,). A value on an edge counts
    in the bin above it; on the last edge, in the bin below."""
    values: Mapping[str, FloatArray]
    """All values of each submission, in the metric's own unit."""
    noun: str
    """What the values belong to: episodes or boxes."""

    @classmethod
    def of(cls, scores: Mapping[str, Scores], key: str) -> Self:
        """Divide a metric's values into bins; for box metrics, those of predicted boxes only.

        ``scores`` are by the submissions' names. Raises KeyError if the metric is not scored, and
        ProtocolError if it has no value in any episode.
        """
        values = {name: each.episodes[key] for name, each in scores.items()}
        metric = CATALOGUE[key]
        # An answer without a box has an IoU of 0, which says nothing about boxes.
        is_of_boxes = "box" in metric.needs
        if is_of_boxes:
            boxes = {name: each.boxes for name, each in scores.items() if each.boxes is not None}
            values |= {name: values[name][each.row] for name, each in boxes.items()}
        if metric.is_partial:
            values = {name: each[~np.isnan(each)] for name, each in values.items()}
        if not all(map(len, values.values())):
            raise ProtocolError(f"{key} has no value in any episode, so there is nothing to draw")
        shown = {name: metric.scale * each for name, each in values.items()}
        edges = _EDGES[metric.unit](np.concatenate(list(shown.values())), _MOST_BARS)
        share = {
            name: 100 * np.histogram(each, edges)[0] / len(each) for name, each in shown.items()
        }
        return cls(metric, edges, share, values, "boxes" if is_of_boxes else "episodes")

    @property
    def label(self) -> str:
        """The metric's name with the unit of the edges."""
        unit = self.metric.suffix
        return f"{self.metric.name} ({unit})" if unit else self.metric.name

    def chart(self, names: Sequence[str]) -> "Chart":
        """Return bars for the first submission, and an outline for the second.

        ``names`` are those of all submissions, also of one without values in the histogram.
        """
        low, high = float(self.edges[0]), float(self.edges[-1])
        draw = {"mark series-1": self._bars, "outline series-2": self._outline}
        return Chart(
            title=f"Distribution of {self.label}",
            x_label=self.label,
            y_label=f"share of {self.noun} (%)",
            low=low,
            high=high,
            top=1.05 * max(float(share.max()) for share in self.share.values()),
            lines={
                kind: drawn(self.share[name])
                for name, (kind, drawn) in zip(names, draw.items(), strict=False)
                if name in self.share
            },
        )

    def _bars(self, share: FloatArray) -> Sequence[FloatArray]:
        # Half a unit of the page on either side makes a gap between bars.
        gap = 0.5 * (self.edges[-1] - self.edges[0]) / _INSIDE_WIDTH
        spans = zip(self.edges[:-1] + gap, self.edges[1:] - gap, share, strict=True)
        return [
            np.array([(left, 0), (left, height), (right, height), (right, 0)])
            for left, right, height in spans
            if height
        ]

    def _outline(self, share: FloatArray) -> Sequence[FloatArray]:
        x, y = np.repeat(self.edges, 2), np.repeat(share, 2)
        return [np.column_stack([x, np.concatenate([[0], y, [0]])])]


@dataclass(frozen=True, eq=False)
class WalkLengths:
    """Walked and shortest length of every episode; all shapes are (n_episodes,)."""

    shortest: FloatArray
    """Metres."""
    walked: FloatArray
    """Metres."""
    is_success: BoolArray

    @classmethod
    def of(cls, scores: Scores) -> Self:
        """Take the lengths from a submission's scores."""
        episodes = scores.episodes
        is_success = episodes["success"] > 0
        return cls(episodes["shortest_length"], episodes["path_length"], is_success)

    def chart(self, top: float) -> "Chart":
        """Return a dot for each walk of at most ``top`` metres, over its shortest length."""
        walks = np.column_stack([self.shortest, self.walked])
        # What is drawn last is on top.
        parts = {"dot miss": ~self.is_success, "dot hit": self.is_success}
        shown = self.walked <= top
        high = float(np.ceil(self.shortest.max())) or 1.0
        end = min(high, top)
        return Chart(
            title="Walked length of every episode over the shortest length",
            x_label="shortest length (m)",
            y_label="walked length (m)",
            low=0.0,
            high=high,
            top=top,
            lines={
                **{kind: list(walks[part & shown][:, None]) for kind, part in parts.items()},
                "diagonal": [np.array([(0, 0), (end, end)])],
            },
            key={
                "dot miss": "stopped elsewhere",
                "dot hit": "stopped at the goal",
                "diagonal": "shortest",
            },
        )

    @property
    def longest_shown(self) -> float:
        """The longest walk that a chart shows, in whole metres; nearly all walks are shorter."""
        nearly_all = float(np.percentile(self.walked, _SHOWN_WALKS))
        return float(np.ceil(max(nearly_all, float(self.shortest.max()), 1.0)))

    @property
    def is_shown(self) -> BoolArray:
        """Whether the walk is short enough for a chart."""
        return self.walked <= self.longest_shown

    @property
    def is_detour(self) -> BoolArray:
        """Whether the walk is longer than the shortest, by more than rounding."""
        return self.walked > self.shortest + _MILLIMETRE


def budget_chart(curves: Mapping[str, BudgetCurve]) -> "Chart":
    """Return what share of the episodes runs solved within a budget, by the names of the runs.

    It ends where nearly all that are solved are.
    """
    first = next(iter(curves.values()))
    nearly_all = max(
        float(it.budget[np.argmax(it.share >= _SHOWN_SUCCESS * it.share[-1])])
        for it in curves.values()
    )
    high = 1.05 * nearly_all or 1.0
    # By colour: with more runs than colours, several have one.
    bands = defaultdict[str, list[FloatArray]](list)
    steps = defaultdict[str, list[FloatArray]](list)
    names = defaultdict[str, list[str]](list)
    for number, (name, curve) in enumerate(curves.items()):
        series = f"series-{number % MOST_SERIES + 1}"
        shown = curve.budget <= high
        # Each share holds until the next budget, the last one to the chart's end.
        x = np.append(np.repeat(curve.budget[shown], 2)[1:], high)
        low, share, end = (
            np.column_stack([x, 100 * np.repeat(each[shown], 2)])
            for each in (curve.low, curve.share, curve.high)
        )
        bands[f"band {series}"].append(np.vstack([low, end[::-1]]))
        steps[f"curve {series}"].append(np.vstack([share[:1] * (1, 0), share]))
        names[f"curve {series}"].append(name)
    return Chart(
        title=f"{first.metric.label} within a budget",
        x_label=f"budget for an episode ({COSTS[first.cost]})",
        y_label=f"{first.metric.label} within the budget (%)",
        low=0.0,
        high=high,
        top=min(105 * max(float(each.high.max()) for each in curves.values()), 105.0),
        lines={**bands, **steps},
        key={kind: told for kind, its in names.items() if (told := ", ".join(its))},
    )


@dataclass(frozen=True, eq=False)
class Chart:
    """Lines on linear axes; values go to the right from ``low`` to ``high``, up from 0 to ``top``.

    Their classes are ``mark series-1`` and ``outline series-2`` for submissions, and ``dot`` for
    episodes.
    """

    title: str
    x_label: str
    y_label: str
    low: float
    high: float
    top: float
    lines: Lines
    """By class, in the order in which they are drawn; points are values."""
    key: Mapping[str, str] = field(default_factory=dict)
    """What the classes mean that a legend explains."""

    @property
    def x_ticks(self) -> FloatArray:
        """The numbers below the chart."""
        return _ticks(self.low, self.high)

    @property
    def y_ticks(self) -> FloatArray:
        """The numbers to its left."""
        return _ticks(0, self.top)

    def svg(self) -> str:
        """Draw the chart for the report, whose style sheet has its colours."""
        drawn = (
            path(kind, path_data(kind, [self._on_page(points) for points in lines]))
            for kind, lines in self.lines.items()
        )
        return image_svg("chart", (WIDTH, HEIGHT), "".join([*self._grid(), *drawn]), self.title)

    def _on_page(self, points: FloatArray) -> FloatArray:
        x = _LEFT + (points[:, 0] - self.low) / (self.high - self.low) * _INSIDE_WIDTH
        # On a page, y grows downwards.
        y = HEIGHT - _BOTTOM - points[:, 1] / self.top * _INSIDE_HEIGHT
        return np.column_stack([x, y])

    def _grid(self) -> Iterator[str]:
        """Draw the grid lines, numbers and labels of both axes."""
        bottom, middle = HEIGHT - _BOTTOM, _TOP + _INSIDE_HEIGHT / 2
        across = self._on_page(np.column_stack([self.x_ticks, 0 * self.x_ticks]))[:, 0]
        for tick, x in zip(self.x_ticks, across, strict=True):
            yield text_at(x, bottom + 15, f"{tick:g}", 'text-anchor="middle"')
        up = self._on_page(np.column_stack([0 * self.y_ticks, self.y_ticks]))[:, 1]
        for tick, y in zip(self.y_ticks, up, strict=True):
            yield path("axis", f"M{_LEFT} {y:.1f}H{WIDTH - _RIGHT}")
            yield text_at(_LEFT - 6, y + 4, f"{tick:g}", 'text-anchor="end"')
        yield text_at(_LEFT + _INSIDE_WIDTH / 2, HEIGHT - 6, self.x_label, 'text-anchor="middle"')
        upright = f'text-anchor="middle" transform="rotate(-90 11 {middle:g})"'
        yield text_at(11, middle, self.y_label, upright)


def _ticks(low: float, high: float) -> FloatArray:
    # Counts have whole numbers; budgets may be cents.
    unit = 1.0 if high - low >= 1 else 10 ** np.floor(np.log10((high - low) / _MOST_TICKS))
    step = next(it * unit for it in round_numbers() if (high - low) / it / unit <= _MOST_TICKS)
    return np.arange(np.ceil(low / step) * step, high + 1e-9, step) + 0.0  # + 0.0: no -0
