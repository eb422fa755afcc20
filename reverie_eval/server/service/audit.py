"""The audit log: who did what, in a chain of keyed digests that shows what was changed later.

Each entry's digest is an HMAC-SHA256 over the entry and the digest before it, under a key that is
derived from the server's signing key. So whoever can write to the database, but does not have that
key, can neither change an entry, nor add one, nor remove one that another follows. Entries at the
end can be cut off unseen by the chain; :func:`unmatched` finds their rows. Whoever has the signing
key can write the whole log anew.
"""

import hashlib
import hmac
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any, Self

import msgspec
from sqlalchemy import inspect, select
from sqlalchemy.orm import Session

from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.service.receipts import Signer
from reverie_eval.server.store.tables import AuditEntry, Base

_BEFORE_THE_FIRST = "0" * 64


class AuditLog:
    """Writes and checks the log.

    Parameters
    ----------
    key : bytes
        The same for all processes of a server, and secret.
    """

    def __init__(self, key: bytes) -> None:
        self._key = key

    @classmethod
    def of(cls, signer: Signer) -> Self:
        """Return the log of the server that signs with a key."""
        return cls(signer.secret_for("audit log"))

    def append(  # what happened is all of its parts
        self,
        session: Session,
        at: datetime,
        actor: str,
        action: str,
        *,
        row: Base,
        subject: str,
        **details: Any,
    ) -> None:
        """Append an entry; it is kept if the transaction is."""
        last = session.scalars(select(AuditEntry.digest).order_by(AuditEntry.id.desc()).limit(1))
        entry = AuditEntry(
            at=at,
            actor=actor,
            action=action,
            subject=subject,
            row=row_name(row),
            details=details,
            previous=last.first() or _BEFORE_THE_FIRST,
        )
        entry.digest = self._digest(entry)
        session.add(entry)
        session.flush()

    def altered(self, found: Sequence[AuditEntry]) -> Sequence[int]:
        """Return the ids of those entries that are not what was once written."""
        return [entry.id for entry in found if not self._is_sound(entry)]

    def broken_links(self, session: Session) -> Iterator[int]:
        """Return the entries that are not what was once written, or follow a missing one."""
        previous = _BEFORE_THE_FIRST
        for entry in session.scalars(select(AuditEntry).order_by(AuditEntry.id)):
            if entry.previous != previous or not self._is_sound(entry):
                yield entry.id
            previous = entry.digest

    def _is_sound(self, entry: AuditEntry) -> bool:
        return hmac.compare_digest(entry.digest, self._digest(entry))

    def _digest(self, entry: AuditEntry) -> str:
        parts = (
            entry.at.astimezone(UTC).isoformat(timespec="microseconds"),
            *(entry.actor, entry.action, entry.row, entry.subject),
            *(entry.details, entry.previous),
        )
        message = msgspec.json.encode(parts, order="sorted")
        return hmac.new(self._key, message, hashlib.sha256).hexdigest()


def row_name(row: Base) -> str:
    """Name a row as entries refer to it, whatever people call it by then: ``team:3``."""
    return f"{row.__tablename__}:{inspect(row).mapper.primary_key_from_instance(row)[0]}"


def entries(session: Session) -> Sequence[AuditEntry]:
    """Return everything that was recorded, the oldest first."""
    return session.scalars(select(AuditEntry).order_by(AuditEntry.id)).all()


def list_entries(
    session: Session,
    page: Page,
    *,
    actor: str = "",
    subject: str = "",
    newest_first: bool = False,
) -> Listed[AuditEntry]:
    """List what was recorded; only by an actor or about a subject, if these are given."""
    rows = select(AuditEntry)
    if actor:
        rows = rows.where(AuditEntry.actor == actor)
    if subject:
        rows = rows.where(AuditEntry.subject == subject)
    return list_page(session, rows, AuditEntry.id, page, lambda row: row, newest_first=newest_first)
