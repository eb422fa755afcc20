"""Every upload with its outcome, and counts of submissions: the start page of organisers.

An upload is recorded after it was handled, in a transaction of its own. If that fails, the log says
so, and the participant does not notice. Neither files nor their problems are stored.
"""

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import median

from sqlalchemy import bindparam, delete, func, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import AttemptReport
from reverie_eval.server import errors
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import (
    IS_CHANGE,
    IS_SHOWN,
    SAME_FILE,
    Attempt,
    AuditEntry,
    JoinRequest,
    Person,
    Submission,
    Team,
)

DAYS_KEPT = 90
MOST_KEPT = 50_000
"""Rejected files use no submission, so anyone could fill the table with them."""

FAILURES = (
    errors.RejectedFileError,
    errors.QuotaSpentError,
    errors.BytesSpentError,
    errors.NotOpenError,
    errors.ConflictError,
    errors.MalformedError,
    errors.FaultError,
)
"""The outcomes of uploads that were not scored."""
HOURS = 24
RECENTLY = timedelta(days=30)
"""How long the start page says that several teams sent the same file."""
_SUCCESSES = frozenset({"scored", "repeat"})

# Built here, because building it takes longer than running it. No old row is in memory.
_DELETE_OLD = (
    delete(Attempt)
    .where((Attempt.at < bindparam("before")) | (Attempt.id <= bindparam("last")))
    .execution_options(synchronize_session=False)
)

_LOGGER = logging.getLogger("reverie_eval.server")


@dataclass
class Handled:
    """An upload that is being handled."""

    person: Person
    split: str
    size: int
    """Bytes; after unpacking, if the server got that far."""
    began: float
    """By the clock that measures how long it takes."""
    outcome: str = "scored"
    problems: int = 0


@contextmanager
def recording(server: ServerState, person: Person, split: str, size: int) -> Iterator[Handled]:
    """Record the outcome of the upload that is handled in the context, and how long it took."""
    attempt = Handled(person, split, size, time.perf_counter())
    try:
        yield attempt
    except Exception as error:
        known = errors.request_error(error)
        attempt.outcome = known.code if isinstance(known, FAILURES) else errors.FaultError.code
        if isinstance(known, errors.RejectedFileError):
            attempt.problems = len(known.problems)
        raise
    finally:
        _record(server, attempt)


def _record(server: ServerState, attempt: Handled) -> None:
    """Insert the record, and delete those that are too old or too many."""
    try:
        with server.database.writing() as session:
            row = Attempt(
                person_id=attempt.person.id,
                split=attempt.split,
                size=attempt.size,
                outcome=attempt.outcome,
                problems=attempt.problems,
                milliseconds=round(1000 * (time.perf_counter() - attempt.began)),
                at=server.clock(),
            )
            session.add(row)
            session.flush()
            before, last = row.at - timedelta(days=DAYS_KEPT), row.id - MOST_KEPT
            session.execute(_DELETE_OLD, {"before": before, "last": last})
    except Exception:
        _LOGGER.exception("upload not recorded")


def list_attempts(session: Session, page: Page, outcome: str = "") -> Listed[AttemptReport]:
    """List uploads, the latest first; only those with an outcome, if one is given."""
    rows = select(Attempt)
    if outcome:
        rows = rows.where(Attempt.outcome == outcome)
    return list_page(session, rows, Attempt.id, page, Attempt.as_seen, newest_first=True)


@dataclass(frozen=True, slots=True)
class SplitCounts:
    """The submissions to a split."""

    submissions: int = 0
    published: int = 0
    latest: datetime | None = None


@dataclass(frozen=True, slots=True)
class Totals:
    """How much the server stores."""

    teams: int
    people: int
    upload_bytes: int
    """The size of all uploads; a file that two teams sent is stored once and counted twice."""
    open_requests: int
    """Requests to join that wait for an answer."""
    same_files: int
    """How often a team has recently submitted the file of another team."""
    same_file_on: str | None
    """The split of the last time, at any time."""


@dataclass(frozen=True, slots=True)
class Hour:
    """The uploads of an hour."""

    begins: datetime
    scored: int
    repeats: int
    refused: int


@dataclass(frozen=True, slots=True)
class Day:
    """The uploads of the last 24 hours."""

    hours: Sequence[Hour]
    """The oldest first; the last one has not ended."""
    uploads: int
    refused: int
    median_milliseconds: int | None
    """None if there were no uploads."""
    slowest_milliseconds: int | None

    @property
    def busiest(self) -> int:
        """The uploads of the busiest hour."""
        return max(hour.scored + hour.repeats + hour.refused for hour in self.hours)


def counts_of_splits(session: Session) -> Mapping[str, SplitCounts]:
    """Count the submissions of each split that has any."""
    # Two statements, as each has an index.
    published = select(Submission.split, func.count()).where(IS_SHOWN)
    shown = dict(session.execute(published.group_by(Submission.split)).all())
    every = select(Submission.split, func.count())
    counted = every.group_by(Submission.split).subquery()
    # The latest of a split is at an end of the index; with the count, each row would be compared.
    latest = select(func.max(Submission.received_at)).where(Submission.split == counted.c.split)
    rows = session.execute(select(counted, latest.scalar_subquery()))
    return {split: SplitCounts(number, shown.get(split, 0), last) for split, number, last in rows}


def totals(session: Session, now: datetime) -> Totals:
    """Count teams and people, and add up the sizes of uploads."""
    same_files = IS_CHANGE, AuditEntry.action == SAME_FILE
    last = select(AuditEntry.subject).where(*same_files).order_by(AuditEntry.id.desc()).limit(1)
    counted = session.execute(
        select(
            select(func.count()).where(Team.merged_at.is_(None)).scalar_subquery(),
            select(func.count()).where(Person.deleted_at.is_(None)).scalar_subquery(),
            select(func.coalesce(func.sum(Submission.size), 0)).scalar_subquery(),
            select(func.count())
            .select_from(JoinRequest)
            .where(JoinRequest.decision.is_(None))
            .scalar_subquery(),
            select(func.count())
            .where(*same_files, AuditEntry.at > now - RECENTLY)
            .scalar_subquery(),
            last.scalar_subquery(),
        )
    )
    return Totals(*counted.one())


def last_day(session: Session, now: datetime) -> Day:
    """Count the outcomes of the uploads of the last 24 hours, by full hours."""
    this_hour = now.replace(minute=0, second=0, microsecond=0)
    begins = [this_hour - timedelta(hours=ago) for ago in reversed(range(HOURS))]
    attempts = session.scalars(select(Attempt).where(Attempt.at >= begins[0])).all()
    times = [each.milliseconds for each in attempts]
    return Day(
        hours=[_hour(begin, attempts) for begin in begins],
        uploads=len(attempts),
        refused=sum(each.outcome not in _SUCCESSES for each in attempts),
        median_milliseconds=round(median(times)) if times else None,
        slowest_milliseconds=max(times, default=None),
    )


def _hour(begins: datetime, attempts: Sequence[Attempt]) -> Hour:
    outcomes = [
        each.outcome for each in attempts if begins <= each.at < begins + timedelta(hours=1)
    ]
    scored, repeats = outcomes.count("scored"), outcomes.count("repeat")
    return Hour(begins, scored, repeats, len(outcomes) - scored - repeats)
