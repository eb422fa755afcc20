"""What the Atom feeds tell: published results, disqualifications, corrections, and news.

It is worked out from what the leaderboards show now, so that a feed never has more than they have:
no scores that are held back, no team that is anonymous, nothing that was withdrawn.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from uuid import NAMESPACE_URL, uuid5

from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.service import NewsReport
from reverie_eval.server.service.entries import Entry
from reverie_eval.server.service.leaderboard import ANONYMOUS, Ranking

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
    """Of the page with more about it."""
    author: str = ""
    """A team; empty for the organiser."""


def items_of(ranking: Ranking) -> Iterator[Item]:
    """Yield what happened on a leaderboard, in no order."""
    board = ranking.board
    for row in (*ranking.rows, *ranking.apart):
        if row.entry.submission_id is not None:
            yield from _items_of_entry(row.entry, row.entry.submission_id, ranking)
    for correction in ranking.corrections:
        yield Item(
            id=_urn("correction", board.name, board.further, correction.created_at.isoformat()),
            at=correction.created_at,
            title=f"{board.label}: results corrected",
            text=correction.reason,
            path=f"/boards/{board.path}#corrections",
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


def _items_of_entry(entry: Entry, submission_id: str, ranking: Ranking) -> Iterator[Item]:
    name, board = entry.method["name"], ranking.board
    team = ranking.team(entry) or ANONYMOUS
    path = f"/submissions/{submission_id}"
    primary = board.primary
    score = entry.scores.get(primary.key)
    title = f"{board.label}: {name}, {team}"
    if score is not None:
        title += f": {primary.heading} {primary.display(score)}"
    shown = [
        f"{metric.heading} {metric.display(entry.scores[key])}"
        for key, metric in CATALOGUE.items()
        if metric.headline and key in entry.scores
    ]
    text = ", ".join(shown) or "Its scores are published when the phase ends."
    published = _urn("published", submission_id, board.further)
    yield Item(published, entry.published_at, title, text, path, team)
    for review in entry.reviews:
        if review.verdict == "disqualified":
            yield Item(
                id=_urn(
                    "disqualified", submission_id, board.further, review.created_at.isoformat()
                ),
                at=review.created_at,
                title=f"{board.label}: {name}, {team}: disqualified",
                text=review.reason,
                path=path,
            )


def _urn(*parts: str) -> str:
    return uuid5(NAMESPACE_URL, "/".join(filter(None, parts))).urn
