"""Lines by class, as maps and charts have them, drawn as SVG; those of charts with matplotlib too.

Each place that draws says what lines there are; how they look is said by the style sheets of pages
and, for matplotlib, by the one below. Colours are distinguishable with any colour vision: they are
from the palette of Okabe and Ito, "Color Universal Design", 2008.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from reverie_eval.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Lines = Mapping[str, Sequence[FloatArray]]
"""Lines by class, each through points of shape (n, 2); a single point is a dot."""
CLOSED = ("arrow", "sight", "mark", "band", "room", "base")
"""Lines that enclose an area, by the first word of their class."""
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY = "#CC79A7", "#56B4E9"
GREY, INK = "#B3BAC4", "#333333"


# SVG.


def path(kind: str, data: str, title: str = "") -> str:
    """Return a path of a class, with a tooltip if it has a title."""
    return element("path", f'class="{kind}" d="{data}"', title)


def element(name: str, attributes: str, title: str = "") -> str:
    """Return an element, with a tooltip if it has a title."""
    if not title:
        return f"<{name} {attributes}/>"
    return f"<{name} {attributes}><title>{escape(title)}</title></{name}>"


def text_at(x: float, y: float, text: str, attributes: str) -> str:
    """Return a text that begins at a point, or as its attributes say."""
    return f'<text x="{x:.1f}" y="{y:.1f}" {attributes}>{escape(text)}</text>'


def path_data(kind: str, lines: Sequence[FloatArray]) -> str:
    """Return the data of a path through lines of a class."""
    end = "z" if kind.startswith(CLOSED) else ""
    # A line of length 0 draws nothing but its round ends, which make a dot.
    return "".join(line_data(points) + ("h0" if len(points) == 1 else end) for points in lines)


def line_data(points: FloatArray) -> str:
    """Return the data of a line."""
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points.tolist())


def image_svg(
    kind: str,
    size: tuple[float, float],
    shapes: str,
    title: str,
    *,
    description: str = "",
    style: str = "",
) -> str:
    """Return a picture of a class, as wide as there is room, named for those who cannot see it.

    ``size`` is in units of the page. With a style sheet, it is a file; without one, it is for a
    page that has it.
    """
    width, height = size
    attributes = ' xmlns="http://www.w3.org/2000/svg"' if style else ""
    told = f"<desc>{escape(description)}</desc>" if description else ""
    sheet = f"<style>{style}</style>" if style else ""
    return (
        f'<svg class="{kind}" role="img" viewBox="0 0 {width:.0f} {height:.0f}"{attributes}>'
        f"<title>{escape(title)}</title>{told}{sheet}{shapes}</svg>"
    )


_LARGE = re.compile(r'<(?:image|g class="solids")[^>]*?(?:/>|>.*?</g>)', re.DOTALL)
"""Photographs, and the walls and furniture of a room or a level; none is in another."""


def share_repeated(page: str) -> str:
    """Let the large parts of drawings that a page repeats refer to where they are first.

    The first one stays where it is, with an id, so that it looks as before.

    Examples
    --------
    >>> share_repeated('<svg><image href="a"/></svg><svg><image href="a"/></svg>')
    '<svg><image id="drawn-1" href="a"/></svg><svg><use href="#drawn-1"/></svg>'
    """
    counts = Counter(_LARGE.findall(page))
    repeated = (part for part, count in counts.items() if count > 1)
    ids = {part: f"drawn-{number}" for number, part in enumerate(repeated, 1)}
    seen: set[str] = set()

    def shared(match: re.Match[str]) -> str:
        part = match[0]
        if part not in ids:
            return part
        if part in seen:
            return f'<use href="#{ids[part]}"/>'
        seen.add(part)
        name, rest = part.split(" ", 1)
        return f'{name} id="{ids[part]}" {rest}'

    return _LARGE.sub(shared, page)


# SVG whose places across are percentages.


def wide_svg(title: str, height: int, shapes: Iterable[str]) -> str:
    """Return a picture as wide as its page, with a name for those who cannot see it."""
    opening = f'<svg class="chart wide" role="img" width="100%" height="{height}">'
    return f"{opening}<title>{escape(title)}</title>{''.join(shapes)}</svg>"


def text_across(
    across: float, y: float, words: str, anchor: str = "start", kind: str = "tick"
) -> str:
    """Return a text of a class at a percentage of the width."""
    position = f'x="{across:.2f}%" y="{y:.1f}" text-anchor="{anchor}"'
    return f'<text class="{kind}" {position}>{escape(words)}</text>'


def line_across(y: float, name: str) -> str:
    """Return a line across, with its value at its left end."""
    position = f'x1="0" x2="100%" y1="{y:.1f}" y2="{y:.1f}"'
    return element("line", f'class="axis" {position}') + text_across(0, y - 3, name)


def steps(points: Sequence[tuple[float, float]], end: float) -> str:
    """Return the path data of a line that keeps each height until the next point, then an end."""
    more = "".join(f"H{x:.2f}V{y:.1f}" for x, y in points[1:])
    return f"M{points[0][0]:.2f} {points[0][1]:.1f}{more}H{end:.2f}"


def stretched_paths(height: int, lines: Iterable[tuple[str, str]]) -> str:
    """Return paths by class, whose places across are percentages; their lines stay as thick."""
    paths = "".join(
        element("path", f'class="{kind}" vector-effect="non-scaling-stroke" d="{data}"')
        for kind, data in lines
    )
    view = f'viewBox="0 0 100 {height}" preserveAspectRatio="none"'
    return f'<svg width="100%" height="{height}" {view}>{paths}</svg>'


# Matplotlib.


# The style sheet, as `map.css` and `report.css` are those of pages.
_LOOKS: Mapping[str, dict[str, Any]] = MappingProxyType(
    {
        "series-1": {"color": BLUE},
        "series-2": {"color": VERMILION},
        "series-3": {"color": GREEN},
        "series-4": {"color": PURPLE},
        "series-5": {"color": ORANGE},
        "series-6": {"color": SKY},
        "band": {"alpha": 0.2, "linewidth": 0},
        "mark": {"color": BLUE, "linewidth": 0},
        "dot": {
            "marker": "o",
            "markersize": 4,
            "markeredgewidth": 0,
            "linestyle": "none",
            "alpha": 0.6,
        },
        "dot miss": {"color": GREY},
        "dot hit": {"color": BLUE},
        "diagonal": {"color": INK, "linestyle": "--", "linewidth": 1.2},
    }
)


def _look_of(kind: str) -> dict[str, Any]:
    """Return how matplotlib draws lines or marks of a class: an entry applies to all its classes.

    Later entries of the style sheet win.
    """
    classes = set(kind.split())
    look: dict[str, Any] = {}
    for selector, properties in _LOOKS.items():
        if classes.issuperset(selector.split()):
            look |= properties
    return look


def draw_lines(lines: Lines, axes: "Axes", key: Mapping[str, str]) -> None:
    """Draw lines with matplotlib; ``key`` has what the classes in the legend mean."""
    for kind, several in lines.items():
        look = {"label": key.get(kind), **_look_of(kind)}
        if kind.startswith(CLOSED):
            for outline in several:
                axes.fill(*outline.T, **look)
        else:
            axes.plot(*_with_gaps(several).T, **look)


def _with_gaps(lines: Sequence[FloatArray]) -> FloatArray:
    """Return the points of several lines, with a row of NaN between them, which leaves a gap."""
    gap = np.full((1, 2), np.nan)
    return np.vstack([rows for line in lines for rows in (line, gap)])
