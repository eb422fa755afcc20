"""The entries of leaderboards, cached until the audit log records a change.

Every change to a leaderboard is in the audit log, whose entries are numbered in the order in which
they were committed. So the number of the last entry shows whether the cache is up to date, even if
another process made the change.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import groupby
from threading import Lock
from typing import Any

import msgspec
import sqlalchemy as sa
from sqlalchemy.orm import Session

from reverie_eval.reporting.history import Timeline
from reverie_eval.schemas.service import ReportedMethod, ScoredSubmission, Standing, last_moment
from reverie_eval.server.audit.log import last_recorded
from reverie_eval.server.boards.reviews import PublishedReview, is_disqualified
from reverie_eval.server.boards.schedules import Schedules, Timetable
from reverie_eval.server.scoring.boards import Board, without_version
from reverie_eval.server.store.database import UnreadableValueError
from reverie_eval.server.store.tables import IS_SHOWN, ReportedResult, Review, Submission, Team

_COLUMNS = (
    *("number", "id"),  # of a reported result, of a submission
    *("team", "method", "stored", "at"),
    *("team_id", "received_at", "scored_at", "anonymous_until"),
    *("review", "verdict", "reason", "reviewed_at"),
    *("source", "date", "dataset"),
)
"""Columns of both kinds of results, then only of submissions, then only of reported ones."""
_LISTED: frozenset[Standing] = frozenset({"ranked", "reported"})
"""Standings of the entries that are sorted by a metric together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A result on a leaderboard."""

    submission_id: str | None
    """None for a reported result."""
    team_id: int | None
    team: str
    method: Mapping[str, Any]
    """A stored :class:`~reverie_eval.schemas.service.ReportedMethod`."""
    published_at: datetime
    anonymous_until: datetime | None
    scores: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Lower and upper bounds, for headline metrics only."""
    scores_held_until: datetime | None = None
    """When its scores are released, if they are held back."""
    signature: str = ""
    standing: Standing = "ranked"
    source: str = ""
    """Where a reported result is from: a link or a text."""
    reported_date: str | None = None
    """The day, month or year of a reported result; None if it is not known."""
    dataset: str = ""
    """The version of the dataset that a reported result is on; empty if it is not known."""
    reviews: Sequence[PublishedReview] = ()

    @property
    def is_ranked(self) -> bool:
        """Whether it is a result of this server that is ranked, if it has a value."""
        return self.standing == "ranked"

    @property
    def date(self) -> str:
        """When it was published here, or reported elsewhere; empty if that is not known.

        A day in UTC, or a month or a year if no more is known.
        """
        if self.submission_id is None:
            return self.reported_date or ""
        return self.published_at.date().isoformat()


def is_anonymous(result: Submission | ScoredSubmission | Entry, now: datetime) -> bool:
    """Whether a published result still hides its team, which chose to be anonymous for a time."""
    return result.anonymous_until is not None and result.anonymous_until > now


class _Intervals(msgspec.Struct):
    intervals: dict[str, tuple[float, float]]


class _Report(msgspec.Struct):
    """The fields of a score report that leaderboards show; the others are not decoded."""

    signature: str
    scores: dict[str, float]
    intervals: _Intervals | None = None


class _Result(msgspec.Struct):
    report: _Report


_REPORT = msgspec.json.Decoder(_Report)
_OF_BOARDS = msgspec.json.Decoder(dict[str, _Result])
_METHOD = msgspec.json.Decoder(dict[str, str | bool | int | float | None])
_SCORES = msgspec.json.Decoder(dict[str, float])
_NOTHING_DECLARED: Mapping[str, Any] = {
    name: field.default
    for name, field in ReportedMethod.model_fields.items()
    if not field.is_required()
}
"""What is not in a stored method: only reported ones may be references, and fields were added."""


@dataclass(frozen=True, slots=True)
class Row:
    """An entry with its rank."""

    rank: int | None
    """None if the entry has no value or is not ranked."""
    entry: Entry


