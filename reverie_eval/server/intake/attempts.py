"""Every upload with its outcome, for the organiser.

An upload is recorded after it was handled, in a transaction of its own. If that fails, the log says
so, and the participant does not notice. Neither files nor their problems are stored.
"""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy import bindparam, delete, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import AttemptReport
from reverie_eval.server import errors
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import (
    Attempt,
    Person,
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


def list_attempts(session: Session, page: Page) -> Listed[AttemptReport]:
    """List uploads, the latest first."""
    rows = select(Attempt)
    return list_page(session, rows, Attempt.id, page, Attempt.as_seen, newest_first=True)
