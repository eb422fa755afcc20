"""The leaderboard: what teams have published, ranked by any metric."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from math import inf
from typing import Any

import msgspec
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.schemas.service import Method
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.standings import Entry, Row, Standings

SORTABLE = tuple(key for key, metric in CATALOGUE.items() if metric.better != "neither")
"""Metrics of which one direction is better."""

_ABOUT = ("rank", "submission_id", "team", "published_at", "submissions")
_OF_METHOD = tuple(name for name in Method.model_fields if name != "description")
_STANDING = ("standing", "reviews", "source", "signature")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True, slots=True)
class Ranking:
    """A board, ranked by a metric."""

    board: Board
    metric: str
    rows: Sequence[Row]
    apart: Sequence[Row]
    """What takes no part in the ranking."""
    metrics: frozenset[str]
    """That any row has."""
    now: datetime
    counts: Mapping[int, int]
    """How many submissions each team has made to the split."""

    def team(self, entry: Entry) -> str:
        """Return whose an entry is; empty while its team is anonymous."""
        return "" if self._is_anonymous(entry) else entry.team

    def submissions(self, entry: Entry) -> int | None:
        """Return how many of the team's submissions stand behind an entry.

        None while it is anonymous, whose entries the number would bring together, and for what is
        reported.
        """
        if entry.team_id is None or self._is_anonymous(entry):
            return None
        return self.counts[entry.team_id]

    def _is_anonymous(self, entry: Entry) -> bool:
        return entry.anonymous_until is not None and entry.anonymous_until > self.now


def leaderboard(
    session: Session, standings: Standings, board: Board, metric: str, now: datetime
) -> Ranking:
    """Rank the published submissions of a split.

    Equal values have equal ranks, and the next rank counts all before it: 1, 2, 2, 4. What has no
    value for the metric has no rank and comes last. Among equals, what was published first is
    first.

    Raises
    ------
    MalformedError
        If there is no such metric, or neither direction of it is better.
    """
    if metric not in SORTABLE:
        known = ", ".join(SORTABLE)
        raise MalformedError(f"a board is not sorted by {metric!r}; choose one of: {known}")
    kept = standings.of(session, board)
    if metric not in kept.ranked:
        kept.ranked[metric] = _ranked(kept.entries, CATALOGUE[metric])
    counts = standings.submissions_of_teams(session, board.name)
    return Ranking(board, metric, kept.ranked[metric], kept.apart, kept.metrics, now, counts)


def _ranked(entries: Sequence[Entry], metric: Metric) -> Sequence[Row]:
    ranks = _ranks([entry.scores.get(metric.key) for entry in entries], metric)
    rows = map(Row, ranks, entries)
    return sorted(rows, key=lambda row: inf if row.rank is None else row.rank)


def _ranks(values: Sequence[float | None], metric: Metric) -> list[int | None]:
    sign = -1 if metric.better == "higher" else 1
    order = sorted(sign * value for value in values if value is not None)
    first: dict[float, int] = {}
    for place, value in enumerate(order, start=1):
        first.setdefault(value, place)
    return [None if value is None else first[sign * value] for value in values]


def as_json(ranking: Ranking) -> bytes:
    """Write a leaderboard as :class:`~reverie_eval.schemas.service.Leaderboard` has it."""
    board = ranking.board
    return msgspec.json.encode(
        {
            "split": board.name,
            "protocol": board.split.protocol,
            "metric": ranking.metric,
            "fingerprint": board.truth.fingerprint,
            "signature": board.signature,
            "rows": [_said(ranking, row) for row in ranking.rows],
            "apart": [_said(ranking, row) for row in ranking.apart],
        }
    )


def _said(ranking: Ranking, row: Row) -> Mapping[str, Any]:
    entry = row.entry
    return {
        "rank": row.rank,
        "submission_id": entry.submission_id,
        "team": ranking.team(entry),
        "method": entry.method,
        "published_at": entry.published_at,
        "submissions": ranking.submissions(entry),
        "scores": entry.scores,
        "intervals": entry.intervals,
        "signature": entry.signature,
        "standing": entry.standing,
        "source": entry.source,
        "reviews": entry.reviews,
    }


def as_csv(ranking: Ranking) -> str:
    """Write a leaderboard as CSV: a row per result, a column per metric that any has.

    What takes no part in the ranking comes last. A cell that a spreadsheet would take for a formula
    begins with an apostrophe.

    References
    ----------
    OWASP, "CSV Injection".
    """
    rows = [*ranking.rows, *ranking.apart]
    present: set[str] = set().union(*(row.entry.scores for row in rows))
    shown = [key for key in CATALOGUE if key in present]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    headings = ["method" if name == "name" else name for name in _OF_METHOD]
    writer.writerow([*_ABOUT, *headings, *_STANDING, *shown])
    for row in rows:
        scores = row.entry.scores
        words = map(_cell, _words(ranking, row))
        writer.writerow([*words, *(scores.get(key) for key in shown)])
    return text.getvalue()


def _words(ranking: Ranking, row: Row) -> Sequence[Any]:
    """Return what a row of the CSV file says before its scores, in the order of its headings."""
    entry = row.entry
    published = entry.published_at.isoformat().replace("+00:00", "Z")
    reviews = "; ".join(f"{review.verdict}: {review.reason}" for review in entry.reviews)
    return [
        *(row.rank, entry.submission_id, ranking.team(entry), published),
        ranking.submissions(entry),
        *(entry.method.get(name) for name in _OF_METHOD),
        *(entry.standing, reviews, entry.source, entry.signature),
    ]


def _cell(value: str | int | None) -> str | int | None:
    if isinstance(value, bool):
        return str(value).lower()
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
