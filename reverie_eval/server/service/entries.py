"""What boards show, read once and kept until something is recorded that may change it.

Whatever changes a board is in the audit log, whose entries are numbered in the order in which they
were committed. So the number of the last one tells whether what is kept still holds, whichever
process has changed something.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from threading import Lock
from typing import Any

import msgspec
from sqlalchemy import ColumnElement, Text, cast, func, select
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.service import Standing, Verdict
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.reported import reported_of
from reverie_eval.server.service.reviews import reviews_of
from reverie_eval.server.store.tables import AuditEntry, Submission, Team

_CHANGES_NO_BOARD = "submitted"
"""By far the most frequent entry: nothing is on a board before it is published."""


@dataclass(frozen=True, slots=True)
class PublishedReview:
    """What the organiser says of a result, for everybody to read."""

    verdict: Verdict
    reason: str
    reviewer: str
    created_at: datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A result on a board."""

    submission_id: str | None
    """None for what a paper reports."""
    team_id: int | None
    team: str
    method: Mapping[str, Any]
    """What :class:`~reverie_eval.schemas.service.Method` says, as it is kept."""
    published_at: datetime
    anonymous_until: datetime | None
    scores: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Low and high, of headline metrics alone."""
    scores_held_until: datetime | None = None
    """When its scores are released, if they are not."""
    signature: str = ""
    standing: Standing = "ranked"
    source: str = ""
    """Where it is reported."""
    entered_by: str = ""
    reviews: Sequence[PublishedReview] = ()


class _Intervals(msgspec.Struct):
    intervals: dict[str, tuple[float, float]]


class _Report(msgspec.Struct):
    """What a board shows of a score report; the rest is not even decoded."""

    signature: str
    scores: dict[str, float]
    intervals: _Intervals | None = None


_REPORT = msgspec.json.Decoder(_Report)
_METHOD = msgspec.json.Decoder(dict[str, Any])


@dataclass(frozen=True, slots=True)
class Row:
    """An entry in its place."""

    rank: int | None
    """None without a value, and for what takes no part in the ranking."""
    entry: Entry


@dataclass(frozen=True, slots=True)
class BoardEntries:
    """The entries of a board as they were when something was last recorded."""

    number: int
    """Of what was recorded last."""
    entries: Sequence[Entry]
    """That take part in the ranking, what was published first first."""
    apart: Sequence[Row]
    """What takes no part in it."""
    metrics: frozenset[str]
    """That any of those has which take part."""
    held_until: datetime | None = None
    """When scores are released next, if any are held back."""
    ranked: dict[str, Sequence[Row]] = field(default_factory=dict)
    """By the metrics that were asked for since."""

    def is_over(self, now: datetime) -> bool:
        """Whether scores were released since."""
        return self.held_until is not None and now.replace(microsecond=0) > self.held_until


class EntriesCache:
    """The entries of every board, never older than what was committed when they are asked for."""

    def __init__(self) -> None:
        self._cached: dict[str, BoardEntries] = {}
        self._counts: dict[str, tuple[int, Mapping[int, int]]] = {}
        self._lock = Lock()
        """Whoever comes while entries are read waits for them."""

    def entries(self, session: Session, board: Board, now: datetime) -> BoardEntries:
        """Return what is on a board."""
        number = _last_recorded(session, AuditEntry.action != _CHANGES_NO_BOARD)
        with self._lock:
            cached = self._cached.get(board.name)
            if cached is None or cached.number < number or cached.is_over(now):
                cached = self._cached[board.name] = _read_entries(session, board, number, now)
            return cached

    def submissions_of_teams(self, session: Session, split: str) -> Mapping[int, int]:
        """Count what each team has submitted to a split, published or not."""
        number = _last_recorded(session)
        known, counts = self._counts.get(split, (-1, {}))
        if known < number:
            chosen = select(Submission.team_id, func.count()).where(Submission.split == split)
            counts = dict(session.execute(chosen.group_by(Submission.team_id)).all())
            self._counts[split] = number, counts
        return counts


def _read_entries(session: Session, board: Board, number: int, now: datetime) -> BoardEntries:
    entries = [*_scored(session, board, now), *_reported(session, board)]
    taking_part = [entry for entry in entries if entry.standing == "ranked"]
    apart = [Row(None, entry) for entry in entries if entry.standing != "ranked"]
    metrics = frozenset(key for entry in taking_part for key in entry.scores)
    held = [entry.scores_held_until for entry in entries if entry.scores_held_until is not None]
    return BoardEntries(number, taking_part, apart, metrics, min(held, default=None))


def _last_recorded(session: Session, *kinds: ColumnElement[bool]) -> int:
    chosen = select(AuditEntry.id).where(*kinds).order_by(AuditEntry.id.desc())
    return session.scalar(chosen.limit(1)) or 0


def _scored(session: Session, board: Board, now: datetime) -> Sequence[Entry]:
    chosen = (
        select(
            Submission.id,
            Submission.team_id,
            Team.name.label("team"),
            cast(Submission.method, Text).label("method"),
            cast(Submission.report, Text).label("report"),
            Submission.published_at,
            Submission.received_at,
            Submission.anonymous_until,
        )
        .join(Team, Submission.team_id == Team.id)
        .where(Submission.split == board.name)
        .where(Submission.published_at.is_not(None), Submission.withdrawn_at.is_(None))
        .order_by(Submission.published_at, Submission.id)
    )
    reviews = {
        submission: [
            PublishedReview(row.verdict, row.reason, row.reviewer, row.created_at) for row in rows
        ]
        for submission, rows in reviews_of(session, board.name).items()
    }
    rules = _without_version(board.signature)
    return [
        _entry(
            row,
            reviews.get(row.id, ()),
            rules,
            board.split.scores_held_until(row.received_at, now),
        )
        for row in session.execute(chosen)
    ]


def _entry(
    row: Any, reviews: Sequence[PublishedReview], rules: str, held_until: datetime | None
) -> Entry:
    report = _REPORT.decode(row.report)
    drawn = {} if report.intervals is None else report.intervals.intervals
    standing: Standing = "ranked"
    if any(review.verdict == "disqualified" for review in reviews):
        standing = "disqualified"
    elif _without_version(report.signature) != rules:
        standing = "other-rules"
    return Entry(
        submission_id=row.id,
        team_id=row.team_id,
        team=row.team,
        method=_METHOD.decode(row.method),
        published_at=row.published_at,
        anonymous_until=row.anonymous_until,
        scores=report.scores if held_until is None else {},
        scores_held_until=held_until,
        intervals={
            key: drawn[key] for key, metric in CATALOGUE.items() if metric.headline and key in drawn
        },
        signature=report.signature,
        standing=standing,
        reviews=reviews,
    )


def _without_version(signature: str) -> str:
    """Return what scores compare by: a released protocol's numbers are those of every version."""
    return signature.rpartition("|version:")[0]


def _reported(session: Session, board: Board) -> Sequence[Entry]:
    return [
        Entry(
            submission_id=None,
            team_id=None,
            team=row.team,
            method=row.method,
            published_at=row.created_at,
            anonymous_until=None,
            scores=row.scores,
            standing="reported",
            source=row.source,
            entered_by=row.added_by,
        )
        for row in reported_of(session, board.name)
    ]
