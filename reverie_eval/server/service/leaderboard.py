"""The leaderboard: what teams have published, ranked by any metric."""

import csv
import io
from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.schemas.service import Leaderboard, LeaderboardRow, Method
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.service.boards import Board
from reverie_eval.server.store.tables import Submission

SORTABLE = tuple(key for key, metric in CATALOGUE.items() if metric.better != "neither")
"""Metrics of which one direction is better."""

_ABOUT = ("rank", "submission_id", "team", "published_at", "submissions")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def leaderboard(session: Session, board: Board, metric: str, now: datetime) -> Leaderboard:
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
    rows = session.scalars(
        select(Submission)
        .where(Submission.split == board.name)
        .where(Submission.published_at.is_not(None), Submission.withdrawn_at.is_(None))
        .order_by(Submission.published_at, Submission.id)
    ).all()
    counts = _submissions_of_teams(session, board.name)
    ranks = _ranks([row.report["scores"].get(metric) for row in rows], CATALOGUE[metric])
    entries = [
        _entry(row, rank, counts[row.team_id], now) for row, rank in zip(rows, ranks, strict=True)
    ]
    entries.sort(key=lambda entry: (entry.rank is None, entry.rank))
    return Leaderboard(
        split=board.name,
        protocol=board.split.protocol,
        metric=metric,
        fingerprint=board.truth.fingerprint,
        rows=entries,
    )


def _submissions_of_teams(session: Session, split: str) -> dict[int, int]:
    counts = select(Submission.team_id, func.count()).where(Submission.split == split)
    return dict(session.execute(counts.group_by(Submission.team_id)).all())


def _ranks(values: Sequence[float | None], metric: Metric) -> list[int | None]:
    sign = -1 if metric.better == "higher" else 1
    order = sorted(sign * value for value in values if value is not None)
    first: dict[float, int] = {}
    for place, value in enumerate(order, start=1):
        first.setdefault(value, place)
    return [None if value is None else first[sign * value] for value in values]


def _entry(row: Submission, rank: int | None, submissions: int, now: datetime) -> LeaderboardRow:
    """Word a published submission; while its team is anonymous, nothing in it tells which it is."""
    is_anonymous = row.anonymous_until is not None and row.anonymous_until > now
    return LeaderboardRow(
        rank=rank,
        submission_id=row.id,
        team="" if is_anonymous else row.team.name,
        method=Method.model_validate(row.method),
        published_at=row.published_at,
        submissions=None if is_anonymous else submissions,
        scores=row.report["scores"],
    )


def as_csv(board: Leaderboard) -> str:
    """Write a leaderboard as CSV: a row per submission, a column per metric that any has.

    A cell that a spreadsheet would take for a formula begins with an apostrophe.

    References
    ----------
    OWASP, "CSV Injection".
    """
    shown = [key for key in CATALOGUE if any(key in row.scores for row in board.rows)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    said = [name for name in Method.model_fields if name != "description"]
    writer.writerow([*_ABOUT, *("method" if name == "name" else name for name in said), *shown])
    for row in board.rows:
        fields = row.model_dump(mode="json")
        cells = [fields[name] for name in _ABOUT] + [fields["method"][name] for name in said]
        writer.writerow([*map(_cell, cells), *(row.scores.get(key, "") for key in shown)])
    return text.getvalue()


def _cell(value: str | float | None) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    text = "" if value is None else str(value)
    return f"'{text}" if text.startswith(_FORMULA) else text
