"""Lists come page by page; no page is too large, and all pages together are the list."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
from sqlalchemy import event, select

from reverie_eval.schemas.organising import NewNews, NewReported, NewSnapshot
from reverie_eval.schemas.service import Method
from reverie_eval.server.accounts.people import list_teams
from reverie_eval.server.boards.news import add_news
from reverie_eval.server.boards.reported import add_reported
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.errors import WRONG_FORM, MalformedError
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.paging import LONGEST, Listed, Page, all_pages, key_of, list_page
from reverie_eval.server.store.tables import Team
from tests.support.acting import (
    NOON,
    acting,
    add_person,
    add_team,
    ask_to_join,
    create_token,
    review,
)
from tests.support.description import Description
from tests.support.serving import OPEN, ORGANISER, OWNER, CopyServer, Serving

ROWS = 7


@pytest.fixture(scope="module")
def filled(original: Serving) -> Serving:
    """Return a server with seven rows or more in every list."""
    ids = []
    for _ in range(ROWS):
        ids.append(original.upload(OWNER, original.distinct()).json()["submission"]["id"])
        original.clock.turn(seconds=1)
    with original.acting(ORGANISER) as transaction:
        for number in range(ROWS):
            add_team(transaction, f"Team {number}")
            add_person(transaction, f"Team {number}", f"Person {number}")
            create_token(transaction, f"Person {number}")
            review(transaction, ids[number], "baseline")
            new = {"method": Method(name=f"Method {number}"), "scores": {"spl": 0.5}}
            about: dict[str, Any] = {"split": OPEN, "team": "They", "source": "https://example.org"}
            tasks = original.state.settings.tasks
            add_reported(transaction, NewReported.model_validate(new | about), tasks)
            add_news(transaction, NewNews(text=f"News {number}"))
            snapshot = NewSnapshot(split=OPEN, title=f"Snapshot {number}")
            original.state.get(Snapshots).take(transaction, snapshot)
    for number in range(ROWS):
        expires_at = NOON.replace(year=2027).isoformat()
        given: dict[str, Any] = {
            "team": "Red",
            "split": OPEN,
            "extra": 1,
            "reason": f"reason {number}",
        }
        original.ask(
            ORGANISER, "POST", "/organiser/grants", json=given | {"expires_at": expires_at}
        )
        ask_to_join(original.state.transactions, f"New team {number}")
    return original


@pytest.fixture
def full(filled: Serving, copy_server: CopyServer) -> Serving:
    """Return a copy of it."""
    return copy_server(filled)


LISTS = (
    "/news",
    "/submissions",
    f"/splits/{OPEN}/snapshots",
    "/organiser/teams",
    "/organiser/people",
    "/organiser/requests",
    "/organiser/tokens",
    "/organiser/grants",
    "/organiser/reviews",
    "/organiser/reported",
    "/organiser/attempts",
    "/organiser/audit",
)
WHOLE = {"/keys", "/splits", "/organiser/schedules"}
"""Lists that the settings or the organiser keep short."""


def test_every_list_comes_in_pages_or_is_known_to_be_short(server: Serving) -> None:
    replies = {
        path.replace("{split}", OPEN): operation["responses"].get("200", {}).get("content", {})
        for name, operation in Description(server).operations()
        for method, path in [name.split()]
        if method == "GET"
    }
    lists = {
        path
        for path, content in replies.items()
        if content.get("application/json", {}).get("schema", {}).get("type") == "array"
    }
    assert lists == {*LISTS, *WHOLE}


def test_a_page_has_a_hundred_rows_and_at_most_a_thousand(server: Serving) -> None:
    limits = [
        parameter["schema"]
        for _, operation in Description(server).operations()
        for parameter in operation.get("parameters", ())
        if parameter["name"] == "limit"
    ]
    bounds = {(each["minimum"], each["maximum"], each["default"]) for each in limits}
    assert len(limits) == len(LISTS)
    assert bounds == {(1, 1000, 100)}


@pytest.mark.parametrize("path", LISTS)
def test_all_pages_together_are_the_list(path: str, full: Serving) -> None:
    whole = full.ask(ORGANISER, "GET", path, params={"limit": LONGEST})
    assert "link" not in whole.headers
    pages = list(pages_of(full, path, 3))
    assert [len(page) for page in pages[:-1]] == [3] * (len(pages) - 1)
    assert 1 <= len(pages[-1]) <= 3
    assert [row for page in pages for row in page] == whole.json()
    assert len(whole.json()) >= ROWS


def pages_of(server: Serving, path: str, limit: int) -> Iterator[list[Any]]:
    """Follow the links."""
    query = f"?limit={limit}"
    while query:
        reply = server.ask(ORGANISER, "GET", f"{path}{query}")
        assert reply.status_code == 200
        yield reply.json()
        query = reply.links.get("next", {}).get("url", "")


def test_a_row_that_is_added_meanwhile_moves_no_other(full: Serving) -> None:
    pages = pages_of(full, "/submissions", 3)
    seen = next(pages)
    full.upload(OWNER, full.distinct())
    seen += [row for page in pages for row in page]
    assert len({row["id"] for row in seen}) == len(seen) == ROWS


def test_a_participant_s_cursor_tells_nothing_of_others(full: Serving) -> None:
    theirs = full.ask(ORGANISER, "GET", "/submissions").json()[0]["id"]
    reply = full.ask("Carl", "GET", "/submissions", params={"cursor": theirs})
    nobodys = full.ask("Carl", "GET", "/submissions", params={"cursor": "0" * 16})
    assert reply.status_code == nobodys.status_code == 400
    assert reply.json()["problems"] == nobodys.json()["problems"]


@pytest.mark.parametrize("limit", [0, -1, LONGEST + 1, "all"])
@pytest.mark.parametrize("path", LISTS)
def test_a_page_is_of_a_bounded_length(path: str, limit: object, server: Serving) -> None:
    reply = server.ask(ORGANISER, "GET", path, params={"limit": limit})
    assert (reply.status_code, reply.json()["problems"][0]["where"]) == (400, "limit")


@pytest.mark.parametrize(
    "cursor", ["", "x", "-1", "1.5", "9" * 20, "2147483648", f"{0:020}{9:012}", "\u0663", "\0"]
)
@pytest.mark.parametrize("path", ["/organiser/tokens", "/submissions"])
def test_a_cursor_that_is_none_is_refused(path: str, cursor: str, server_on: Serving) -> None:
    reply = server_on.ask(ORGANISER, "GET", path, params={"cursor": cursor})
    assert (reply.status_code, reply.json()["problems"][0]["where"]) == (400, "cursor")


@pytest.mark.parametrize("cursor", ["\0", "Blue\0"])
def test_a_name_with_a_zero_byte_is_no_cursor(cursor: str, server_on: Serving) -> None:
    for path in ("/organiser/teams", "/organiser/people"):
        reply = server_on.ask(ORGANISER, "GET", path, params={"cursor": cursor})
        assert (reply.status_code, reply.json()["problems"][0]["where"]) == (400, "cursor")


def test_a_page_begins_after_the_last_key_of_the_page_before(sqlite: Database) -> None:
    with acting(sqlite) as transaction:
        for name in "EDCBA":
            add_team(transaction, name)

        def page(limit: int, cursor: str | None = None) -> Listed[str]:
            rows, page = select(Team), Page(limit, cursor)
            return list_page(transaction.session, rows, Team.name, page, lambda row: row.name)

        assert page(1) == Listed(["A"], "A")
        assert page(2) == Listed(["A", "B"], "B")
        assert page(2, "B") == Listed(["C", "D"], "D")
        assert page(2, "D") == Listed(["E"], None)
        assert page(5) == Listed(["A", "B", "C", "D", "E"], None)
        parameters: list[Any] = []
        event.listen(
            sqlite.engine, "before_cursor_execute", lambda *said: parameters.append(said[3])
        )
        page(2, "B")
        assert parameters == [("B", 3, 0)]  # one row more than the page has, from the first on

        def newest(limit: int, cursor: str | None = None) -> Listed[int]:
            page, key = Page(limit, cursor), Team.id
            return list_page(
                transaction.session,
                select(Team),
                key,
                page,
                lambda row: row.id,
                newest_first=True,
            )

        assert newest(2) == Listed([5, 4], "4")
        assert newest(3, "4") == Listed([3, 2, 1], None)
        with pytest.raises(MalformedError) as refused:
            page(2, "\0")
    (problem,) = refused.value.problems
    assert (problem.code, problem.where, problem.message) == (
        "wrong-value",
        "cursor",
        "unknown cursor; take it from the Link header of the previous page of this list",
    )
    assert str(refused.value) == WRONG_FORM


def test_an_integer_key_is_one_that_a_database_has() -> None:
    assert [key_of(cursor) for cursor in ("0", "0000000001", "2147483647")] == [0, 1, 2147483647]
    for cursor in ("", "-1", "1.5", "x", "\u0663", "2147483648", "00000000001"):
        with pytest.raises(MalformedError):
            key_of(cursor)


def test_the_largest_key_is_a_cursor(server: Serving) -> None:
    reply = server.ask(ORGANISER, "GET", "/organiser/audit", params={"cursor": "2147483647"})
    assert (reply.status_code, reply.json()) == (200, [])


@pytest.mark.parametrize(
    ("path", "told"),
    [
        (
            "/submissions?limt=3",
            "unknown parameter; did you mean limit? Choose one of: cursor, limit",
        ),
        ("/organiser/attempts?before=3", "unknown parameter; choose one of: cursor, limit"),
        (f"/splits/{OPEN}/leaderboard?metrics=spl", "did you mean metric?"),
        ("/me?verbose=1", "unknown parameter; remove it"),
    ],
)
def test_a_parameter_that_a_route_does_not_have_is_refused(
    path: str, told: str, server: Serving
) -> None:
    reply = server.ask(ORGANISER, "GET", path)
    assert reply.status_code == 400
    assert told in reply.json()["problems"][0]["message"]


def test_every_address_of_the_api_refuses_unknown_parameters(server: Serving) -> None:
    of_monitors = {"GET /healthz", "GET /readyz", "GET /metrics"}
    operations = {name for name, _ in Description(server).operations()} - of_monitors
    assert len(operations) > 60
    replies = {}
    for name in {*operations, "GET /openapi.json"}:
        method, path = re.sub(r"{\w+}", "1", name).split()
        reply = server.ask(ORGANISER, method, path, params={"zzz": "1"})
        replies[name] = reply.status_code, [each["where"] for each in reply.json()["problems"]]
    assert replies == dict.fromkeys(replies, (400, ["zzz"]))


@pytest.mark.parametrize("path", ["/healthz", "/readyz", "/metrics", "/"])
def test_monitors_and_links_may_add_parameters(path: str, server: Serving) -> None:
    reply = server.client.get(path)
    assert server.client.get(f"{path}?zzz=1").status_code == reply.status_code


def test_the_lists_of_commands_are_whole(full: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reverie_eval.server.store.paging.LONGEST", 2)
    with full.state.database.reading() as session:
        listed = [team.name for team in all_pages(lambda page: list_teams(session, page))]
        assert listed == [team.name for team in list_teams(session, Page()).rows]
    assert len(listed) > 2
