"""How often a request asks the database: once for everything, and no more than it needs.

Each GET request of the API and of the pages is counted: pages by their examples, reads of the API
by :data:`READS`. A route without an example fails.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import event

from reverie_eval.ground_truth import DEMO_BUNDLES, bundle_folder
from reverie_eval.runner import run_agent
from reverie_eval.schemas.organising import NewMerge
from reverie_eval.server.accounts.people import merge_teams
from reverie_eval.server.boards.leaderboard import Rankings
from reverie_eval.server.operations import health
from reverie_eval.server.settings import Split
from reverie_eval.tasks import BUILT_IN, name_on_server
from tests.support.acting import review
from tests.support.demo_site import BOLD, ENDLESS, Site
from tests.support.description import API, Description
from tests.support.entries import entered, report_result
from tests.support.page_routes import EXAMPLES, FILES, Example
from tests.support.serving import (
    GROUNDING,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PEOPLE,
    PRIVATE,
    OpenServer,
    Serving,
)
from tests.support.visiting import Visitor, signed_in

PAGE, READ, UPLOAD = 8, 6, 16
"""The most statements of a page, of a read of the API, and of an upload that is scored."""
PUBLICATION = 10
"""The most of publishing a submission, besides looking up who does: intervals are computed between
two transactions. It is the same with other leaderboards."""
FORM = 3
"""The most that a file sent by the form of the desk takes besides: who is signed in, who sent it,
and the page with the reply."""


@pytest.fixture(autouse=True)
def _health_is_examined_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no request on a slow machine find that the last report of health is too old."""
    monkeypatch.setattr(health, "SECONDS_KEPT", math.inf)


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


def forget(server: Serving) -> None:
    """Let the next request find nothing of leaderboards, as after a change of all of them."""
    server.state.services.pop(Rankings, None)


@dataclass(frozen=True)
class Busy:
    """A server with something on every page, and the browsers of its people."""

    server: Serving
    site: Site
    visitors: dict[str | None, Visitor]

    def get(self, who: str | None, path: str) -> tuple[httpx.Response, Counter[str]]:
        """Request something, and count."""
        with counting(self.server) as counts:
            reply = self.visitors[who].get(path)
        return reply, counts


@pytest.fixture(scope="module")
def busy(shared: Serving) -> Busy:
    """Fill a server whose splits have other leaderboards; tests only read from it."""
    ids = {
        (OPEN, "Walker"): entered(shared),
        (OPEN, BOLD): entered(shared, who=OTHER),
        (OPEN, ENDLESS): entered(shared, who=OTHER),
        (PRIVATE, "Shortest paths"): entered(shared, split=PRIVATE),
        (PRIVATE, "Random walker"): entered(shared, who=OTHER, split=PRIVATE),
    }
    report_result(shared, "FAST", rgspl=0.25)
    with shared.acting(ORGANISER) as transaction:
        review(transaction, ids[OPEN, "Walker"], "verified")
    for method, path, content in (
        ("PUT", "/organiser/notice", {"banner": "Hello"}),
        ("POST", "/organiser/news", {"text": "We moved."}),
        ("POST", "/organiser/snapshots", {"split": OPEN, "title": "The first month"}),
    ):
        assert shared.ask(ORGANISER, method, path, json=content).is_success
    shared.upload(OWNER, b"[]")
    visitors: dict[str | None, Visitor] = {None: Visitor(shared)}
    visitors |= {who: signed_in(shared, who) for who in PEOPLE}
    site = Site("", Path(), shared.tokens, ids)
    return Busy(shared, site, visitors)


PAGES = (*EXAMPLES, *FILES)
MANY = {"/desk/corrections": 9}
"""Pages that ask more than others: once for each of so many leaderboards."""
REFUSED = {
    "/splits/{split}/boards/{board}/compare": (400, 2),
    "/episodes/{split}/{instr_id}/view": (400, 1),
    "/no-such-page": (404, 1),
}
"""Pages that say why there is no page: status and transactions."""


def visitors_of(example: Example) -> Sequence[str | None]:
    """Return who looks at an example: who is signed in has more to look up."""
    return [example.who if example.who in PEOPLE else OTHER] if example.who else [None, ORGANISER]


@pytest.mark.parametrize("example", PAGES, ids=[each.name for each in PAGES])
def test_a_page_is_one_snapshot_of_the_database(example: Example, busy: Busy) -> None:
    status, transactions = REFUSED.get(example.route, (200, 1))
    path = example.path(busy.site)
    for who in visitors_of(example):
        busy.get(who, path)  # tries the database for /healthz
        forget(busy.server)
        for time in ("first", "second"):
            reply, counts = busy.get(who, path)
            assert reply.status_code == status, (time, who)
            assert 0 < counts["statements"] <= PAGE + MANY.get(example.route, 0), (time, who)
            assert counts["transactions"] == transactions, (time, who)