@dataclass(frozen=True, slots=True)
class BoardEntries:
    """The entries of a leaderboard as of an entry of the audit log."""

    number: int
    """The number of the last entry in the audit log."""
    signature: str
    """What results of the leaderboard are scored by."""
    entries: Sequence[Entry]
    """The ranked entries in the order of publication, then the reported ones."""
    apart: Sequence[Row]
    """The entries that are not comparable with the others, or disqualified."""
    metrics: frozenset[str]
    """All metrics of the entries that are not apart."""
    held_until: datetime | None = None
    """When scores are released next, if any are held back."""
    ranked: dict[str, Sequence[Row]] = field(default_factory=dict)
    """The rankings computed so far, by metric."""
    timelines: dict[str, tuple[str, Timeline | None]] = field(default_factory=dict)
    """The timelines of all entries drawn so far, by metric, each with its day."""

    def is_old(self, board: Board, number: int, now: datetime) -> bool:
        """Whether a change was recorded, the rules were corrected or scores released since."""
        is_released = self.held_until is not None and now > last_moment(self.held_until)
        return self.number < number or self.signature != board.signature or is_released


class EntriesCache:
    """The entries of every leaderboard, always as recent as the last commit."""

    def __init__(self, schedules: Schedules) -> None:
        self._schedules = schedules
        self._cached: dict[str, BoardEntries] = {}
        """By the path of the leaderboard."""
        self._counts: dict[str, tuple[int, Mapping[int, int]]] = {}
        """By split: the number of the last entry of the audit log then, and the counts."""
        self._lock = Lock()
        """Makes concurrent requests read the entries only once."""

    def entries(self, session: Session, board: Board, now: datetime) -> BoardEntries:
        """Return the entries of a leaderboard, read again if it may have changed.

        Raises UnreadableValueError if a result cannot be read, as does its JSON; or the DBAPIError
        of SQLite or the driver that reads a row.
        """
        number = last_recorded(session).change
        with self._lock:
            cached = self._cached.get(board.path)
            if cached is None or cached.is_old(board, number, now):
                timetable = self._schedules.read(session)[board.split]
                entries = _read_entries(session, board, timetable, now)
                cached = self._cached[board.path] = _entries_of(number, board, entries)
            return cached

    def submissions_of_teams(self, session: Session, split: str) -> Mapping[int, int]:
        """Count the submissions of each team to a split, published or not."""
        number = last_recorded(session).last
        known, counts = self._counts.get(split, (-1, {}))
        if known < number:
            counts = count_submissions(session, split)
            self._counts[split] = number, counts
        return counts


def count_submissions(
    session: Session, split: str, until: datetime | None = None
) -> Mapping[int, int]:
    """Count the submissions of each team to a split, of other teams 0.

    Only those that were received before a time, if one is given.
    """
    counted = sa.select(Submission.team_id, sa.func.count()).where(
        Submission.split == split, Submission.repeat == ""
    )
    if until is not None:
        counted = counted.where(Submission.received_at < until)
    return Counter(dict(session.execute(counted.group_by(Submission.team_id)).all()))


def _read_entries(
    session: Session, board: Board, timetable: Timetable, now: datetime
) -> Sequence[Entry]:
    found = []
    results = session.execute(_results(board))
    for _, group in groupby(results, lambda row: (row.number, row.id)):
        rows = list(group)
        try:
            entry = (
                _reported(board, rows[0])
                if rows[0].id is None
                else _scored(board, rows, timetable, now)
            )
        except msgspec.DecodeError:
            raise UnreadableValueError(f"a result on {board.label} cannot be read") from None
        found.append(entry)
    return [entry for entry in found if entry is not None]


def _entries_of(number: int, board: Board, entries: Sequence[Entry]) -> BoardEntries:
    listed = [entry for entry in entries if entry.standing in _LISTED]
    held = [entry.scores_held_until for entry in entries if entry.scores_held_until is not None]
    return BoardEntries(
        number,
        board.signature,
        listed,
        apart=[Row(None, entry) for entry in entries if entry.standing not in _LISTED],
        metrics=frozenset(key for entry in listed for key in entry.scores),
        held_until=min(held, default=None),
    )


