"""Charts of a report as SVG: bars and dots that take their colours from the page.

Classes: ``mark series-1`` and ``series-2`` for what is drawn, ``axis`` for what it is held against.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting._bins import round_numbers
from reverie_eval.reporting._distributions import Histogram
from reverie_eval.scoring import Scores

WIDTH, HEIGHT = 400, 250
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 12, 10, 40
_MOST_TICKS = 7
_NEARLY_ALL = 99
"""Percent of walks that are shown: a few of hundreds of metres would hide all others."""


@dataclass(frozen=True, slots=True)
class _Axes:
    """Linear axes from the lower left corner."""

    low: float
    """Of what is shown across."""
    high: float
    top: float
    """Of what is shown upwards, from 0."""

    def x(self, values: FloatArray) -> FloatArray:
        inside = WIDTH - _LEFT - _RIGHT
        return _LEFT + (values - self.low) / (self.high - self.low) * inside

    def y(self, values: FloatArray) -> FloatArray:
        inside = HEIGHT - _TOP - _BOTTOM
        return HEIGHT - _BOTTOM - values / self.top * inside

    def drawn(self, across: str, upwards: str) -> Iterator[str]:
        """Draw lines, numbers and names of both axes."""
        bottom, middle = HEIGHT - _BOTTOM, (_TOP + HEIGHT - _BOTTOM) / 2
        for tick in _ticks(self.low, self.high):
            yield _text(float(self.x(tick)), bottom + 15, f"{tick:g}", "middle")
        for tick in _ticks(0, self.top):
            height = float(self.y(tick))
            yield f'<path class="axis" d="M{_LEFT} {height:.1f}H{WIDTH - _RIGHT}"/>'
            yield _text(_LEFT - 6, height + 4, f"{tick:g}", "end")
        yield _text((_LEFT + WIDTH - _RIGHT) / 2, HEIGHT - 6, across, "middle")
        turned = f' transform="rotate(-90 11 {middle:g})"'
        yield _text(11, middle, upwards, "middle", turned)


def histogram_svg(histogram: Histogram, names: Sequence[str]) -> str:
    """Draw a histogram: bars for the first submission, an outline for the second.

    Parameters
    ----------
    names : sequence of str
        Of all submissions; those that the histogram knows nothing of have no marks.
    """
    most = max(float(share.max()) for share in histogram.share.values())
    axes = _Axes(float(histogram.edges[0]), float(histogram.edges[-1]), 1.05 * most)
    marks = [
        _mark(axes, histogram.edges, histogram.share[name], number)
        for number, name in enumerate(names, 1)
        if name in histogram.share
    ]
    upwards = f"share of {histogram.nouns} (%)"
    title = f"Distribution of {histogram.label}"
    return _chart(title, [*axes.drawn(histogram.label, upwards), *marks])


def walks_svg(scores: Scores) -> str:
    """Draw the walked length of every episode over the shortest, a dot each."""
    walked, shortest = scores.episodes["path_length"], scores.episodes["shortest_length"]
    axes = _Axes(0.0, float(np.ceil(shortest.max())) or 1.0, farthest_shown(scores))
    is_shown = walked <= axes.top
    succeeded = scores.episodes["success"] > 0
    ends = np.array([0.0, min(axes.high, axes.top)])
    dots = [
        f'<path class="dot {kind}" d="{_dots(axes, shortest[part], walked[part])}"/>'
        for kind, part in (("miss", is_shown & ~succeeded), ("hit", is_shown & succeeded))
    ]
    x, y = axes.x(ends), axes.y(ends)
    line = f'<path class="diagonal" d="M{x[0]:.1f} {y[0]:.1f}L{x[1]:.1f} {y[1]:.1f}"/>'
    return _chart(
        "Walked length of every episode over the shortest length",
        [*axes.drawn("shortest length (m)", "walked length (m)"), *dots, line],
    )


def farthest_shown(scores: Scores) -> float:
    """Return how long a walk is, in metres, that :func:`walks_svg` still shows: nearly all are."""
    walked, shortest = scores.episodes["path_length"], scores.episodes["shortest_length"]
    most = max(float(np.percentile(walked, _NEARLY_ALL)), float(shortest.max()), 1.0)
    return float(np.ceil(most))


def _mark(axes: _Axes, edges: FloatArray, share: FloatArray, number: int) -> str:
    if number == 1:
        return f'<path class="mark series-1" d="{"".join(_bars(axes, edges, share))}"/>'
    return f'<path class="outline series-{number}" d="{_outline(axes, edges, share)}"/>'


def _bars(axes: _Axes, edges: FloatArray, share: FloatArray) -> Iterator[str]:
    left, right, top = axes.x(edges[:-1]), axes.x(edges[1:]), axes.y(share)
    for start, end, height in zip(left + 0.5, right - 0.5, top, strict=True):
        yield f"M{start:.1f} {HEIGHT - _BOTTOM}V{height:.1f}H{end:.1f}V{HEIGHT - _BOTTOM}z"


def _outline(axes: _Axes, edges: FloatArray, share: FloatArray) -> str:
    steps = zip(axes.y(share), axes.x(edges[1:]), strict=True)
    drawn = "".join(f"V{height:.1f}H{end:.1f}" for height, end in steps)
    return f"M{_LEFT} {HEIGHT - _BOTTOM}{drawn}V{HEIGHT - _BOTTOM}"


def _dots(axes: _Axes, across: FloatArray, upwards: FloatArray) -> str:
    places = zip(axes.x(across), axes.y(upwards), strict=True)
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places)


def _ticks(low: float, high: float) -> FloatArray:
    step = next(step for step in round_numbers() if (high - low) / step <= _MOST_TICKS)
    return np.arange(np.ceil(low / step) * step, high + 1e-9, step) + 0.0  # no -0


def _text(x: float, y: float, text: str, anchor: str, attributes: str = "") -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f"<text {place}{attributes}>{escape(text)}</text>"


def _chart(title: str, parts: Sequence[str]) -> str:
    opening = f'<svg class="chart" role="img" viewBox="0 0 {WIDTH} {HEIGHT}">'
    return f"{opening}<title>{escape(title)}</title>{''.join(parts)}</svg>"
