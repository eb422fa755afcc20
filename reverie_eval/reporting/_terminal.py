"""The score table on a terminal: across where it fits, down where it does not."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable

from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC
from reverie_eval.reporting._grids import room_for
from reverie_eval.reporting._tables import MARK, Table, table_of
from reverie_eval.scoring import Scores

_PRIMARY = CATALOGUE[PRIMARY_METRIC].heading


def show(results: Sequence[Scores], console: Console) -> None:
    """Print the score table with its signature."""
    show_table(table_of(results), console)


def show_table(table: Table, console: Console) -> None:
    """Print a table that is in words already, as :func:`show` does."""
    across = _across(table)
    fits = room_for(across, console).maximum <= console.width
    console.print(across if fits else _down(table))
    for caption in table.captions:
        console.print(caption, style="dim", markup=False, highlight=False, soft_wrap=True)


def _across(table: Table) -> RichTable:
    grid = RichTable(box=SIMPLE_HEAD)
    for number, heading in enumerate(table.headings):
        justify = "left" if table.has_names and number == 0 else "right"
        style = "bold" if heading == _PRIMARY else ""
        grid.add_column(heading, justify=justify, no_wrap=True, style=style)  # type: ignore[arg-type]
    for row in table.rows:
        grid.add_row(*map(_highlighted, row))
    return grid


def _down(table: Table) -> RichTable:
    grid = RichTable(box=None, show_header=False)
    for number, row in enumerate(table.rows):
        if number:
            grid.add_row("", "")
        for heading, cell in zip(table.headings, row, strict=True):
            grid.add_row(heading, _highlighted(cell), style="bold" if heading == _PRIMARY else "")
    grid.columns[1].justify = "right"
    return grid


def _highlighted(cell: str) -> str:
    """Show what is marked in colour too."""
    return f"[yellow]{cell}[/yellow]" if cell.endswith(MARK) else cell
