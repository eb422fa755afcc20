"""Tables in words as HTML, for pages and notebooks; everything is escaped."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING

from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting._grids import Grid

if TYPE_CHECKING:
    from markupsafe import Markup


_MEANINGS: Mapping[str, str] = MappingProxyType(
    {metric.heading: f"{metric.name}: {metric.definition}" for metric in CATALOGUE.values()}
)


def table_html(grid: Grid, captions: Sequence[str] = ()) -> str:
    """Lay out a table, with captions below whose first is code.

    Columns to the left name their rows; an empty row parts those above it from those below. A
    heading that is a metric's says on touch what the metric is.
    """
    return "".join(
        [
            "<table>",
            _caption(captions),
            "<thead><tr>",
            *(_heading(grid, column) for column in range(len(grid.headings))),
            "</tr></thead><tbody>",
            *_rows(grid),
            "</tbody></table>",
        ]
    )


def as_markup(html: str) -> "Markup":
    """Take what was escaped where it was made for what it is, in a template."""
    from markupsafe import Markup

    return Markup(html)  # noqa: S704  # that is this function's whole meaning


def _caption(captions: Sequence[str]) -> str:
    if not captions:
        return ""
    first, *others = map(escape, captions)
    lines = "<br>".join([f"<code>{first}</code>", *others])
    return f'<caption style="caption-side: bottom; text-align: left">{lines}</caption>'


def _heading(grid: Grid, column: int) -> str:
    heading = grid.headings[column]
    if heading not in _MEANINGS:
        return f"<th>{escape(heading)}</th>"
    return f'<th title="{escape(_MEANINGS[heading])}">{escape(heading)}</th>'


def _rows(grid: Grid) -> Iterator[str]:
    for row in grid.rows:
        if any(row):
            cells = "".join(_cell(grid, column, cell) for column, cell in enumerate(row))
            yield f"<tr>{cells}</tr>"
        else:
            yield "</tbody><tbody>"


def _cell(grid: Grid, column: int, cell: str) -> str:
    if column in grid.to_the_left:
        return f'<th scope="row" style="text-align: left">{escape(cell)}</th>'
    return f"<td>{escape(cell)}</td>"