def test_a_page_that_is_not_there_looks_up_its_visitor_once(busy: Busy) -> None:
    reply, counts = busy.get(OWNER, "/submissions/none")
    assert reply.status_code == 404
    assert 0 < counts["statements"] <= PAGE
    assert counts["transactions"] == 2  # the second for the page that says so


def test_a_page_that_is_not_allowed_looks_up_its_visitor_once(busy: Busy) -> None:
    reply, counts = busy.get(OWNER, "/desk/people")
    assert reply.status_code == 403
    assert counts["statements"] == 2  # who it is, and the banner
    assert counts["transactions"] == 2


READS = (
    "/me",
    "/server",
    "/news",
    "/keys",
    "/splits",
    "/splits/{split}",
    "/splits/{split}/leaderboard",
    "/splits/{split}/leaderboard.csv",
    "/splits/{split}/boards/{board}/leaderboard",
    "/splits/{split}/boards/{board}/leaderboard.csv",
    "/splits/{split}/snapshots",
    "/splits/{split}/snapshots/{number}",
    "/splits/{split}/snapshots/{number}.csv",
    "/submissions",
    "/submissions/{submission_id}",
    "/submissions/{submission_id}/receipt",
    "/submissions/{submission_id}/boards/{board}/receipt",
    "/submissions/{submission_id}/file",
    "/submissions/{submission_id}/episodes",
    "/organiser/teams",
    "/organiser/people",
    "/organiser/people/{person_id}",
    "/organiser/requests",
    "/organiser/tokens",
    "/organiser/grants",
    "/organiser/reviews",
    "/organiser/reported",
    "/organiser/notice",
    "/organiser/schedules",
    "/organiser/attempts",
    "/organiser/audit",
    "/organiser/splits/{split}/submissions.tar",
)
ASKS_NOTHING = {"/key", "/metrics", "/splits/{split}/episodes.txt"}
"""Reads that do not ask the database."""
TRIES_EVERYTHING = {"/healthz", "/readyz"}
"""Reads that use the database to see whether it works, at most once in some seconds."""


def test_every_read_of_the_api_is_counted(busy: Busy) -> None:
    described = {name for name, _ in Description(busy.server).operations()}
    counted = {*READS, *ASKS_NOTHING, *TRIES_EVERYTHING}
    assert {name for name in described if name.startswith("GET ")} == {
        f"GET {path}" for path in counted
    }


@pytest.mark.parametrize("path", READS)
def test_a_read_is_one_snapshot_of_the_database(path: str, busy: Busy) -> None:
    ids = busy.site.ids
    place = f"{API}{path}".format(
        split=OPEN, board=GROUNDING, number=1, person_id=1, submission_id=ids[OPEN, "Walker"]
    )
    busy.get(ORGANISER, place)
    forget(busy.server)
    for time in ("first", "second"):
        reply, counts = busy.get(ORGANISER, place)
        assert reply.status_code == 200, time
        assert 0 < counts["statements"] <= READ, time
        assert counts["transactions"] == 1, time


@pytest.mark.parametrize(
    ("path", "most"),
    [
        pytest.param(f"{API}/splits/{OPEN}/leaderboard", READ, id="read"),
        pytest.param(f"/splits/{OPEN}", PAGE, id="page"),
    ],
)
def test_neither_an_upload_nor_a_publication_and_a_merge_make_a_leaderboard_take_more(
    path: str, most: int, server: Serving
) -> None:
    visitor = signed_in(server, ORGANISER)
    for who in (OWNER, OTHER):
        entered(server, who=who)
    visitor.get(path)
    found = []
    for is_merge in (False, True):
        if is_merge:
            entered(server)
            with server.acting() as transaction:
                merge_teams(transaction, NewMerge(team=PEOPLE[OTHER], into=PEOPLE[OWNER]))
        else:
            server.upload(OWNER, server.distinct())
        with counting(server) as counts:
            assert visitor.get(path).status_code == 200
        found.append(counts["statements"])
    assert 0 < found[0] < found[1] <= most


@pytest.mark.parametrize("path", sorted(ASKS_NOTHING))
def test_what_is_no_secret_of_the_database_does_not_ask_it(path: str, busy: Busy) -> None:
    place = path if path == "/metrics" else f"{API}{path}".format(split=OPEN)
    _, counts = busy.get(None, place)
    assert counts["statements"] == counts["transactions"] == 0


