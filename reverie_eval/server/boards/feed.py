"""The items of Atom feeds: published results, disqualifications, corrections, and news.

They are derived from what the leaderboards show now, so that a feed never contains more: no scores
that are held back, no anonymous team, nothing that was withdrawn.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from heapq import nlargest
from uuid import NAMESPACE_URL, uuid5

from reverie_eval.schemas.service import CorrectionReport, NewsReport
from reverie_eval.server.boards.entries import Entry
from reverie_eval.server.boards.leaderboard import ANONYMOUS, Ranking
from reverie_eval.server.boards.reviews import PublishedReview
from reverie_eval.server.scoring.boards import Board

MOST_ITEMS = 50


@dataclass(frozen=True, slots=True)
class Item:
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


def items_of(ranking: Ranking) -> Iterator[Item]:
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
) -> Iterator[Item]:
    """Yield the corrections of leaderboards."""
    named = {(board.split, board.name): board for board in boards}
    for correction in corrections:
        board = named[correction.split, correction.board]
        yield Item(
            id=_urn("correction", board.split, board.name, correction.created_at.isoformat()),
            at=correction.created_at,
            title=f"{board.label}: results corrected",
            text=correction.reason,
            path=f"/splits/{board.path}#corrections",
        )


def items_of_news(news: Iterable[NewsReport]) -> Iterator[Item]:
    """Yield the organiser's news."""
    for each in news:
        yield Item(
            id=_urn("news", str(each.id), each.created_at.isoformat()),
            at=each.created_at,
            title=each.text,
            text=each.text,
            path="/",
        )


def latest(items: Iterable[Item]) -> Sequence[Item]:
    """Return the latest items, the latest first."""
    return sorted(items, key=lambda item: (item.at, item.id), reverse=True)[:MOST_ITEMS]


def _published(entry: Entry, ranking: Ranking) -> Item:
    board = ranking.board
    title, primary = _title(entry, ranking), board.primary
    if primary.key in entry.scores:
        title += f": {primary.heading} {primary.display(entry.scores[primary.key])}"
    shown = [
        f"{metric.heading} {metric.display(entry.scores[metric.key])}"
        for metric in board.task.headline_metrics(entry.scores)
    ]
    return Item(
        id=_urn("published", entry.submission_id or "", board.name),
        at=entry.published_at,
        title=title,
        text=", ".join(shown) or "Its scores are published when the phase ends.",
        path=f"/submissions/{entry.submission_id}",
        author=ranking.team(entry) or ANONYMOUS,
    )


def _disqualified(entry: Entry, review: PublishedReview, ranking: Ranking) -> Item:
    at, name = review.created_at, ranking.board.name
    return Item(
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
