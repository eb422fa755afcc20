"""Leaderboards in words: a row per published result, its numbers and what to know of its method."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting._grids import Grid, aligned, rich_table, room_for
from reverie_eval.schemas.service import Leaderboard, LeaderboardRow, Method
from reverie_eval.text import printable

if TYPE_CHECKING:
    from rich.console import Console


FLAGS = {
    "extra_data": "extra data",
    "pre_exploration": "pre-exploration",
    "ground_truth_objects": "ground-truth objects",
    "ensemble": "ensemble",
}
"""What a reader must know to compare a method with others, in words."""
_STANDINGS = {
    "reported": "reported, not scored",
    "other-rules": "scored by other rules",
    "disqualified": "disqualified",
}
"""Why a result takes no part in the ranking, in words."""
_WARNINGS = ("flagged", "disqualified")
_FINGERPRINT_SHOWN = 12


def leaderboard_grid(board: Leaderboard) -> Grid:
    """Word a leaderboard: headline metrics, and the one that it is sorted by.

    What takes no part in the ranking comes last, without a rank.
    """
    metrics = _metrics(board)
    headings = ["rank", "team", "method", *(m.heading for m in metrics), "sent", "on", "remarks"]
    rows = [
        [
            _rank(row),
            *_names(row),
            *_values(row, metrics),
            "-" if row.submissions is None else str(row.submissions),
            f"{row.published_at:%Y-%m-%d}",
            ", ".join(_remarks(row)),
        ]
        for row in _all_rows(board)
    ]
    return Grid(headings, rows, frozenset({1, 2, len(headings) - 1}))


def narrow_leaderboard_grid(board: Leaderboard) -> Grid:
    """Word the same with all words in one last column, which can be wrapped."""
    metrics = _metrics(board)
    headings = ["rank", *(m.heading for m in metrics), "team: method"]
    rows = [[_rank(row), *_values(row, metrics), _in_words(row)] for row in _all_rows(board)]
    return Grid(headings, rows, frozenset({len(headings) - 1}))


def show_leaderboard(board: Leaderboard, console: "Console") -> None:
    """Print a leaderboard on a terminal: in one line a row, or with the words beside the numbers.

    Where not even that fits, the terminal breaks the lines: nothing is left out.
    """
    grid = leaderboard_grid(board)
    wide, narrow = rich_table(grid), rich_table(narrow_leaderboard_grid(board))
    if room_for(wide, console).maximum <= console.width:
        console.print(wide)
    elif room_for(narrow, console).minimum <= console.width:
        console.print(narrow)
    else:
        console.print(aligned(grid), markup=False, highlight=False, soft_wrap=True)


def leaderboard_captions(board: Leaderboard) -> Sequence[str]:
    """Say what a leaderboard's numbers depend on, and what the organiser warns of."""
    metric = CATALOGUE.get(board.metric)
    label = metric.label if metric else board.metric
    data = board.fingerprint[:_FINGERPRINT_SHOWN]
    about = f"split:{board.split}|protocol:{board.protocol}|data:{data}, sorted by {label}"
    empty = [] if _all_rows(board) else ["nothing is published yet"]
    warnings = [
        printable(f"{review.verdict}: {row.method.name} ({review.reviewer}: {review.reason})")
        for row in _all_rows(board)
        for review in row.reviews
        if review.verdict in _WARNINGS
    ]
    return [printable(about), *empty, *warnings]


def flags_of(method: Method) -> Sequence[str]:
    """Name what a reader must know to compare a method with others."""
    return [words for name, words in FLAGS.items() if getattr(method, name)]


def _all_rows(board: Leaderboard) -> Sequence[LeaderboardRow]:
    return [*board.rows, *board.apart]


def _remarks(row: LeaderboardRow) -> Sequence[str]:
    """Say why a result is not ranked, what the organiser says of it, and what of its method."""
    standing = [] if row.standing == "ranked" else [_STANDINGS[row.standing]]
    verdicts = [review.verdict for review in row.reviews if review.verdict not in standing]
    return [*standing, *verdicts, *flags_of(row.method)]


def _metrics(board: Leaderboard) -> Sequence[Metric]:
    present: set[str] = set().union(*(row.scores for row in _all_rows(board)))
    return [
        metric
        for key, metric in CATALOGUE.items()
        if (metric.headline or key == board.metric) and key in present
    ]


def _rank(row: LeaderboardRow) -> str:
    return "-" if row.rank is None else str(row.rank)


def _names(row: LeaderboardRow) -> tuple[str, str]:
    return printable(row.team) or "(anonymous)", printable(row.method.name)


def _values(row: LeaderboardRow, metrics: Sequence[Metric]) -> Sequence[str]:
    return [m.display(row.scores[m.key]) if m.key in row.scores else "-" for m in metrics]


def _in_words(row: LeaderboardRow) -> str:
    team, method = _names(row)
    sent = [] if row.submissions is None else [f"{row.submissions} sent"]
    about = [*sent, f"{row.published_at:%Y-%m-%d}", *_remarks(row)]
    return f"{team}: {method} ({', '.join(about)})"
