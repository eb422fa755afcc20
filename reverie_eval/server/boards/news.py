"""What the organiser announces on leaderboards and in their feeds.

News are short dated entries; corrections and snapshots are announced beside them.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Any, Literal, NamedTuple, TypeAlias

from sqlalchemy import Select, desc, literal, select, tuple_, union_all
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewNews
from reverie_eval.schemas.service import CorrectionReport, NewsReport
from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import Correction, News, StoredSnapshot, read_stored

Kind: TypeAlias = Literal["news", "correction", "snapshot"]

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


class Announcement(NamedTuple):
    """A dated line on the page of a leaderboard."""

    kind: Kind
    number: int
    """The number of a snapshot, or the id of anything else."""
    text: str
    at: datetime
    """When it was announced; for a snapshot, the time of the copy."""


def announcements(
    session: Session, board: Board, most_news: int
) -> Mapping[Kind, Sequence[Announcement]]:
    """Return the latest news, and all corrections and snapshots of a leaderboard, in one statement.

    The latest come first; a kind without any is empty. Only a split's own leaderboard has
    snapshots.
    """
    news = _lines("news", News.id, News.text, News.created_at)
    news = news.where(News.removed_at.is_(None)).order_by(News.id.desc()).limit(most_news)
    corrections = _lines("correction", Correction.id, Correction.reason, Correction.created_at)
    corrections = corrections.where(Correction.split == board.split, Correction.board == board.name)
    snapshot = (StoredSnapshot.number, StoredSnapshot.title, StoredSnapshot.as_of)
    snapshots = _lines("snapshot", *snapshot).where(StoredSnapshot.split == board.split)
    shown = [select(news.subquery()), corrections, *([] if board.name else [snapshots])]
    found: defaultdict[Kind, list[Announcement]] = defaultdict(list)
    for row in session.execute(union_all(*shown).order_by(desc("number"))):
        found[row.kind].append(Announcement(*row))
    return found


def _lines(kind: Kind, number: Any, text: Any, at: Any) -> Select[*tuple[Any, ...]]:
    columns = {"kind": literal(kind), "number": number, "text": text, "at": at}
    return select(*(column.label(name) for name, column in columns.items()))


def corrections_of(session: Session, *boards: Board) -> Sequence[CorrectionReport]:
    """Return the corrections of one or several leaderboards, the latest first."""
    is_theirs = tuple_(Correction.split, Correction.board).in_(
        [(board.split, board.name) for board in boards]
    )
    rows = session.scalars(select(Correction).where(is_theirs).order_by(Correction.id.desc()))
    return [read_stored(CorrectionReport, row) for row in rows]
