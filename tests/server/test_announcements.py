"""What the organiser announces on the page of a leaderboard."""

from datetime import timedelta

import pytest

from reverie_eval.schemas.organising import NewNews, NewSnapshot
from reverie_eval.server.boards.news import (
    Announcement,
    add_news,
    announcements,
    corrections_of,
    remove_news,
)
from reverie_eval.server.corrections.snapshots import Snapshots, list_snapshots
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import Correction
from tests.support.acting import NOON
from tests.support.serving import OPEN, PRIVATE, STRICT, Serving

SECOND = timedelta(seconds=1)


def correct(server: Serving, split: str, board: str, reason: str) -> None:
    """Announce a correction."""
    about = {"split": split, "board": board, "reason": reason, "signature": "s"}
    with server.state.database.writing() as session:
        session.add(Correction(**about, created_at=server.clock()))


@pytest.fixture
def announced(several: Serving) -> Serving:
    """Announce something of each kind on three leaderboards, a second apart."""
    for name, split, text in (
        ("", OPEN, "first"),
        (STRICT, OPEN, "strict"),
        ("", PRIVATE, "private"),
        ("", OPEN, "second"),
    ):
        correct(several, split, name, text)
        with several.acting() as transaction:
            if not name:
                several.state.get(Snapshots).take(transaction, NewSnapshot(split=split, title=text))
            news = add_news(transaction, NewNews(text=text))
            if text == "private":
                remove_news(transaction, news.id)
        several.clock.turn(seconds=1)
    return several


def test_a_leaderboard_has_its_own_and_the_latest_news_first(announced: Serving) -> None:
    state = announced.state
    with state.database.reading() as session:
        own, strict = (announcements(session, state.board(OPEN, name), 2) for name in ("", STRICT))
        none = announcements(session, state.board(PRIVATE), 0)
    news = [Announcement("news", 4, "second", NOON + 3 * SECOND)]
    news.append(Announcement("news", 2, "strict", NOON + SECOND))
    assert own == {
        "news": news,
        "correction": [
            Announcement("correction", 4, "second", NOON + 3 * SECOND),
            Announcement("correction", 1, "first", NOON),
        ],
        "snapshot": [
            Announcement("snapshot", 2, "second", NOON + 3 * SECOND),
            Announcement("snapshot", 1, "first", NOON),
        ],
    }
    corrections = [Announcement("correction", 2, "strict", NOON + SECOND)]
    assert strict == {"news": news, "correction": corrections}
    assert [*none] == ["correction", "snapshot"]


def test_corrections_are_those_of_the_leaderboard(announced: Serving) -> None:
    state = announced.state
    with state.database.reading() as session:
        boards = state.board(OPEN), state.board(PRIVATE), state.board(OPEN, STRICT)
        found = [[each.reason for each in corrections_of(session, board)] for board in boards]
    assert found == [["second", "first"], ["private"], ["strict"]]


def test_snapshots_of_all_splits_are_listed_the_latest_first(announced: Serving) -> None:
    with announced.state.database.reading() as session:
        titles = [each.title for each in list_snapshots(session, Page()).rows]
        of_split = [each.title for each in list_snapshots(session, Page(), OPEN).rows]
    assert titles == ["second", "private", "first"]
    assert of_split == ["second", "first"]