@pytest.mark.parametrize("key", [None, "mine"], ids=["an upload", "an upload with a key"])
def test_an_upload_asks_no_more_than_it_needs(key: str | None, server: Serving) -> None:
    server.upload(OWNER, server.distinct())
    with counting(server) as counts:
        assert server.upload(OWNER, server.distinct(), key=key).status_code == 201
    assert counts["statements"] <= UPLOAD
    assert counts["transactions"] == 4  # who sends it; before and after it was scored; its record


def test_other_leaderboards_take_no_statement_more(several: Serving) -> None:
    with counting(several) as counts:
        reply = several.upload(OWNER)
    assert reply.status_code == 201
    assert counts["statements"] <= UPLOAD
    path = f"/submissions/{reply.json()['submission']['id']}"
    with counting(several) as counts:
        assert several.ask(OWNER, "PATCH", path, json={"published": True}).status_code == 200
    assert counts["statements"] <= 1 + PUBLICATION
    assert counts["transactions"] == 3  # who it is; before; after the intervals were computed


@pytest.mark.parametrize(
    ("more", "statements", "transactions"),
    [
        pytest.param({}, UPLOAD, 5, id="stored"),
        pytest.param({"publish": "true"}, UPLOAD + PUBLICATION, 7, id="published"),
    ],
)
def test_a_file_of_somebody_else_is_an_upload_and_a_publication(
    more: dict[str, str], statements: int, transactions: int, several: Serving
) -> None:
    about = {"split": OPEN, "received_at": several.clock().isoformat(), "name": "Walker", **more}
    sender = {"team": PEOPLE[OWNER], "person": OWNER}
    with counting(several) as counts:
        reply = several.ask(
            ORGANISER,
            "POST",
            "/organiser/submissions",
            content=several.distinct(),
            params={**about, **sender},
        )
    assert reply.status_code == 201
    assert counts["statements"] <= statements
    assert counts["transactions"] == transactions
    desk = signed_in(several, ORGANISER)
    csrf_token, person = desk.csrf_token(), {"person": str(several.person(OWNER).id)}
    with counting(several) as counts:
        reply = desk.send(
            "/desk/emailed-files",
            {**about, **person},
            file=several.distinct(),
            csrf_token=csrf_token,
        )
    assert "was scored on" in reply.text
    assert counts["statements"] <= statements + FORM
    assert counts["transactions"] == transactions + 2


OF_ALL_SPLITS = {
    "/": (0, 1),
    "/episodes": (2, 2),
    "/feed.atom": (0, 1),
    "/desk": (0, 0),
    "/desk/corrections": (1, 1),
    "/desk/phases": (0, 0),
    "/desk/quotas": (0, 0),
}
"""Pages with something of every split, and how many statements each split adds at most: while
results are kept, and after a change of all of them."""


def test_more_splits_take_few_statements_more(server: Serving, open_server: OpenServer) -> None:
    for who in (OWNER, OTHER):
        entered(server, who=who)
    few = server.state.settings
    more = {
        name_on_server(task, split): Split(bundle=bundle, visibility="open", task=task)
        for task in BUILT_IN
        for split in ("train", "val_seen", "val_unseen")
        if (bundle := bundle_folder(DEMO_BUNDLES, task) / f"{split}.npz").is_file()
    }
    settings = few.model_copy(update={"splits": {**more, **few.splits}})
    many = open_server(settings, server.tokens)
    assert len(many.state.boards) > 4 * len(server.state.boards)
    for name in ("r2r-val_seen", "r2r-val_unseen"):
        for seed, who in enumerate((OWNER, OTHER)):
            records = run_agent("random", many.state.boards[name].truth, seed)
            sent = many.upload(who, json.dumps(records).encode(), name).json()["submission"]
            shown = {"published": True, "shows_episodes": True}
            assert many.ask(who, "PATCH", f"/submissions/{sent['id']}", json=shown).is_success
    more_splits = len(many.state.boards) - len(server.state.boards)
    few_found, many_found = (statements_of_all_splits(each) for each in (server, many))
    for path, most in OF_ALL_SPLITS.items():
        for of_few, of_many, of_split in zip(few_found[path], many_found[path], most, strict=True):
            assert of_many["transactions"] == of_few["transactions"] == 1, path
            assert of_many["statements"] <= of_few["statements"] + more_splits * of_split, path


def statements_of_all_splits(server: Serving) -> Mapping[str, Sequence[Counter[str]]]:
    """Count for each page, while results are kept and after they were forgotten."""
    visitor, counted = signed_in(server, ORGANISER), {}
    for path in OF_ALL_SPLITS:
        assert visitor.get(path).status_code == 200
        with counting(server) as warm:
            visitor.get(path)
        forget(server)
        with counting(server) as cold:
            visitor.get(path)
        counted[path] = (warm, cold)
    return counted
