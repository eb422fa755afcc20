"""The Atom feeds: valid, absolute, lasting, and never more than the leaderboards show."""

import re
from typing import Any
from xml.etree import ElementTree as ET

import feedparser
import pytest

from tests.support.acting import review
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


def read(server: Serving, path: str = f"/boards/{OPEN}/feed.atom") -> Any:
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
    text = site.client.get(f"/boards/{OPEN}/feed.atom").text
    assert "Blue" not in text
    assert OWNER not in text
    authors = {entry.get("author") for entry in read(site).entries}
    assert authors == {None, "Anonymous"}  # None is the organiser
    site.clock.turn(days=365)
    assert "Blue" in site.client.get(f"/boards/{OPEN}/feed.atom").text


def test_the_feed_of_all_has_every_leaderboard(site: Serving) -> None:
    publish(site)
    site.upload(OWNER, submission_for(PRIVATE), PRIVATE)
    publish(site, OTHER, PRIVATE)
    titles = [entry.title.partition(":")[0] for entry in read(site, "/feed.atom").entries]
    assert sorted(titles) == sorted([OPEN, PRIVATE])


def test_pages_lead_to_the_feeds(site: Serving) -> None:
    page = site.client.get(f"/boards/{OPEN}").text
    found = re.findall(r'<link rel="alternate" href="([^"]+)" type="application/atom\+xml"', page)
    assert found == ["/feed.atom", f"/boards/{OPEN}/feed.atom"]
    assert f'<a href="/boards/{OPEN}/feed.atom">Atom feed</a>' in page
    assert site.client.get("/boards/nowhere/feed.atom").status_code == 404
