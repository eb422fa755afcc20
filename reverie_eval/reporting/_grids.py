"""Tables in words, laid out for a pipe or for a terminal."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table


_ANY_WIDTH = 1000
_LEAST_WORDS = 12
"""Letters: no column is wrapped to fewer."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A table in words, ready to be laid out."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    to_the_left: frozenset[int]
    """Columns of words; the others are numbers."""

    @property
    def wrapped(self) -> int:
        """The column that gives way where there is no room for all: the last one of words."""
        return max(self.to_the_left)


def aligned(grid: Grid) -> str:
    """Lay out columns without decoration, for a pipe or a file.

    >>> print(aligned(Grid(["what", "number"], [["scans", "7"], ["edges", "321"]], frozenset({0}))))
    what   number
    scans       7
    edges     321
    """
    cells = [grid.headings, *grid.rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if number in grid.to_the_left else cell.rjust(width)
            for number, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in cells
    ]
    return "\n".join(line.rstrip() for line in lines)


def room_for(table: "Table", console: "Console") -> "Measurement":
    """Return the fewest and the most columns that a table takes, however many there are."""
    return console.measure(table, options=console.options.update_width(_ANY_WIDTH))


def show_grid(grid: Grid, console: "Console") -> None:
    """Print a table on a terminal, wrapped where it does not fit.

    Where not even that helps, the terminal breaks the lines: nothing is cut.
    """
    if room_for(rich_table(_narrowest(grid)), console).maximum <= console.width:
        console.print(rich_table(grid))
    else:
        console.print(aligned(grid), end="\n\n", markup=False, highlight=False, soft_wrap=True)


def rich_table(grid: Grid) -> "Table":
    """Lay out columns for a terminal; where they do not fit, the last one of words is wrapped."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD)
    for number, heading in enumerate(grid.headings):
        justify = "left" if number in grid.to_the_left else "right"
        no_wrap = number != grid.wrapped
        table.add_column(heading, justify=justify, no_wrap=no_wrap, overflow="fold")  # type: ignore[arg-type]
    for row in grid.rows:
        table.add_row(*map(Text, row))
    return table


def _narrowest(grid: Grid) -> Grid:
    """Return a grid as wide as another one that is wrapped as far as it may be."""
    rows = [
        [cell[:_LEAST_WORDS] if number == grid.wrapped else cell for number, cell in enumerate(row)]
        for row in grid.rows
    ]
    return replace(grid, rows=rows)
