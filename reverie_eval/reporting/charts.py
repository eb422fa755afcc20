"""The data of charts, and charts as SVG for the report; notebooks draw them with matplotlib.

The colours of SVG come from the page. Classes: ``mark series-1`` and ``outline series-2`` for
submissions, ``dot`` for episodes, ``axis`` for grid lines.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import count
from types import MappingProxyType

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.metrics import CATALOGUE, Metric, Unit
from reverie_eval.scoring import Scores

_MOST_BARS = 60
_SHOWN_WALKS = 99
"""Percent of the walks that a chart shows: a few walks of hundreds of metres would squeeze all
others together."""
_MILLIMETRE = 1e-3
WIDTH, HEIGHT = 400, 250
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 12, 10, 40
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

        ``scores`` are by the submissions' names. A metric that is not scored is a KeyError.
        """
        values = {name: each.episodes[key] for name, each in scores.items()}
        metric = CATALOGUE[key]
        is_of_boxes = "box" in metric.needs
        if is_of_boxes:
            boxes = {name: each.boxes for name, each in scores.items() if each.boxes is not None}
            values |= {name: values[name][each.row] for name, each in boxes.items()}
        if metric.is_partial:
            values = {name: each[~np.isnan(each)] for name, each in values.items()}
        scale = 100 if metric.unit == "fraction" else 1
        shown = {name: scale * each for name, each in values.items()}
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

    @property
    def share_label(self) -> str:
        """What the heights of the bars are."""
        return f"share of {self.noun} (%)"


@dataclass(frozen=True, eq=False)
class Walks:
    """Walked and shortest length of every episode; all shapes are (n_episodes,)."""

    shortest: FloatArray
    """Metres."""
    walked: FloatArray
    """Metres."""
    is_success: BoolArray
    labels = "shortest length (m)", "walked length (m)"
    """What a chart has to the right and up."""

    @classmethod
    def of(cls, scores: Scores) -> Self:
        """Take the lengths from a submission's scores."""
        episodes = scores.episodes
        is_success = episodes["success"] > 0
        return cls(episodes["shortest_length"], episodes["path_length"], is_success)

    @property
    def parts(self) -> Sequence[tuple[str, str, BoolArray]]:
        """The class of the dots, its meaning and its episodes; what is drawn last is on top."""
        hits = self.is_success
        return ("miss", "stopped elsewhere", ~hits), ("hit", "stopped at the goal", hits)

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


def histogram_svg(histogram: Histogram, names: Sequence[str]) -> str:
    """Draw a histogram: bars for the first submission, an outline for the second.

    ``names`` are those of all submissions, also of one without values in the histogram.
    """
    most = max(float(share.max()) for share in histogram.share.values())
    axes = _Axes(float(histogram.edges[0]), float(histogram.edges[-1]), 1.05 * most)
    drawn = [
        axes.bars(histogram.edges, share) if number == 1 else axes.outline(histogram.edges, share)
        for number, name in enumerate(names, 1)
        if (share := histogram.share.get(name)) is not None
    ]
    grid = axes.grid(histogram.label, histogram.share_label)
    return _chart(f"Distribution of {histogram.label}", [*grid, *drawn])


def walks_svg(walks: Walks) -> str:
    """Draw a dot for every episode: the walked length against the shortest length."""
    axes = _Axes(0.0, float(np.ceil(walks.shortest.max())) or 1.0, walks.longest_shown)
    dots = [
        f'<path class="dot {kind}" d="{axes.dots(walks.shortest[shown], walks.walked[shown])}"/>'
        for kind, _, part in walks.parts
        for shown in [part & walks.is_shown]
    ]
    ends = np.array([0.0, min(axes.high, axes.top)])
    x, y = axes.x(ends), axes.y(ends)
    line = f'<path class="diagonal" d="M{x[0]:.1f} {y[0]:.1f}L{x[1]:.1f} {y[1]:.1f}"/>'
    grid = axes.grid(*walks.labels)
    return _chart("Walked length of every episode over the shortest length", [*grid, *dots, line])


@dataclass(frozen=True, slots=True)
class _Axes:
    """Linear axes; values go to the right from ``low`` to ``high`` and up from 0 to ``top``."""

    low: float
    high: float
    top: float

    def x(self, values: FloatArray) -> FloatArray:
        """Return the horizontal positions of values."""
        inside = WIDTH - _LEFT - _RIGHT
        return _LEFT + (values - self.low) / (self.high - self.low) * inside

    def y(self, values: FloatArray) -> FloatArray:
        """Return the vertical positions of values."""
        inside = HEIGHT - _TOP - _BOTTOM
        return HEIGHT - _BOTTOM - values / self.top * inside

    def grid(self, x_label: str, y_label: str) -> Iterator[str]:
        """Draw the grid lines, numbers and labels of both axes."""
        bottom, middle = HEIGHT - _BOTTOM, (_TOP + HEIGHT - _BOTTOM) / 2
        for tick in _ticks(self.low, self.high):
            yield _text(float(self.x(tick)), bottom + 15, f"{tick:g}", "middle")
        for tick in _ticks(0, self.top):
            height = float(self.y(tick))
            yield f'<path class="axis" d="M{_LEFT} {height:.1f}H{WIDTH - _RIGHT}"/>'
            yield _text(_LEFT - 6, height + 4, f"{tick:g}", "end")
        yield _text((_LEFT + WIDTH - _RIGHT) / 2, HEIGHT - 6, x_label, "middle")
        upright = f' transform="rotate(-90 11 {middle:g})"'
        yield _text(11, middle, y_label, "middle", upright)

    def bars(self, edges: FloatArray, share: FloatArray) -> str:
        """Draw the first submission's bars, with a gap between them."""
        bottom = HEIGHT - _BOTTOM
        # Half a unit on either side makes the gap.
        spans = zip(self.x(edges[:-1]) + 0.5, self.x(edges[1:]) - 0.5, self.y(share), strict=True)
        bars = (f"M{x:.1f} {bottom}V{top:.1f}H{end:.1f}V{bottom}z" for x, end, top in spans)
        return f'<path class="mark series-1" d="{"".join(bars)}"/>'

    def outline(self, edges: FloatArray, share: FloatArray) -> str:
        """Draw the second submission's bars as one line around them."""
        bottom = HEIGHT - _BOTTOM
        tops = zip(self.x(edges[1:]), self.y(share), strict=True)
        steps = "".join(f"V{top:.1f}H{end:.1f}" for end, top in tops)
        return f'<path class="outline series-2" d="M{_LEFT} {bottom}{steps}V{bottom}"/>'

    def dots(self, x: FloatArray, y: FloatArray) -> str:
        """Return a path's data: at each point a line of length 0, whose round ends make a dot."""
        points = zip(self.x(x), self.y(y), strict=True)
        return "".join(f"M{across:.1f} {up:.1f}h0" for across, up in points)


def _ticks(low: float, high: float) -> FloatArray:
    step = next(step for step in round_numbers() if (high - low) / step <= _MOST_TICKS)
    return np.arange(np.ceil(low / step) * step, high + 1e-9, step) + 0.0  # + 0.0: no -0


def _text(x: float, y: float, text: str, anchor: str, attributes: str = "") -> str:
    position = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f"<text {position}{attributes}>{escape(text)}</text>"


def _chart(title: str, parts: Sequence[str]) -> str:
    opening = f'<svg class="chart" role="img" viewBox="0 0 {WIDTH} {HEIGHT}">'
    return f"{opening}<title>{escape(title)}</title>{''.join(parts)}</svg>"
