"""What is announced on leaderboards and in their feeds.

News are short dated entries by the organiser; corrections and snapshots are announced beside them.

The items of Atom feeds are derived from what the leaderboards show now, so that a feed never
contains more: no scores that are held back, no anonymous team, nothing that was withdrawn.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from heapq import nlargest
from typing import Any, Literal, NamedTuple, TypeAlias
from uuid import NAMESPACE_URL, uuid5

from sqlalchemy import Select, desc, literal, select, tuple_, union_all
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewNews
from reverie_eval.schemas.service import CorrectionReport, NewsReport
from reverie_eval.server.audit.log import SERVER
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.boards.entries import Entry
from reverie_eval.server.boards.leaderboard import ANONYMOUS, Ranking
from reverie_eval.server.boards.reviews import PublishedReview
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import Correction, News, StoredSnapshot, read_stored

MOST_ITEMS = 50
"""Items of a feed, at most: the latest."""
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


@dataclass(frozen=True, slots=True)
class FeedItem:
    """An entry of a feed."""

    id: str
    """A URN, which stays the same when the server moves."""
    at: datetime
    title: str
    text: str
    path: str
    """The path of the page with more about it."""
    author: str = ""
    """A team; empty for the organiser."""


def items_of_results(ranking: Ranking) -> Iterator[FeedItem]:
    """Yield what recently happened to the results of a leaderboard, in no particular order."""
    entries = [row.entry for row in (*ranking.rows, *ranking.apart)]
    # Only items that a feed may have are formatted: there may be thousands of results.
    published = [entry for entry in entries if entry.submission_id is not None]
    for entry in nlargest(MOST_ITEMS, published, key=lambda entry: entry.published_at):
        yield _published(entry, ranking)
    disqualified = [
        (entry, review)
        for entry in published
        for review in entry.reviews
        if review.verdict == "disqualified"
    ]
    for entry, review in nlargest(MOST_ITEMS, disqualified, key=lambda pair: pair[1].created_at):
        yield _disqualified(entry, review, ranking)


def items_of_corrections(
    boards: Iterable[Board], corrections: Iterable[CorrectionReport]
) -> Iterator[FeedItem]:
    """Yield the corrections of leaderboards."""
    named = {(board.split, board.name): board for board in boards}
    for correction in corrections:
        board = named[correction.split, correction.board]
        yield FeedItem(
            id=_urn("correction", board.split, board.name, correction.created_at.isoformat()),
            at=correction.created_at,
            title=f"{board.label}: results corrected",
            text=correction.reason,
            path=f"/splits/{board.path}#corrections",
        )


def items_of_news(news: Iterable[NewsReport]) -> Iterator[FeedItem]:
    """Yield the organiser's news."""
    for each in news:
        yield FeedItem(
            id=_urn("news", str(each.id), each.created_at.isoformat()),
            at=each.created_at,
            title=each.text,
            text=each.text,
            path="/",
        )


def latest_items(items: Iterable[FeedItem]) -> Sequence[FeedItem]:
    """Return the latest items, the latest first."""
    return sorted(items, key=lambda item: (item.at, item.id), reverse=True)[:MOST_ITEMS]


def _published(entry: Entry, ranking: Ranking) -> FeedItem:
    board = ranking.board
    title, primary = _title(entry, ranking), board.primary
    if primary.key in entry.scores:
        title += f": {primary.heading} {primary.display(entry.scores[primary.key])}"
    shown = [
        f"{metric.heading} {metric.display(entry.scores[metric.key])}"
        for metric in board.task.headline_metrics(entry.scores)
    ]
    return FeedItem(
        id=_urn("published", entry.submission_id or "", board.name),
        at=entry.published_at,
        title=title,
        text=", ".join(shown) or "Its scores are published when the phase ends.",
        path=f"/submissions/{entry.submission_id}",
        author=ranking.team(entry) or ANONYMOUS,
    )


def _disqualified(entry: Entry, review: PublishedReview, ranking: Ranking) -> FeedItem:
    at, name = review.created_at, ranking.board.name
    return FeedItem(
        id=_urn("disqualified", entry.submission_id or "", name, at.isoformat()),
        at=at,
        title=f"{_title(entry, ranking)}: disqualified",
        text=review.reason,
        path=f"/submissions/{entry.submission_id}",
    )


def _title(entry: Entry, ranking: Ranking) -> str:
    team = ranking.team(entry) or ANONYMOUS
    return f"{ranking.board.label}: {entry.method['name']}, {team}"


def _urn(*parts: str) -> str:
    return uuid5(NAMESPACE_URL, "/".join(filter(None, parts))).urn
