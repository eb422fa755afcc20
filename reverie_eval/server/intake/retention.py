"""Deleting files of old submissions that are not published; rows, scores and receipts stay.

A file is deleted in the transaction that marks its submissions, so an upload of the same content
either comes before and keeps the file, or comes after and stores it again.
"""

from collections.abc import Sequence
from datetime import datetime, timedelta

from sqlalchemy import case, func, select
from sqlalchemy.orm import Session

from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import IS_SHOWN, UPLOAD_DELETED, Submission


def tidy(server: ServerState, days: int) -> Sequence[str]:
    """Delete the files of submissions that are so many days old and not published.

    A file of several submissions is deleted once all of them are old and not published. Returns the
    submissions, those with the oldest files first.
    """
    before = server.clock() - timedelta(days=days)
    with server.database.reading() as session:
        found = expired(session, before)
    return [name for sha256 in found for name in _delete(server, sha256, before)]


def expired(session: Session, before: datetime, sha256: str | None = None) -> Sequence[str]:
    """Return the files, or this one, whose submissions are all as old and not published."""
    chosen = select(Submission.sha256).where(Submission.upload_deleted_at.is_(None))
    if sha256 is not None:
        chosen = chosen.where(Submission.sha256 == sha256)
    latest = func.max(Submission.received_at)
    published = func.sum(case((IS_SHOWN, 1), else_=0))
    grouped = chosen.group_by(Submission.sha256).having(latest <= before, published == 0)
    return session.scalars(grouped.order_by(latest, Submission.sha256)).all()


def _delete(server: ServerState, sha256: str, before: datetime) -> Sequence[str]:
    """Delete a file, unless it was published or sent again meanwhile; return its submissions."""
    with server.transactions.begin(SERVER) as transaction:
        session = transaction.session
        if not expired(session, before, sha256):
            return []
        chosen = select(Submission).where(
            Submission.sha256 == sha256, Submission.upload_deleted_at.is_(None)
        )
        rows = session.scalars(chosen.order_by(Submission.received_at)).all()
        for row in rows:
            row.upload_deleted_at = transaction.now
            transaction.record(UPLOAD_DELETED, row, row.id)
        server.uploads.delete(sha256)
        return [row.id for row in rows]
