"""Further submissions that the organiser gives a team, with the reason on record."""

from collections.abc import Collection, Sequence
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import MOST_EXTRA
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.service.audit import record
from reverie_eval.server.service.lines import demand_reason
from reverie_eval.server.store.tables import Grant, Team


def all_grants(session: Session) -> Sequence[Grant]:
    """Return what was given, the latest first."""
    return session.scalars(select(Grant).order_by(Grant.id.desc())).all()


def grant(
    session: Session,
    team: str,
    split: str,
    extra: int,
    *,
    splits: Collection[str],
    reason: str,
    now: datetime,
    expires_at: datetime,
    actor: str,
) -> Grant:
    """Raise every limit of a team on one of the splits, and of each person in it, until a date.

    Raises
    ------
    MalformedError
        If nothing is given, or more than anybody needs, for no time, or for no reason.
    NotFoundError
        If there is no such team or split.
    """
    if not 1 <= extra <= MOST_EXTRA:
        raise MalformedError(f"{extra:,} further submissions; give from 1 to {MOST_EXTRA:,}")
    why = demand_reason(reason)
    if expires_at <= now:
        raise MalformedError("what is given would have expired already; choose a later time")
    if split not in splits:
        raise NotFoundError(f"there is no split {split!r}; there are: {', '.join(splits)}")
    found = session.scalars(select(Team).where(Team.name == team)).first()
    if found is None:
        raise NotFoundError(f"there is no team {team!r}")
    given = Grant(
        team=found,
        split=split,
        extra=extra,
        reason=why,
        created_at=now,
        expires_at=expires_at,
    )
    session.add(given)
    session.flush()
    until = expires_at.isoformat(timespec="seconds")
    record(session, now, actor, "granted", team, split=split, extra=extra, reason=why, until=until)
    return given
