"""Results that papers report and no server has scored, entered by the organiser.

They stand on a board beside what was scored here, marked as what they are. What is removed is kept,
and shown no more.
"""

from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from math import isfinite

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.service import Method
from reverie_eval.schemas.wire import LONGEST_NAME
from reverie_eval.server.errors import ConflictError, MalformedError, NotFoundError
from reverie_eval.server.service.audit import record
from reverie_eval.server.service.lines import demand_line
from reverie_eval.server.store.tables import ReportedResult


def add_reported(
    session: Session,
    split: str,
    method: Method,
    *,
    team: str,
    scores: Mapping[str, float],
    source: str,
    splits: Collection[str],
    now: datetime,
    actor: str,
) -> ReportedResult:
    """Put a result on a split's board that a paper reports.

    Raises
    ------
    MalformedError
        If a score is of no metric or out of its bounds, or there is none.
    NotFoundError
        If there is no such split.
    ConflictError
        If the method stands there already.
    """
    if split not in splits:
        raise NotFoundError(f"there is no split {split!r}; there are: {', '.join(splits)}")
    _demand_scores(scores)
    if any(each.method["name"] == method.name for each in reported_of(session, split)):
        raise ConflictError(
            f"{method.name!r} is on the board of {split} already; remove it first to enter it anew"
        )
    result = ReportedResult(
        split=split,
        method=method.model_dump(mode="json"),
        team=demand_line(team, "say who reports it, as the board is to call them", LONGEST_NAME),
        scores=dict(scores),
        source=source,
        added_by=actor,
        created_at=now,
    )
    session.add(result)
    session.flush()
    record(session, now, actor, "reported result added", method.name, split=split, source=source)
    return result


def remove_reported(
    session: Session, result_id: int, *, now: datetime, actor: str
) -> ReportedResult:
    """Take a reported result off its board; NotFoundError if it is on none."""
    result = session.get(ReportedResult, result_id)
    if result is None or result.removed_at is not None:
        raise NotFoundError(f"there is no reported result {result_id} on any board")
    result.removed_at = now
    session.flush()
    name = result.method["name"]
    record(session, now, actor, "reported result removed", name, split=result.split)
    return result


def reported_of(session: Session, split: str) -> Sequence[ReportedResult]:
    """Return what papers report of a split, in the order in which it was entered."""
    chosen = select(ReportedResult).where(ReportedResult.split == split)
    standing = chosen.where(ReportedResult.removed_at.is_(None))
    return session.scalars(standing.order_by(ReportedResult.id)).all()


def all_reported(session: Session) -> Sequence[ReportedResult]:
    """Return what is on any board, the latest first."""
    chosen = select(ReportedResult).where(ReportedResult.removed_at.is_(None))
    return session.scalars(chosen.order_by(ReportedResult.id.desc())).all()


def _demand_scores(scores: Mapping[str, float]) -> None:
    if not scores:
        raise MalformedError("a result needs a score; enter one metric at least")
    unknown = [key for key in scores if key not in CATALOGUE]
    if unknown:
        known = ", ".join(CATALOGUE)
        raise MalformedError(f"there is no metric {unknown[0]!r}; choose of: {known}")
    for key, value in scores.items():
        bound = CATALOGUE[key].upper_bound
        if not isfinite(value) or not 0 <= value <= bound:
            expected = "a fraction from 0 to 1" if bound == 1 else "0 or more"
            raise MalformedError(f"{key} is {value}; expected {expected}")
