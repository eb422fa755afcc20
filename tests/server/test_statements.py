"""How often a request asks the database: once for everything, and no more than it needs."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from sqlalchemy import event

from tests.support.entries import entered
from tests.support.serving import OPEN, ORGANISER, OTHER, OWNER, PRIVATE, Serving, submission_for
from tests.support.visiting import Visitor, signed_in

PAGE, READ, UPLOAD = 8, 6, 14
"""The most statements of a page, of a read of the API, and of an upload that is scored."""


@contextmanager
def counting(server: Serving) -> Iterator[Counter[str]]:
    """Count transactions and statements."""
    counts: Counter[str] = Counter()

    def on_statement(_: Any, __: Any, statement: str, *___: Any) -> None:
        counts["statements"] += not statement.startswith(
            ("BEGIN", "PRAGMA", "SAVEPOINT", "RELEASE")
        )

    def on_begin(_: Any) -> None:
        counts["transactions"] += 1

    engine = server.state.database.engine
    event.listen(engine, "before_cursor_execute", on_statement)
    event.listen(engine, "begin", on_begin)
    yield counts
    event.remove(engine, "before_cursor_execute", on_statement)
    event.remove(engine, "begin", on_begin)


@pytest.fixture
def busy(server: Serving) -> Serving:
    """Return a server with something on every page."""
    for split in (OPEN, PRIVATE):
        submission = server.upload(OWNER, submission_for(split), split).json()["submission"]
        path = f"/submissions/{submission['id']}"
        assert server.ask(OWNER, "PATCH", path, json={"published": True}).status_code == 200
    server.ask(ORGANISER, "PUT", "/organiser/notice", json={"banner": "Hello"})
    return server


PAGES = {
    "the first page": (None, "/"),
    "the board": (None, "/boards/{split}"),
    "the board, signed in": (OWNER, "/boards/{split}"),
    "the chart": (None, "/boards/{split}/chart"),
    "a publication": (None, "/submissions/{submission_id}"),
    "a submission": (OWNER, "/submissions/{submission_id}"),
    "the team": (OWNER, "/team"),
    "the form": (OWNER, "/submit"),
    "the episodes": (OWNER, "/episodes"),
    "an episode": (OWNER, "/episodes/{split}/1196_0_0?submission={submission_id}"),
    "the guide": (OWNER, "/guide"),
    "the desk": (ORGANISER, "/desk"),
    "people": (ORGANISER, "/desk/people"),
    "quotas": (ORGANISER, "/desk/quotas"),
    "snapshots": (ORGANISER, "/desk/snapshots"),
    "phases": (ORGANISER, "/desk/phases"),
    "reviews": (ORGANISER, "/desk/reviews?submission={submission_id}"),
    "reported results": (ORGANISER, "/desk/reported"),
    "the notice": (ORGANISER, "/desk/notice"),
    "uploads": (ORGANISER, "/desk/uploads"),
    "the audit log": (ORGANISER, "/desk/audit"),
    "not found": (OWNER, "/submissions/none"),
}


REFUSED = {"/submissions/none": 404}


@pytest.mark.parametrize(("who", "path"), PAGES.values(), ids=PAGES)
def test_a_page_is_one_snapshot_of_the_database(who: str | None, path: str, busy: Serving) -> None:
    visitor = signed_in(busy, who) if who else Visitor(busy)
    place = path.format(**parts(busy))
    visitor.get(place)  # what boards show is kept until something changes
    with counting(busy) as counts:
        reply = visitor.get(place)
    assert reply.status_code == REFUSED.get(path, 200)
    assert 0 < counts["statements"] <= PAGE
    assert counts["transactions"] == 1 + (path in REFUSED)  # the second for the page that says so


def test_a_comparison_is_one_snapshot_of_the_database(busy: Serving) -> None:
    ids = (parts(busy)["submission_id"], entered(busy, who=OTHER))
    visitor, place = signed_in(busy, OWNER), "/boards/{}/compare?result={}&result={}"
    visitor.get(place.format(OPEN, *ids))
    with counting(busy) as counts:
        assert visitor.get(place.format(OPEN, *ids)).status_code == 200
    assert 0 < counts["statements"] <= PAGE
    assert counts["transactions"] == 1


def test_a_page_that_is_not_allowed_looks_up_its_visitor_once(busy: Serving) -> None:
    visitor = signed_in(busy, OWNER)
    with counting(busy) as counts:
        assert visitor.get("/desk/people").status_code == 403
    assert counts["statements"] == 2  # who it is, and the banner
    assert counts["transactions"] == 2


READS = (
    "/me",
    "/server",
    "/splits",
    "/splits/{split}",
    "/splits/{split}/leaderboard",
    "/splits/{split}/leaderboard.csv",
    "/submissions",
    "/submissions/{submission_id}",
    "/submissions/{submission_id}/receipt",
    "/submissions/{submission_id}/receipt/envelope",
    "/submissions/{submission_id}/file",
    "/organiser/teams",
    "/organiser/people",
    "/organiser/tokens",
    "/organiser/grants",
    "/organiser/reviews",
    "/organiser/reported",
    "/organiser/notice",
    "/organiser/schedules",
    "/organiser/attempts",
    "/organiser/audit",
)


@pytest.mark.parametrize("path", READS)
def test_a_read_is_one_snapshot_of_the_database(path: str, busy: Serving) -> None:
    place = path.format(**parts(busy))
    busy.ask(ORGANISER, "GET", place)
    with counting(busy) as counts:
        assert busy.ask(ORGANISER, "GET", place).status_code == 200
    assert counts["statements"] <= READ
    assert counts["transactions"] == 1


@pytest.mark.parametrize("key", [None, "mine"], ids=["an upload", "an upload with a key"])
def test_an_upload_asks_no_more_than_it_needs(key: str | None, busy: Serving) -> None:
    with counting(busy) as counts:
        assert busy.upload(OWNER, busy.distinct(), key=key).status_code == 201
    assert counts["statements"] <= UPLOAD
    assert counts["transactions"] == 4  # who sends it; before; after it was scored; its outcome


def test_further_leaderboards_take_no_statement_more(several: Serving) -> None:
    with counting(several) as counts:
        assert several.upload(OWNER).status_code == 201
    assert counts["statements"] <= UPLOAD


def parts(server: Serving) -> dict[str, str]:
    listed = server.ask(OWNER, "GET", "/submissions").json()
    return {"split": OPEN, "submission_id": next(e["id"] for e in listed if e["split"] == OPEN)}
