"""The score table on a terminal: across where it fits, down where it does not."""

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.reporting.tables import captions
from reverie_eval.scores import Scores

_ANY_WIDTH = 1000


def show(scores: Scores, console: Console) -> None:
    """Print the score table with its signature."""
    table = _across(scores)
    unbounded = console.options.update_width(_ANY_WIDTH)
    fits = console.measure(table, options=unbounded).maximum <= console.width
    console.print(table if fits else _down(scores))
    for caption in captions(scores):
        console.print(caption, style="dim", markup=False, highlight=False, soft_wrap=True)


def _across(scores: Scores) -> Table:
    table = Table(box=SIMPLE_HEAD)
    for metric in scores.headline:
        table.add_column(metric.heading, justify="right", no_wrap=True, style=_style(metric.key))
    table.add_row(*(metric.display(scores[metric.key]) for metric in scores.headline))
    return table


def _down(scores: Scores) -> Table:
    table = Table(box=None, show_header=False)
    for metric in scores.headline:
        value = metric.display(scores[metric.key])
        table.add_row(metric.heading, value, style=_style(metric.key))
    table.columns[1].justify = "right"
    return table


def _style(key: str) -> str:
    return "bold" if key == PRIMARY_METRIC else ""
