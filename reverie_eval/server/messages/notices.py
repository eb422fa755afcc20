"""Notices: the organiser's banner, and pausing submissions, without a restart.

The latest notice applies.
"""

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewNotice, NoticeReport
from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.store.tables import Notice, read_stored

NO_NOTICE = NoticeReport(banner="", paused=False, created_at=None)


def current_notice(session: Session, moment: datetime | None = None) -> NoticeReport:
    """Return the notice that applies now, or that applied at a moment."""
    posted = select(Notice).order_by(Notice.id.desc()).limit(1)
    if moment is not None:
        posted = posted.where(Notice.created_at <= moment)
    row = session.scalars(posted).first()
    return NO_NOTICE if row is None else read_stored(NoticeReport, row)


def post_notice(transaction: Transaction, new: NewNotice) -> NoticeReport:
    """Set or remove the banner, and pause or resume submissions."""
    row = Notice(**new.model_dump(), created_at=transaction.now)
    transaction.record("notice posted", row, SERVER, **new.model_dump())
    return read_stored(NoticeReport, row)


def change_notice(transaction: Transaction, **changes: object) -> NoticeReport:
    """Post the current notice again with some fields changed."""
    current = current_notice(transaction.session).model_dump(exclude={"created_at"})
    return post_notice(transaction, NewNotice.model_validate(current | changes))
