"""The Atom feeds: valid, absolute, lasting, and never more than the leaderboards show."""

import re
from dataclasses import replace
from datetime import timedelta
from typing import Any
from uuid import NAMESPACE_URL, uuid5
from xml.etree import ElementTree as ET

import feedparser
import pytest

from reverie_eval.schemas.service import CorrectionReport, NewsReport
from reverie_eval.server.boards.entries import Row
from reverie_eval.server.boards.news import (
    FeedItem,
    items_of_corrections,
    items_of_news,
    items_of_results,
    latest_items,
)
from reverie_eval.server.boards.reviews import PublishedReview
from tests.support.acting import NOON, review
from tests.support.entries import demo_board, entry, ranking_of
from tests.support.serving import (
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    OpenServer,
    Serving,
    settings_of,
    submission_for,
)

ADDRESS = "https://eval.example.org"
MARKUP = "<b>Walker</b> & 'co'"
ATOM = "{http://www.w3.org/2005/Atom}"


@pytest.fixture
def site(folder: Any, open_server: OpenServer) -> Serving:
    return open_server(settings_of(folder).model_copy(update={"public_address": ADDRESS}))


def publish(server: Serving, who: str = OWNER, split: str = OPEN, **method: str) -> str:
    """Upload a result and publish it; return its id."""
    content = server.distinct(split)
    submission = server.upload(who, content, split, **method).json()["submission"]["id"]
    change = {"published": True}
    server.ask(who, "PATCH", f"/submissions/{submission}", json=change).raise_for_status()
    return str(submission)


def read(server: Serving, path: str = f"/splits/{OPEN}/feed.atom") -> Any:
    """Return a feed as a reader understands it, after looking whether it is valid."""
    reply = server.client.get(path)
    assert reply.headers["content-type"].startswith("application/atom+xml")
    feed = feedparser.parse(reply.content)
    assert not feed.bozo
    assert feed.version == "atom10"
    root = ET.fromstring(reply.content)  # our own
    for element in (root, *root.iter(f"{ATOM}entry")):  # RFC 4287, sections 4.1.1 and 4.1.2
        assert all(
            len(element.findall(f"{ATOM}{name}")) == 1 for name in ("id", "title", "updated")
        )
        assert all(
            link.get("href", "").startswith(f"{ADDRESS}/") for link in element.iter(f"{ATOM}link")
        )
    assert re.fullmatch(r"\S+T\S+\+00:00", root.findtext(f"{ATOM}updated", ""))
    return feed


def test_an_empty_feed_is_valid(site: Serving) -> None:
    assert read(site).entries == []
    assert read(site, "/feed.atom").feed.links[0].href == f"{ADDRESS}/feed.atom"


def test_a_feed_tells_results_disqualifications_and_news_the_latest_first(site: Serving) -> None:
    first = publish(site, name=MARKUP)
    site.clock.turn(hours=1)
    site.ask(ORGANISER, "POST", "/organiser/news", json={"text": "Soon <i>over</i>"})
    site.clock.turn(hours=1)
    with site.acting() as transaction:
        review(transaction, first, "disqualified", "trained on test")
    entries = read(site).entries
    assert [entry.title for entry in entries] == [
        f"{OPEN}: {MARKUP}, Blue: disqualified",
        "Soon <i>over</i>",
        f"{OPEN}: {MARKUP}, Blue: RGSPL % 57.22",
    ]
    assert entries[0].summary == "trained on test"
    assert entries[-1].link == f"{ADDRESS}/submissions/{first}"
    assert len({entry.id for entry in entries}) == len(entries)


def test_ids_and_times_last_when_other_things_change(site: Serving) -> None:
    first = publish(site)
    (before,) = read(site).entries
    site.clock.turn(days=1)
    publish(site, OTHER, name="Runner")
    site.ask(OWNER, "PATCH", f"/submissions/{first}", json={"method": {"name": "Renamed"}})
    after = read(site).entries[-1]
    assert (after.id, after.updated) == (before.id, before.updated)
    assert "Renamed" in after.title


def test_a_withdrawn_or_unpublished_result_is_in_no_feed(site: Serving) -> None:
    site.upload(OTHER)
    withdrawn = publish(site)
    site.ask(OWNER, "PATCH", f"/submissions/{withdrawn}", json={"withdrawn": True})
    assert read(site).entries == []


def test_an_anonymous_team_stays_anonymous_until_its_date(site: Serving) -> None:
    submission = publish(site)
    hidden = {"anonymous_until": "2026-12-31T00:00:00Z"}
    site.ask(OWNER, "PATCH", f"/submissions/{submission}", json=hidden).raise_for_status()
    site.ask(OWNER, "PATCH", f"/submissions/{submission}", json={"method": {"name": "Edited"}})
    with site.acting() as transaction:
        review(transaction, submission, "disqualified")
    text = site.client.get(f"/splits/{OPEN}/feed.atom").text
    assert "Blue" not in text
    assert OWNER not in text
    authors = {entry.get("author") for entry in read(site).entries}
    assert authors == {None, "Anonymous"}  # None is the organiser
    site.clock.turn(days=365)
    assert "Blue" in site.client.get(f"/splits/{OPEN}/feed.atom").text