def _results(board: Board) -> sa.CompoundSelect[Any]:
    """Select what a leaderboard shows: submissions as they were published, then reported results.

    A submission has a row for each of its current reviews, the earliest first, but at least one.
    """
    is_current = sa.and_(Review.submission_id == Submission.id, Review.lifted_at.is_(None))
    scored = (
        _as_result(
            number=sa.literal(0),
            id=Submission.id,
            team_id=Submission.team_id,
            team=Team.name,
            method=sa.cast(Submission.method, sa.Text),
            stored=sa.cast(Submission.boards if board.name else Submission.report, sa.Text),
            at=Submission.published_at,
            received_at=Submission.received_at,
            scored_at=Submission.scored_at,
            anonymous_until=Submission.anonymous_until,
            review=Review.id,
            verdict=Review.verdict,
            reason=Review.reason,
            reviewed_at=Review.created_at,
        )
        .join(Team, Submission.team_id == Team.id)
        .outerjoin(Review, is_current)
        .where(Submission.split == board.split, IS_SHOWN)
    )
    reported = _as_result(
        number=ReportedResult.id,
        team=ReportedResult.team,
        method=sa.cast(ReportedResult.method, sa.Text),
        stored=sa.cast(ReportedResult.scores, sa.Text),
        at=ReportedResult.created_at,
        source=ReportedResult.source,
        date=ReportedResult.date,
        dataset=ReportedResult.dataset,
    ).where(ReportedResult.split == board.split, ReportedResult.removed_at.is_(None))
    # Results in papers are assumed to be under the split's own rules.
    shown = [scored] if board.name else [scored, reported]
    return sa.union_all(*shown).order_by("number", "at", "id", "review")


def _as_result(**columns: Any) -> sa.Select[*tuple[Any, ...]]:
    """Select columns of one of the two kinds of results; it has no others of :data:`_COLUMNS`."""
    return sa.select(*(columns.get(name, sa.null()).label(name) for name in _COLUMNS))


def _scored(board: Board, rows: Sequence[Any], timetable: Timetable, now: datetime) -> Entry | None:
    """Return a submission, given its rows; None if its file is not or cannot be ranked there."""
    row = rows[0]
    report = _report_on(board, row.stored)
    if report is None:
        return None
    reviews = [
        PublishedReview(each.verdict, each.reason, each.reviewed_at)
        for each in rows
        if each.review is not None
    ]
    held_until = timetable.held_until(row.received_at, row.scored_at, now)
    drawn = {} if report.intervals is None else report.intervals.intervals
    return Entry(
        submission_id=row.id,
        team_id=row.team_id,
        team=row.team,
        method=_method(row.method),
        published_at=row.at,
        anonymous_until=row.anonymous_until,
        scores=report.scores if held_until is None else {},
        scores_held_until=held_until,
        intervals={key: drawn[key] for key in board.task.headline if key in drawn},
        signature=report.signature,
        standing=_standing(report, reviews, board),
        reviews=reviews,
    )


def _method(stored: str) -> Mapping[str, Any]:
    """Return a stored method, of which pages need the name, with all fields of any method."""
    method = _METHOD.decode(stored)
    if not isinstance(method.get("name"), str):
        raise msgspec.ValidationError("a method has no name")
    return {**_NOTHING_DECLARED, **method}


def _report_on(board: Board, stored: str) -> _Report | None:
    """Return the report on a leaderboard; None if the file is not or cannot be ranked there."""
    if not board.name:
        return _REPORT.decode(stored)
    result = _OF_BOARDS.decode(stored).get(board.name)
    return None if result is None or not result.report.scores else result.report


def _standing(report: _Report, reviews: Sequence[PublishedReview], board: Board) -> Standing:
    if is_disqualified(reviews):
        return "disqualified"
    is_current = without_version(report.signature) == without_version(board.signature)
    return "ranked" if is_current else "other-rules"


def _reported(board: Board, row: Any) -> Entry:
    """Return a reported result, given its row."""
    return Entry(
        submission_id=None,
        team_id=None,
        team=row.team,
        method=_method(row.method),
        published_at=row.at,
        anonymous_until=None,
        scores=_SCORES.decode(row.stored),
        standing="reported" if board.is_on(row.dataset) else "other-dataset",
        source=row.source,
        reported_date=row.date,
        dataset=row.dataset,
    )
