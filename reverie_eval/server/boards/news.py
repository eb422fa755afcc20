"""News: short dated entries by the organiser, shown on the leaderboards and in their feeds."""

from collections.abc import Sequence
from functools import partial

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewNews
from reverie_eval.schemas.service import NewsReport
from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import News, read_stored

_STANDING = select(News).where(News.removed_at.is_(None))


def add_news(transaction: Transaction, new: NewNews) -> NewsReport:
    """Post an entry; it is public at once."""
    row = News(text=new.text, created_at=transaction.now)
    transaction.record("news added", row, SERVER, text=row.text)
    return read_stored(NewsReport, row)


def remove_news(transaction: Transaction, news_id: int) -> NewsReport:
    """Remove an entry. Raises NotFoundError if it does not exist, or was removed already."""
    row = transaction.session.get(News, news_id)
    if row is None or row.removed_at is not None:
        raise NotFoundError(f"there is no news entry {news_id}; `news list` shows all")
    row.removed_at = transaction.now
    transaction.record("news removed", row, SERVER, text=row.text)
    return read_stored(NewsReport, row)


def list_news(session: Session, page: Page) -> Listed[NewsReport]:
    """List the entries that were not removed, the latest first."""
    report = partial(read_stored, NewsReport)
    return list_page(session, _STANDING, News.id, page, report, newest_first=True)


def latest_news(session: Session, limit: int) -> Sequence[NewsReport]:
    """Return the latest entries, the latest first."""
    return list_news(session, Page(limit)).rows
