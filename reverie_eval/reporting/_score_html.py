"""A score table as a notebook shows it."""

from reverie_eval.reporting._grids import Grid
from reverie_eval.reporting._html_tables import table_html
from reverie_eval.reporting._tables import table_of
from reverie_eval.scoring import Scores


def scores_html(scores: Scores) -> str:
    """Show the scores with what they depend on, and with their intervals if there are any."""
    table = table_of([scores])
    names = frozenset({0} if table.has_names else ())
    return table_html(Grid(table.headings, table.rows, names), table.captions)