def test_the_feed_of_all_has_every_leaderboard(site: Serving) -> None:
    publish(site)
    site.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    publish(site, OTHER, PRIVATE)
    titles = [entry.title.partition(":")[0] for entry in read(site, "/feed.atom").entries]
    assert sorted(titles) == sorted([OPEN, PRIVATE])


def test_pages_lead_to_the_feeds(site: Serving) -> None:
    page = site.client.get(f"/splits/{OPEN}").text
    found = re.findall(r'<link rel="alternate" href="([^"]+)" type="application/atom\+xml"', page)
    assert found == ["/feed.atom", f"/splits/{OPEN}/feed.atom"]
    assert f'<a href="/splits/{OPEN}/feed.atom">Atom feed</a>' in page
    assert site.client.get("/splits/nowhere/feed.atom").status_code == 404


# Without a server.

SECOND = timedelta(seconds=1)


def urn(text: str) -> str:
    """Return an id as feeds have them: a UUID of what it is about."""
    return f"urn:uuid:{uuid5(NAMESPACE_URL, text)}"


def test_what_a_result_is_called_and_where_it_is() -> None:
    scored = entry(scores={"rgspl": 0.5, "spl": 0.25, "ndtw": 0.75})
    hidden = entry("Cat", published_at=NOON + SECOND, anonymous_until=NOON + SECOND)
    paper = entry("Paper", submission_id=None, team_id=None)
    rows = Row(1, scored), Row(None, paper)
    ranking = ranking_of(*rows, apart=[Row(None, hidden)])
    first = FeedItem(
        id=urn("published/cat"),
        at=NOON + SECOND,
        title="val_unseen: Cat, Anonymous",
        text="Its scores are published when the phase ends.",
        path="/submissions/cat",
        author="Anonymous",
    )
    second = FeedItem(
        id=urn("published/walker"),
        at=NOON,
        title="val_unseen: Walker, Blue: RGSPL % 50.00",
        text="SPL % 25.00, RGSPL % 50.00",
        path="/submissions/walker",
        author="Blue",
    )
    assert list(items_of_results(ranking)) == [first, second]
    strict = replace(demo_board(), name="strict")
    items = items_of_results(replace(ranking, board=strict))
    assert [each.id for each in items] == [
        urn("published/cat/strict"),
        urn("published/walker/strict"),
    ]


def test_what_the_organiser_did_is_of_the_organiser() -> None:
    at = NOON + SECOND
    flagged = PublishedReview("flagged", "a doubt", NOON)
    disqualified = PublishedReview("disqualified", "trained on it", at)
    judged = entry(reviews=[flagged, disqualified])
    about = {"split": OPEN, "board": "strict", "signature": "new"}
    corrected = CorrectionReport(**about, created_at=at, reason="Targets.")
    strict = replace(demo_board(), name="strict")
    _, *items = items_of_results(ranking_of(apart=[Row(None, judged)], board=strict))
    assert [*items, *items_of_corrections([strict], [corrected])] == [
        FeedItem(
            id=urn("disqualified/walker/strict/2026-03-02T12:00:01+00:00"),
            at=at,
            title="val_unseen, strict: Walker, Blue: disqualified",
            text="trained on it",
            path="/submissions/walker",
        ),
        FeedItem(
            id=urn("correction/val_unseen/strict/2026-03-02T12:00:01+00:00"),
            at=at,
            title="val_unseen, strict: results corrected",
            text="Targets.",
            path="/splits/val_unseen/boards/strict#corrections",
        ),
    ]
    news = NewsReport(id=3, text="Soon over", created_at=at)
    assert list(items_of_news([news])) == [
        FeedItem(
            id=urn("news/3/2026-03-02T12:00:01+00:00"),
            at=at,
            title="Soon over",
            text="Soon over",
            path="/",
        )
    ]


def test_a_feed_has_the_latest_fifty() -> None:
    rows = [
        Row(
            None,
            entry(
                f"M{age}",
                published_at=NOON - age * SECOND,
                reviews=[PublishedReview("disqualified", f"R{age}", NOON + age * SECOND)],
            ),
        )
        for age in range(51)
    ]
    items = list(items_of_results(ranking_of(*rows)))
    assert [each.path for each in items[:50]] == [f"/submissions/m{age}" for age in range(50)]
    assert [each.text for each in items[50:]] == [f"R{age}" for age in range(50, 0, -1)]
    same_time = [FeedItem(id=name, at=NOON, title="", text="", path="/") for name in "bca"]
    assert [each.id for each in latest_items(same_time)] == ["c", "b", "a"]
    assert latest_items(items) == items[50:]
