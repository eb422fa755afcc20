"""Tables in words, laid out for a pipe or for a terminal."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True, slots=True)
class Grid:
    """A table in words, ready to be laid out."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    to_the_left: frozenset[int]
    """Columns of words; the others are numbers."""


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


def rich_table(grid: Grid) -> "Table":
    """Lay out columns for a terminal; where they do not fit, the last one is wrapped first."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD)
    last = len(grid.headings) - 1
    for number, heading in enumerate(grid.headings):
        justify = "left" if number in grid.to_the_left else "right"
        table.add_column(heading, justify=justify, no_wrap=number < last)  # type: ignore[arg-type]
    for row in grid.rows:
        table.add_row(*map(Text, row))
    return table
