"""Every upload and what it came to, for the organiser to see that all is well.

This is written when the upload has been dealt with, in a transaction of its own: that it could not
be written is told to the log, and is nothing to the participant. Neither bodies nor what was said
of them are kept.
"""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import AttemptReport
from reverie_eval.server.errors import (
    ConflictError,
    FaultError,
    MalformedError,
    NotOpenError,
    QuotaSpentError,
    RejectedFileError,
    request_error,
)
from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Attempt, Person

DAYS_KEPT = 90
MOST_KEPT = 50_000
"""However many come in that time: rejected files cost nothing, so anybody can send many."""

FAILURES = (
    RejectedFileError,
    QuotaSpentError,
    NotOpenError,
    ConflictError,
    MalformedError,
    FaultError,
)
"""What an upload can come to besides a score."""

_LOGGER = logging.getLogger("reverie_eval.server")


@dataclass(slots=True)
class Noted:
    """What is noted of an upload while it is dealt with."""

    size: int
    """Bytes, unpacked as soon as they are."""
    outcome: str = "scored"


class Attempts:
    """Notes every upload of a server."""

    def __init__(self, database: Database, clock: Callable[[], datetime]) -> None:
        self._database = database
        self._clock = clock

    @contextmanager
    def noting(self, person: Person, split: str, size: int) -> Iterator[Noted]:
        """Note what an upload comes to inside, and how long it takes."""
        noted, began, problems = Noted(size), time.perf_counter(), 0
        try:
            yield noted
        except Exception as error:
            known = request_error(error)
            noted.outcome = known.code if isinstance(known, FAILURES) else FaultError.code
            problems = len(known.problems) if isinstance(known, RejectedFileError) else 0
            raise
        finally:
            milliseconds = round(1000 * (time.perf_counter() - began))
            self._keep(
                Attempt(
                    at=self._clock(),
                    person_id=person.id,
                    split=split,
                    outcome=noted.outcome,
                    problems=problems,
                    size=noted.size,
                    milliseconds=milliseconds,
                )
            )

    def _keep(self, attempt: Attempt) -> None:
        try:
            with self._database.writing() as session:
                session.add(attempt)
                session.flush()
                _forget(session, attempt)
        except Exception:
            _LOGGER.exception("an upload was dealt with, but not noted")


def list_attempts(session: Session, page: Page, outcome: str = "") -> Listed[AttemptReport]:
    """List uploads and what they came to, the latest first; of one outcome, if it is named."""
    rows = select(Attempt)
    if outcome:
        rows = rows.where(Attempt.outcome == outcome)
    return list_page(session, rows, Attempt.id, page, attempt_report, newest_first=True)


def attempts_since(session: Session, since: datetime) -> Sequence[Attempt]:
    """Return the uploads since an instant, the latest first."""
    return session.scalars(
        select(Attempt).where(Attempt.at >= since).order_by(Attempt.id.desc())
    ).all()


def _forget(session: Session, latest: Attempt) -> None:
    is_old = Attempt.at < latest.at - timedelta(days=DAYS_KEPT)
    session.execute(delete(Attempt).where(is_old | (Attempt.id <= latest.id - MOST_KEPT)))


def attempt_report(attempt: Attempt) -> AttemptReport:
    """Return what organisers see of an upload."""
    return AttemptReport(
        id=attempt.id,
        at=attempt.at,
        person=attempt.person.name,
        team=attempt.person.team.name,
        split=attempt.split,
        outcome=attempt.outcome,
        problems=attempt.problems,
        size=attempt.size,
        milliseconds=attempt.milliseconds,
    )
