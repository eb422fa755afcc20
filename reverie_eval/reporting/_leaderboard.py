"""A leaderboard as a table: a row per published result, its scores and notes on its method."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting._submission import headline_of, known_task
from reverie_eval.reporting._table import (
    MISSING,
    Table,
    cell_of,
    metric_cells,
    print_lines,
    print_table,
)
from reverie_eval.schemas.service import Leaderboard, LeaderboardRow
from reverie_eval.tasks import Task
from reverie_eval.text import count_text, printable

if TYPE_CHECKING:
    from rich.console import Console


METHOD_FLAGS = {
    "extra_data": "extra data",
    "pre_exploration": "pre-exploration",
    "ground_truth_objects": "ground-truth objects",
    "ensemble": "ensemble",
    "navigation_only": "navigation only",
    "human": "human",
}
"""What a reader must know to compare a method with others."""
OBJECT_FLAGS = frozenset({"ground_truth_objects", "navigation_only"})
"""Flags that matter only if methods also predict objects."""
_STANDINGS = {
    "reported": "reported, not scored",
    "other-dataset": "reported on {dataset}, not scored",
    "other-rules": "scored under other rules",
    "disqualified": "disqualified",
}
"""Why a result is not ranked."""
_WARNINGS = ("flagged", "disqualified")
_FINGERPRINT_SHOWN = 12


def flags_of(tasks: Sequence[Task], required: Collection[str] = ()) -> Mapping[str, str]:
    """Return the flags of methods for some tasks, and those that a server requires."""
    has_targets = any(task.has_targets for task in tasks)
    return {
        flag: words
        for flag, words in METHOD_FLAGS.items()
        if has_targets or flag not in OBJECT_FLAGS or flag in required
    }


def undeclared_of(method: Mapping[str, Any], flags: Mapping[str, str]) -> Sequence[str]:
    """Return what nobody has declared of a method, in words."""
    return [words for flag, words in flags.items() if method.get(flag) is None]


def leaderboard_table(board: Leaderboard) -> Table:
    """Return a leaderboard with its headline metrics and the one that it is sorted by.

    Reported results are among the others, without a rank; results that are not comparable come
    last.
    """
    metrics, flags = _metrics(board), _flags(board)
    columns = [metric.heading for metric in metrics]
    headings = ["rank", "team", "method", *columns, "entries", "published", "notes"]
    rows = [
        [
            cell_of(row.rank),
            *_names(row),
            *metric_cells(metrics, row.scores),
            cell_of(row.submissions),
            _date(row) or MISSING,
            ", ".join(_row_notes(row, flags)),
        ]
        for row in _all_rows(board)
    ]
    text_columns = frozenset({1, 2, len(headings) - 1})
    return Table(headings, rows, text_columns, notes=_board_notes(board))


def narrow_leaderboard_table(board: Leaderboard) -> Table:
    """Return the same table with all text in the last column, which can be wrapped."""
    metrics, flags = _metrics(board), _flags(board)
    headings = ["rank", *(m.heading for m in metrics), "team: method"]
    rows = [
        [cell_of(row.rank), *metric_cells(metrics, row.scores), _description(row, flags)]
        for row in _all_rows(board)
    ]
    return Table(headings, rows, frozenset({len(headings) - 1}), notes=_board_notes(board))


def leaderboard_text(board: Leaderboard) -> str:
    """Return a leaderboard in aligned columns, for a pipe or a file."""
    table = leaderboard_table(board)
    return table.to_text() if table.rows else "\n".join(table.notes)


def print_leaderboard(console: "Console", board: Leaderboard) -> None:
    """Print a leaderboard on a terminal, with all text in one column if it is narrow."""
    table = leaderboard_table(board)
    if table.rows:
        print_table(console, table, narrow_leaderboard_table(board))
    else:
        print_lines(console, table.notes, style="dim")


def _board_notes(board: Leaderboard) -> Sequence[str]:
    """Return what the scores depend on, and the organiser's warnings."""
    metric = CATALOGUE.get(board.metric)
    label = metric.label if metric else board.metric
    data = board.fingerprint[:_FINGERPRINT_SHOWN]
    track = "track:grounding|" if "|track:grounding|" in board.signature else ""
    about = f"split:{board.split}|protocol:{board.protocol}|{track}data:{data}, sorted by {label}"
    empty = [] if _all_rows(board) else ["no results are published yet"]
    warnings = [
        printable(f"{review.verdict}: {row.method.name} ({review.reviewer}: {review.reason})")
        for row in _all_rows(board)
        for review in row.reviews
        if review.verdict in _WARNINGS
    ]
    return [printable(about), *empty, *warnings]


def _all_rows(board: Leaderboard) -> Sequence[LeaderboardRow]:
    return [*board.rows, *board.apart]


def _metrics(board: Leaderboard) -> Sequence[Metric]:
    present: set[str] = set().union(*(row.scores for row in _all_rows(board)))
    shown = list(headline_of(board.signature, present))
    sorted_by = CATALOGUE.get(board.metric)
    if sorted_by and sorted_by.key in present and sorted_by not in shown:
        shown.append(sorted_by)
    return shown


def _flags(board: Leaderboard) -> Mapping[str, str]:
    """Return the flags that matter on a leaderboard; all of them if its task is not installed."""
    task = known_task(board.signature)
    return METHOD_FLAGS if task is None else flags_of([task])


def _date(row: LeaderboardRow) -> str:
    """Return when a result was published, or reported; empty if that is not known."""
    if row.submission_id is None:
        return row.reported_date or ""
    return f"{row.published_at:%Y-%m-%d}"


def _names(row: LeaderboardRow) -> tuple[str, str]:
    return printable(row.team) or "(anonymous)", printable(row.method.name)


def _row_notes(row: LeaderboardRow, flags: Mapping[str, str]) -> Sequence[str]:
    """Return why a result is not ranked, the organiser's verdicts, and what its method declares.

    What was not declared comes last, because it may be a list of its own.
    """
    standing = [] if row.standing == "ranked" else [_STANDINGS[row.standing]]
    standing = [text.format(dataset=printable(row.dataset)) for text in standing]
    verdicts = [review.verdict for review in row.reviews if review.verdict not in standing]
    method = row.method.model_dump()
    declared = [words for flag, words in flags.items() if method[flag]]
    undeclared = undeclared_of(method, flags)
    if len(undeclared) == len(flags):
        return [*standing, *verdicts, "nothing declared"]
    missing = [f"not declared: {', '.join(undeclared)}"] if undeclared else []
    return [*standing, *verdicts, *declared, *missing]


def _description(row: LeaderboardRow, flags: Mapping[str, str]) -> str:
    team, method = _names(row)
    entries = [] if row.submissions is None else [count_text(row.submissions, "entry", "entries")]
    about = [*entries, *filter(None, [_date(row)]), *_row_notes(row, flags)]
    return f"{team}: {method} ({', '.join(about)})"
