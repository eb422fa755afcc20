"""A board as papers take it: a table for LaTeX, entries for BibTeX."""

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from urllib.parse import urljoin

from reverie_eval.metrics import Metric
from reverie_eval.reporting._results import methods_table
from reverie_eval.reporting._table import latex_comments, latex_text
from reverie_eval.server.service.leaderboard import Ranking
from reverie_eval.server.service.standings import Row

_BRACES = {"{": r"\textbraceleft{}", "}": r"\textbraceright{}"}
"""BibTeX counts braces, also those with a backslash before them."""
_ANONYMOUS = "Anonymous"


def as_latex(ranking: Ranking, rows: Sequence[Row], metrics: Sequence[Metric], address: str) -> str:
    """Return the rows as a table for LaTeX's booktabs package, the best of each column in bold.

    Without a row, or a metric that any row has, there is no table: LaTeX cannot set one without
    columns.
    """
    board = ranking.board
    if not metrics:
        return (
            "\n".join(latex_comments([f"No result of {board.name} is shown at {address}"])) + "\n"
        )
    methods = {
        name: [row.entry.scores] for name, row in zip(_names(ranking, rows), rows, strict=True)
    }
    caption = f"Leaderboard of {board.name}: {board.signature}. {address}"
    return methods_table(methods, [board.name], metrics, caption).to_latex() + "\n"


def _names(ranking: Ranking, rows: Sequence[Row]) -> Sequence[str]:
    """Name methods; who has one of the same name is told apart by its team, then by its number."""
    methods = [row.entry.method["name"] for row in rows]
    named = _told_apart(methods, [ranking.team(row.entry) or _ANONYMOUS.lower() for row in rows])
    return _told_apart(named, [row.entry.submission_id or str(row.rank) for row in rows])


def _told_apart(names: Sequence[str], by: Sequence[str]) -> Sequence[str]:
    counts = Counter(names)
    return [
        f"{name} ({more})" if counts[name] > 1 else name
        for name, more in zip(names, by, strict=True)
    ]


def as_bibtex(ranking: Ranking, rows: Sequence[Row], title: str, address: str) -> str:
    """Return an entry for the board as it is now, and one for each row."""
    board, today = ranking.board, ranking.now.astimezone(UTC)
    of_board = _entry(
        f"reverie-{board.name}-{today:%Y-%m-%d}",
        author=title,
        title=f"Leaderboard of {board.name}",
        address=address,
        at=today,
        note=f"{board.signature}, as of {today:%Y-%m-%d}",
    )
    return "\n".join([of_board, *(_of_row(ranking, row, title, address) for row in rows)])


def _of_row(ranking: Ranking, row: Row, title: str, address: str) -> str:
    entry = row.entry
    return _entry(
        f"reverie-{entry.submission_id}",
        author=ranking.team(entry) or _ANONYMOUS,
        title=entry.method["name"],
        address=urljoin(address, f"/submissions/{entry.submission_id}"),
        at=entry.published_at,
        note=f"{title}, {entry.signature}",
    )


def _entry(key: str, *, author: str, title: str, address: str, at: datetime, note: str) -> str:
    lines = [
        f"@misc{{{_key(key)},",
        f"  author = {{{{{_text(author)}}}}},",
        f"  title = {{{{{_text(title)}}}}},",
        f"  year = {{{at:%Y}}},",
        f"  howpublished = {{\\url{{{address}}}}},",
        f"  note = {{{_text(note)}}},",
        "}",
    ]
    return "\n".join(lines) + "\n"


def _key(text: str) -> str:
    """Keep what every BibTeX takes in a key."""
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in text)


def _text(text: str) -> str:
    """Write a text so that BibTeX and then LaTeX show it as it is."""
    return "".join(_BRACES.get(letter) or latex_text(letter) for letter in text)
