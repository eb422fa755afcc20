"""Requests to join: what anyone may send, and what the organiser makes of it."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import timedelta
from html import unescape
from ipaddress import ip_network
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import httpx
import pytest
import time_machine
from limits.storage import MemoryStorage
from sqlalchemy import select

from reverie_eval.schemas.people import Rejection
from reverie_eval.server.accounts import joining
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.http.runtime import JoinLimit
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.settings import Channel
from reverie_eval.server.store.tables import JoinRequest, Message
from tests.support.acting import NOON, ask_to_join
from tests.support.flat_world import Run
from tests.support.serving import OPEN, ORGANISER, OWNER, OpenServer, Serving, settings_of
from tests.support.visiting import said, signed_in

DORA = {"name": "Dora", "email": "dora@example.org"}
NEW = {"team": "Green", "people": [DORA], "institution": "University of Adelaide"}


PROXIES = [ip_network("127.0.0.1/32")]
FORM = {"team": "Last", "people": "Dora, dora@example.org", "institution": "The last one"}


def ask(
    server: Serving, headers: Mapping[str, str] | None = None, **changes: Any
) -> httpx.Response:
    return server.ask(None, "POST", "/join", json={**NEW, **changes}, headers=headers or {})


def open_requests(server: Serving) -> Sequence[Any]:
    found: Sequence[Any] = server.ask(ORGANISER, "GET", "/organiser/requests").json()
    return found


def test_who_asks_is_invited_and_submits(server: Serving) -> None:
    assert ask(server, purpose="Maps").status_code == 202
    (request,) = open_requests(server)
    assert request == {
        **NEW,
        "id": 1,
        "purpose": "Maps",
        "team_exists": False,
        "created_at": "2026-03-02T12:00:00Z",
    }
    path = f"/organiser/requests/{request['id']}/accept"
    accepted = server.ask(ORGANISER, "POST", path).json()
    (invitation,) = accepted["invitations"]
    assert (invitation["email"], invitation["expires_at"]) == (
        "dora@example.org",
        "2026-03-16T12:00:00Z",
    )
    welcome = server.ask(None, "POST", "/tokens", json={"invitation": invitation["token"]}).json()
    headers = {"Authorization": f"Bearer {welcome['token']}"}
    upload = server.client.post(
        f"/api/v1/splits/{OPEN}/submissions?name=x", content=server.distinct(), headers=headers
    )
    assert upload.status_code == 201
    assert server.ask(ORGANISER, "POST", path).status_code == 404  # once
    assert [each for each in examine(server.state.settings.folder) if each.kind == "fault"] == []


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, id="new to this server"),
        pytest.param({"team": "Blue"}, id="a team that exists"),
        pytest.param({"team": "Blue", "people": [{**DORA, "name": "Ada"}]}, id="a person who does"),
    ],
)
def test_the_reply_does_not_tell_who_is_known(changes: Any, server: Serving) -> None:
    reply = ask(server, **changes)
    assert (reply.status_code, reply.json()) == (202, joining.RECEIVED.model_dump())
    again = ask(server, **changes)
    assert (again.status_code, again.json()) == (202, reply.json())
    assert len(open_requests(server)) == 1


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"team": ""}, id="no team"),
        pytest.param({"team": "x" * 101}, id="a long team"),
        pytest.param({"people": []}, id="nobody"),
        pytest.param({"people": [DORA, DORA]}, id="the same person twice"),
        pytest.param({"people": [{"name": "Dora", "email": "dora"}]}, id="no address"),
        pytest.param(
            {"people": [{**DORA, "name": f"Dora {number}"} for number in range(11)]}, id="a crowd"
        ),
        pytest.param({"purpose": "x" * 501}, id="a long purpose"),
        pytest.param({"purpose": "two\nlines"}, id="lines"),
    ],
)
def test_what_is_no_request(changes: Any, server: Serving) -> None:
    assert ask(server, **changes).status_code == 400
    assert open_requests(server) == []


def test_only_so_many_requests_wait(server: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joining, "MOST_OPEN", 2)
    assert [ask(server, team=name).status_code for name in ("A", "B")] == [202, 202]
    refused = ask(server, team="C")
    told = "too many requests to join are waiting; try again next week"
    assert (refused.status_code, refused.json()["detail"]) == (409, told)
    assert ask(server, team="A").status_code == 202  # as it waits already
    server.ask(ORGANISER, "POST", "/organiser/requests/1/reject", json={})
    assert ask(server, team="C").status_code == 202
    page = server.ask(ORGANISER, "GET", "/organiser/requests", params={"limit": 1})
    assert [each["team"] for each in page.json()] == ["B"]
    assert page.links["next"]["url"].endswith("cursor=2")


def test_an_address_sends_only_so_many_in_a_day(open_server: OpenServer, folder: Path) -> None:
    server = open_server(settings_of(folder).model_copy(update={"trusted_proxies": PROXIES}))

    def status(team: str, address: str) -> int:
        return ask(server, headers={"X-Forwarded-For": address}, team=team).status_code

    teams = [f"Team {number}" for number in range(6)]
    with time_machine.travel(NOON, tick=False) as time:
        assert ask(server, team="x" * 101).status_code == 400  # does not count
        assert [status(team, "192.0.2.7") for team in teams] == [*5 * [202], 429]
        assert status(teams[0], "192.0.2.7") == 202  # as it waits already
        assert status(teams[5], "192.0.2.8") == 202
        page = server.client.post("/join", data=FORM, headers={"X-Forwarded-For": "192.0.2.7"})
        assert page.status_code == 429
        assert page.headers["retry-after"] == "86400"
        assert "5 requests to join came from your address in the last 24 hours" in said(page)
        assert FORM["institution"] in page.text  # what was typed stays
        time.shift(timedelta(days=1, seconds=1))
        assert status("Team 6", "192.0.2.7") == 202


def test_addresses_are_counted_by_their_digests() -> None:
    counts = MemoryStorage()
    JoinLimit(counts, b"key").count({"client": ("192.0.2.7", 1)})
    assert "LIMITER/join/" in str(counts.storage)
    assert "192.0.2.7" not in str(counts.storage)


def test_an_answer_removes_what_the_request_said_of_people(server: Serving) -> None:
    for team in ("A", "B"):
        ask(server, team=team, purpose="Maps")
    server.ask(ORGANISER, "POST", "/organiser/requests/1/accept")
    reason = {"reason": "not a group"}
    server.ask(ORGANISER, "POST", "/organiser/requests/2/reject", json=reason)
    with server.state.database.reading() as session:
        rows = session.scalars(select(JoinRequest).order_by(JoinRequest.id)).all()
    assert [(row.people, row.institution, row.purpose) for row in rows] == 2 * [([], "", "")]
    log = server.ask(ORGANISER, "GET", "/organiser/audit").json()
    assert [each["action"] for each in log[-5:]] == [
        "team added",
        "person added",
        "invite token created",
        "request accepted",
        "request rejected",
    ]
    assert [(each["subject"], each["details"]) for each in log[-2:]] == [
        ("A", {"people": 1}),
        ("B", reason),
    ]


def test_an_accepted_request_is_answered_once_with_an_invitation_for_each(server: Serving) -> None:
    emil = {"name": OWNER, "email": "another.ada@example.org"}  # as somebody of another team
    ask(server, people=[DORA, emil])
    ask(server, team="Spam")
    server.clock.turn(hours=1)
    with server.acting(ORGANISER) as transaction:
        (accepted,) = joining.accept_requests(transaction, [1, 1])
        joining.reject_requests(transaction, [2, 2], Rejection(reason="spam"))
        rows = transaction.session.scalars(select(JoinRequest).order_by(JoinRequest.id)).all()
        answers = [(row.decision, row.decided_at) for row in rows]
        assert joining.count_open(transaction.session) == 0
        with pytest.raises(NotFoundError) as unknown:
            joining.accept_request(transaction, 1)
    told = "there is no open request number 1; see the list of requests"
    assert str(unknown.value) == told
    now = server.clock()
    assert answers == [("request accepted", now), ("request rejected", now)]
    assert accepted.team == "Green"
    assert [
        (each.team, each.person, each.email, each.kind, each.expires_at)
        for each in accepted.invitations
    ] == [
        ("Green", name, email, "invite", now + timedelta(days=14))
        for name, email in (("Dora", DORA["email"]), (OWNER, emil["email"]))
    ]
    log = server.ask(ORGANISER, "GET", "/organiser/audit").json()
    assert [
        (each["action"], each["row"], each["subject"], each["details"]) for each in log[-2:]
    ] == [
        ("request accepted", "join_request:1", "Green", {"people": 2}),
        ("request rejected", "join_request:2", "Spam", {"reason": "spam"}),
    ]


def test_the_organiser_is_told_of_a_new_request_once(server: Serving) -> None:
    channels = {"webhook": Channel()}
    transactions = replace(server.state.transactions, channels=channels)
    for names in (["Dora"], ["Dora"], ["Dora", "Emil"]):
        ask_to_join(transactions, "Green", *names)
    with server.state.database.reading() as session:
        told = [(each.event, each.text, each.path) for each in session.scalars(select(Message))]
        assert joining.count_open(session) == 2
    assert told == [
        ("join-request", f"{people} of Somewhere asked to join as Green", "/desk/requests")
        for people in ("1 person", "2 people")
    ]


def test_nothing_is_added_if_a_name_is_taken(server: Serving) -> None:
    ask(server, team="Blue", people=[DORA, {"name": OWNER, "email": "ada@example.org"}])
    reply = server.ask(ORGANISER, "POST", "/organiser/requests/1/accept")
    assert (reply.status_code, "already has a person 'Ada'" in reply.text) == (409, True)
    assert "Dora" not in server.ask(ORGANISER, "GET", "/organiser/people").text
    assert len(open_requests(server)) == 1


def test_a_server_may_accept_no_requests(open_server: OpenServer, folder: Path) -> None:
    settings = settings_of(folder).model_copy(update={"accept_requests_to_join": False})
    server = open_server(settings)
    refused = ask(server)
    told = "this server does not accept requests to join; write to the organiser"
    assert (refused.status_code, refused.json()["detail"]) == (403, told)
    assert "does not accept requests" in said(server.client.get("/join"))
    assert "/join" not in server.client.get("/sign-in").text


def test_the_form_and_the_desk(server: Serving) -> None:
    assert 'href="/join"' in server.client.get("/sign-in").text
    form = {"team": "<b>", "people": "Dora dora@example.org\nno address", "institution": "Here"}
    refused = server.client.post("/join", data=form)
    words = said(refused)
    assert (refused.status_code, "People, line 2, e-mail:" in words) == (400, True)
    assert "line 1" not in words
    assert "line 2, name" not in words
    form["people"] = "Dora, dora@example.org\n\nEmil, of Adelaide, emil@example.org"
    assert "Your request was received." in said(server.client.post("/join", data=form))
    desk = signed_in(server, ORGANISER)
    assert "1 request to join." in said(desk.get("/desk"))
    page = desk.get("/desk/requests")
    words = said(page)
    alone = '<form id="one" method="post"><input type="hidden" name="csrf_token"'
    assert alone in page.text  # one click accepts a request
    assert '<button form="one" name="request" value="1"' in page.text
    assert "<b> new team Dora, dora@example.org Emil, of Adelaide, emil@example.org" in words
    shown = desk.send("/desk/requests", {"request": "1", "what": "accept"})
    assert (shown.status_code, shown.text.count('id="secret-')) == (200, 2)
    assert "No open requests." in said(desk.get("/desk/requests"))
    assert "to join" not in said(desk.get("/desk"))


def test_several_requests_are_answered_at_once_at_the_desk(server: Serving) -> None:
    for team in ("A", "B", "Blue", "Spam", "More spam"):
        ask_to_join(server.state.transactions, team, OWNER if team == "Blue" else "Dora")
    desk, place = signed_in(server, ORGANISER), "/desk/requests"
    assert "checked" not in desk.get(place).text
    assert desk.get(f"{place}?tick=all").text.count(" checked") == 5
    taken = desk.send(place, {"request": ["1", "2", "3"], "what": "accept"})
    assert (taken.status_code, "already has a person 'Ada'" in unescape(taken.text)) == (409, True)
    assert taken.text.count(" checked") == 3  # what was ticked stays, and nobody was added
    assert [each["id"] for each in open_requests(server)] == [1, 2, 3, 4, 5]
    shown = desk.send(place, {"request": ["1", "2"], "what": "accept"})
    written = re.search(r'<code id="csv">(.*?)</code>', shown.text, re.DOTALL)
    linked = re.search(r'href="data:text/csv;charset=utf-8,([^"]*)" download', shown.text)
    assert written is not None
    assert linked is not None
    assert unquote(linked[1]) == unescape(written[1])
    rows = list(csv.DictReader(io.StringIO(unescape(written[1]))))
    assert [(row["team"], row["email"]) for row in rows] == [
        ("A", "Dora@example.org"),
        ("B", "Dora@example.org"),
    ]
    assert re.findall(r'<code id="secret-\d">(.*?)<', shown.text) == [r["invitation"] for r in rows]
    spam = {"request": ["4", "5"], "what": "reject", "reason": "spam"}
    assert desk.send(place, spam).status_code == 303
    assert [each["id"] for each in open_requests(server)] == [3]


@pytest.mark.parametrize(
    ("form", "status", "told"),
    [
        pytest.param({}, 400, "Tick the requests that you want to answer first.", id="none"),
        pytest.param({"request": "7"}, 404, "There is no open request number 7;", id="unknown"),
        pytest.param({"request": "x"}, 404, "There is no open request number 0;", id="no number"),
        pytest.param(
            {"request": "1", "reason": "x" * 501}, 400, "at most 500 characters", id="a long reason"
        ),
    ],
)
def test_a_wrong_answer_at_the_desk(
    form: Mapping[str, str], status: int, told: str, server: Serving
) -> None:
    ask(server)
    reply = signed_in(server, ORGANISER).send("/desk/requests", {"what": "reject", **form})
    assert (reply.status_code, told in said(reply)) == (status, True)
    assert len(open_requests(server)) == 1


def test_requests_are_answered_on_the_command_line(server: Serving, run: Run) -> None:
    folder = str(server.state.settings.folder)
    for team in ("Green", "Spam", "More spam"):
        ask_to_join(server.state.transactions, team, "=Dora")
    assert "=Dora <=Dora@example.org>" in run("server", "request", "list", folder).out
    accepted = run("server", "request", "accept", folder, "1")
    assert (accepted.status, accepted.err) == (0, "1 person added to Green\n")
    (row,) = csv.DictReader(io.StringIO(accepted.out))
    assert (row["team"], row["person"]) == ("Green", "'=Dora")  # not a formula
    rejected = run("server", "request", "reject", folder, "2", "3", "--reason", "spam")
    assert rejected.out == "2 requests rejected\n"
    assert run("server", "request", "accept", folder, "2").status == 2
