"""Results that papers report and this server has not scored, entered by the organiser.

Leaderboards show them without a rank, marked as reported. Removed results stay in the database but
are not shown.
"""

from collections.abc import Collection, Sequence
from math import isfinite

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.organising import NewReported, ReportedEntry
from reverie_eval.server.errors import ConflictError, MalformedError, NotFoundError
from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.service.transactions import Transaction
from reverie_eval.server.store.tables import ReportedResult


def add_reported(
    transaction: Transaction, new: NewReported, splits: Collection[str]
) -> ReportedEntry:
    """Add a result that a paper reports to the leaderboard of a split.

    Raises
    ------
    MalformedError
        If a metric is unknown, or a score is out of its bounds.
    NotFoundError
        If there is no such split.
    ConflictError
        If a reported result of that method is already on the leaderboard.
    """
    name, split = new.method.name, new.split
    if split not in splits:
        raise NotFoundError(f"there is no split {split!r}; there are: {', '.join(splits)}")
    unknown = [key for key in new.scores if key not in CATALOGUE]
    if unknown:
        known = ", ".join(CATALOGUE)
        raise MalformedError(f"there is no metric {unknown[0]!r}; choose one of: {known}")
    for key, value in new.scores.items():
        bound = CATALOGUE[key].upper_bound
        if not isfinite(value) or not 0 <= value <= bound:
            expected = "a fraction from 0 to 1" if bound == 1 else "0 or more"
            raise MalformedError(f"{key} is {value}; expected {expected}")
    if any(each.method["name"] == name for each in reported_of(transaction.session, split)):
        raise ConflictError(
            f"{name!r} is already on the leaderboard of {split}; remove it before adding it again"
        )
    result = ReportedResult(
        **new.model_dump(mode="json"), added_by=transaction.actor, created_at=transaction.now
    )
    transaction.add(result)
    transaction.record("reported result added", result, name, split=split, source=result.source)
    return ReportedEntry.model_validate(result)


def remove_reported(transaction: Transaction, result_id: int) -> ReportedEntry:
    """Remove a reported result from its leaderboard; NotFoundError if it is not on one."""
    result = transaction.session.get(ReportedResult, result_id)
    if result is None or result.removed_at is not None:
        raise NotFoundError(f"there is no reported result {result_id} on any leaderboard")
    result.removed_at = transaction.now
    name = result.method["name"]
    transaction.record("reported result removed", result, name, split=result.split)
    return ReportedEntry.model_validate(result)


def list_reported(session: Session, page: Page) -> Listed[ReportedEntry]:
    """List the reported results on all leaderboards, the latest first."""
    rows = select(ReportedResult).where(ReportedResult.removed_at.is_(None))
    report = ReportedEntry.model_validate
    return list_page(session, rows, ReportedResult.id, page, report, newest_first=True)


def reported_of(session: Session, split: str) -> Sequence[ReportedResult]:
    """Return the reported results of a split, in the order in which they were added."""
    chosen = select(ReportedResult).where(ReportedResult.split == split)
    current = chosen.where(ReportedResult.removed_at.is_(None))
    return session.scalars(current.order_by(ReportedResult.id)).all()
