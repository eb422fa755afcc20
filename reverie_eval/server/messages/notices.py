"""Notices: the organiser's banner, and pausing submissions, without a restart.

The latest notice applies. If it has no banner, that of the settings is shown. If the settings pause
submissions, a notice cannot resume them.
"""

from datetime import datetime
from typing import Self

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewNotice, NoticeReport
from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Notice, read_stored


class Notices:
    """The posted notices, combined with the settings."""

    def __init__(self, banner: str, *, paused: bool) -> None:
        self.of_settings = NoticeReport(banner=banner, paused=paused, created_at=None)
        """The notice of the settings; used where the database is not read."""

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the notices of a server."""
        return cls(server.settings.banner, paused=server.settings.paused)

    def current(self, session: Session, moment: datetime | None = None) -> NoticeReport:
        """Return the notice that applies now, or that applied at a moment."""
        posted = latest_notice(session, moment)
        if posted is None:
            return self.of_settings
        new = read_stored(NewNotice, posted)
        return self.if_posted(new, posted.created_at)

    def if_posted(self, new: NewNotice, at: datetime) -> NoticeReport:
        """Return what the current notice would be if this one were posted."""
        return NoticeReport(
            banner=new.banner or self.of_settings.banner,
            paused=new.paused or self.of_settings.paused,
            created_at=at,
        )

    def post(self, transaction: Transaction, new: NewNotice) -> NoticeReport:
        """Post a notice: set or remove the banner, pause or resume submissions."""
        posted = Notice(**new.model_dump(), created_at=transaction.now)
        transaction.record("notice posted", posted, SERVER, **new.model_dump())
        return self.if_posted(new, posted.created_at)

    def change(self, transaction: Transaction, **changes: object) -> NoticeReport:
        """Post the latest notice again with some fields changed, as :meth:`post` does."""
        posted = latest_notice(transaction.session)
        latest = read_stored(NewNotice, posted) if posted else NewNotice()
        return self.post(transaction, latest.model_copy(update=changes))


def latest_notice(session: Session, until: datetime | None = None) -> Notice | None:
    """Return the latest notice, of all or of those posted until a moment; None without one."""
    posted = select(Notice).order_by(Notice.id.desc()).limit(1)
    if until is not None:
        posted = posted.where(Notice.created_at <= until)
    return session.scalars(posted).first()
