"""Deleting files of old submissions that are not published; rows, scores and receipts stay.

A file is deleted in the transaction that marks its submissions, so an upload of the same content
either comes before and keeps the file, or comes after and stores it again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Self

from sqlalchemy import case, func, select
from sqlalchemy.orm import Session

from reverie_eval.server.audit.transactions import Actor, Transactions
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import IS_SHOWN, UPLOAD_DELETED, Submission
from reverie_eval.server.store.uploads import Uploads


@dataclass(frozen=True, slots=True)
class Tidied:
    """The files that were deleted, or would be."""

    submissions: Sequence[str]
    """The submissions with these files, the oldest first."""
    files: int


@dataclass(frozen=True, slots=True)
class Retention:
    """Deletes the files that a server need not keep."""

    uploads: Uploads
    transactions: Transactions
    days: int | None
    """How long files are kept; None for ever."""

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the service of a server."""
        return cls(server.uploads, server.transactions, server.settings.keep_uploads_days)

    def tidy(self, actor: Actor) -> Tidied:
        """Delete the files of submissions that are old and not published.

        A file of several submissions is deleted once all of them are old and not published.
        """
        if self.days is None:
            return Tidied([], 0)
        before = self.transactions.clock() - timedelta(days=self.days)
        with self.transactions.database.reading() as session:
            found = _expired(session, before)
        deleted: list[str] = []
        files = 0
        for sha256 in found:
            names = self._delete(actor, sha256, before)
            deleted += names
            files += bool(names)
        return Tidied(deleted, files)

    def count_expired(self, session: Session, now: datetime) -> int:
        """Count the files that :meth:`tidy` would delete."""
        if self.days is None:
            return 0
        return len(_expired(session, now - timedelta(days=self.days)))

    def _delete(self, actor: Actor, sha256: str, before: datetime) -> Sequence[str]:
        """Delete a file, unless it was published or sent again meanwhile."""
        with self.transactions.begin(actor) as transaction:
            session = transaction.session
            if not _expired(session, before, sha256):
                return []
            chosen = select(Submission).where(
                Submission.sha256 == sha256, Submission.upload_deleted_at.is_(None)
            )
            rows = session.scalars(chosen.order_by(Submission.received_at)).all()
            for row in rows:
                row.upload_deleted_at = transaction.now
                transaction.record(UPLOAD_DELETED, row, row.id)
            self.uploads.delete(sha256)
            return [row.id for row in rows]


def _expired(session: Session, before: datetime, sha256: str | None = None) -> Sequence[str]:
    """Return the files whose submissions were all received until a time and are not published."""
    chosen = select(Submission.sha256).where(Submission.upload_deleted_at.is_(None))
    if sha256 is not None:
        chosen = chosen.where(Submission.sha256 == sha256)
    latest = func.max(Submission.received_at)
    published = func.sum(case((IS_SHOWN, 1), else_=0))
    grouped = chosen.group_by(Submission.sha256).having(latest <= before, published == 0)
    return session.scalars(grouped.order_by(latest, Submission.sha256)).all()
