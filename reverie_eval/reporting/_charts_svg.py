"""Charts as SVG for the HTML report; their colours come from the page.

Classes: ``mark series-1`` and ``outline series-2`` for submissions, ``dot`` for episodes, ``axis``
for grid lines.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.reporting._charts import Histogram, Walks, round_numbers

WIDTH, HEIGHT = 400, 250
_LEFT, _RIGHT, _TOP, _BOTTOM = 42, 12, 10, 40
_MOST_TICKS = 7


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
    grid = axes.grid(histogram.label, f"share of {histogram.noun} (%)")
    return _chart(f"Distribution of {histogram.label}", [*grid, *drawn])


def walks_svg(walks: Walks) -> str:
    """Draw a dot for every episode: the walked length against the shortest length."""
    axes = _Axes(0.0, float(np.ceil(walks.shortest.max())) or 1.0, walks.longest_shown)
    dots = [
        f'<path class="dot {kind}" d="{axes.dots(walks.shortest[part], walks.walked[part])}"/>'
        for kind, part in (
            ("miss", walks.is_shown & ~walks.is_success),
            ("hit", walks.is_shown & walks.is_success),
        )
    ]
    ends = np.array([0.0, min(axes.high, axes.top)])
    x, y = axes.x(ends), axes.y(ends)
    line = f'<path class="diagonal" d="M{x[0]:.1f} {y[0]:.1f}L{x[1]:.1f} {y[1]:.1f}"/>'
    grid = axes.grid("shortest length (m)", "walked length (m)")
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
        places = zip(self.x(x), self.y(y), strict=True)
        return "".join(f"M{across:.1f} {up:.1f}h0" for across, up in places)


def _ticks(low: float, high: float) -> FloatArray:
    step = next(step for step in round_numbers() if (high - low) / step <= _MOST_TICKS)
    return np.arange(np.ceil(low / step) * step, high + 1e-9, step) + 0.0  # + 0.0: no -0


def _text(x: float, y: float, text: str, anchor: str, attributes: str = "") -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f"<text {place}{attributes}>{escape(text)}</text>"


def _chart(title: str, parts: Sequence[str]) -> str:
    opening = f'<svg class="chart" role="img" viewBox="0 0 {WIDTH} {HEIGHT}">'
    return f"{opening}<title>{escape(title)}</title>{''.join(parts)}</svg>"
