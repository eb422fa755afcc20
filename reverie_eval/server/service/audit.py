"""The audit log: who did what, in a chain of digests that shows what was changed later."""

import hashlib
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

import msgspec
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.server.store.tables import AuditEntry

_BEFORE_THE_FIRST = "0" * 64


def record(  # what happened is all of its parts
    session: Session, at: datetime, actor: str, action: str, subject: str, **details: Any
) -> None:
    """Append an entry; it is kept if the transaction is."""
    last = session.scalars(select(AuditEntry).order_by(AuditEntry.id.desc()).limit(1)).first()
    entry = AuditEntry(
        at=at,
        actor=actor,
        action=action,
        subject=subject,
        details=details,
        previous=last.digest if last else _BEFORE_THE_FIRST,
    )
    entry.digest = _digest(entry)
    session.add(entry)
    session.flush()


def entries(session: Session, after: int = 0, limit: int | None = None) -> Sequence[AuditEntry]:
    """Return what was recorded after an entry, the oldest first."""
    chosen = select(AuditEntry).where(AuditEntry.id > after).order_by(AuditEntry.id)
    return session.scalars(chosen.limit(limit)).all()


def latest_entries(
    session: Session, limit: int, before: int | None = None, *, actor: str = "", subject: str = ""
) -> Sequence[AuditEntry]:
    """Return the latest entries, or the latest before one of them; the latest first.

    Of somebody alone, or of what was done to something, if they are named.
    """
    chosen = select(AuditEntry).order_by(AuditEntry.id.desc()).limit(limit)
    if before is not None:
        chosen = chosen.where(AuditEntry.id < before)
    if actor:
        chosen = chosen.where(AuditEntry.actor == actor)
    if subject:
        chosen = chosen.where(AuditEntry.subject == subject)
    return session.scalars(chosen).all()


def altered(found: Sequence[AuditEntry]) -> Sequence[int]:
    """Return those of some entries that are not what was once written."""
    return [entry.id for entry in found if entry.digest != _digest(entry)]


def broken_links(session: Session) -> Iterator[int]:
    """Return the entries that are not what was once written, or follow one that is missing."""
    previous = _BEFORE_THE_FIRST
    for entry in session.scalars(select(AuditEntry).order_by(AuditEntry.id)):
        if entry.previous != previous or entry.digest != _digest(entry):
            yield entry.id
        previous = entry.digest


def _digest(entry: AuditEntry) -> str:
    parts = (
        entry.at.astimezone(UTC).isoformat(timespec="microseconds"),
        *(entry.actor, entry.action, entry.subject, entry.details, entry.previous),
    )
    return hashlib.sha256(msgspec.json.encode(parts, order="sorted")).hexdigest()
