"""Teams, persons and tokens; invitations; what the organiser gives, and what is written down."""

import hashlib
import re
import secrets
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from pydantic import ValidationError
from sqlalchemy import select

from reverie_eval.schemas.organising import MOST_EXTRA, NewTeam, NewTokenReport, TokenKind
from reverie_eval.server.accounts.tokens import revoke_token
from reverie_eval.server.audit.log import entries
from reverie_eval.server.errors import ConflictError, NotFoundError
from reverie_eval.server.store.tables import Token
from tests.support.acting import NOON, add_person, add_team, create_token
from tests.support.description import Description
from tests.support.serving import OPEN, ORGANISER, OTHER, OWNER, PRIVATE, Serving

TOMORROW = NOON + timedelta(days=1)


def created(
    server: Serving, kind: TokenKind = "access", expires_at: datetime | None = None
) -> NewTokenReport:
    """Create a token of the owner's."""
    with server.acting() as transaction:
        return create_token(transaction, OWNER, kind, expires_at)


def status_of(server: Serving, token: str) -> int:
    headers = {"Authorization": f"Bearer {token}"}
    return server.client.get("/api/v1/me", headers=headers).status_code


def accept(server: Serving, invitation: str) -> httpx.Response:
    return server.ask(None, "POST", "/tokens", json={"invitation": invitation})


def test_a_token_is_long_and_of_a_form_of_its_own(server: Serving) -> None:
    texts = {created(server).token for _ in range(64)}
    assert len(texts) == 64
    assert all(re.fullmatch(r"rv_[\w-]{43}", text) for text in texts)  # 32 bytes in base64
    for letters in zip(*(text[3:] for text in texts), strict=True):
        assert len(set(letters)) > 8  # of 64, but the last, which carries 4 bits, of 16


def test_the_log_tells_which_token_was_made(server: Serving) -> None:
    made = created(server)
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-1]
    assert (last["action"], last["details"]) == (
        "access token created",
        {"person_id": 1, "hint": made.token[:11], "expires_at": None},
    )


def test_only_a_token_s_digest_is_kept(server: Serving) -> None:
    made = created(server)
    with server.state.database.reading() as session:
        row = session.scalars(select(Token).where(Token.hint == made.token[:11])).one()
        log = str([(entry.details, entry.subject) for entry in entries(session)])
    assert row.digest == hashlib.sha256(made.token.encode()).hexdigest()
    kept = " ".join(str(value) for value in vars(row).values()) + log
    assert made.token[11:] not in kept


def test_digests_are_compared_in_constant_time(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared = []

    def compare(left: str, right: str) -> bool:
        compared.append({left, right})
        return False

    monkeypatch.setattr(secrets, "compare_digest", compare)
    assert status_of(server, server.tokens[OWNER]) == 401
    assert compared == [{hashlib.sha256(server.tokens[OWNER].encode()).hexdigest()}]


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        pytest.param(24 * 3600 - 1, 200, id="a second before"),
        pytest.param(24 * 3600, 401, id="at its end"),
        pytest.param(48 * 3600, 401, id="after"),
    ],
)
def test_a_token_expires(server: Serving, seconds: float, expected: int) -> None:
    access, invitation = (created(server, kind, TOMORROW) for kind in ("access", "invite"))
    server.clock.turn(seconds=seconds)
    assert status_of(server, access.token) == expected
    assert accept(server, invitation.token).status_code == (201 if expected == 200 else 401)


def test_a_revoked_token_is_worth_nothing_and_others_are(server: Serving) -> None:
    one, other = created(server), created(server)
    with server.acting() as transaction:
        revoke_token(transaction, one.hint)
    assert [status_of(server, one.token), status_of(server, other.token)] == [401, 200]


def test_an_invitation_is_turned_into_a_token_once(server: Serving) -> None:
    invitation = created(server, "invite").token
    first, second = accept(server, invitation), accept(server, invitation)
    assert (first.status_code, second.status_code) == (201, 401)
    said = first.json()
    assert (said["person"], said["team"]) == (OWNER, "Blue")
    assert status_of(server, said["token"]) == 200
    assert status_of(server, invitation) == 401


def test_an_invitation_that_was_revoked_is_none(server: Serving) -> None:
    invitation = created(server, "invite")
    with server.acting() as transaction:
        revoke_token(transaction, invitation.hint)
    assert accept(server, invitation.token).status_code == 401


def test_of_many_who_accept_an_invitation_at_once_one_gets_a_token(server_on: Serving) -> None:
    invitation = created(server_on, "invite").token
    with ThreadPoolExecutor(8) as pool:
        replies = list(pool.map(lambda _: accept(server_on, invitation), range(8)))
    assert sorted(reply.status_code for reply in replies) == [201] + 7 * [401]


NAMES = ["", "  ", "x" * 101, "two\nlines", "a\x00b", "a\u202eb", "a\u200bb", "a\u00a0b", "\ud800"]


@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_name(name: str) -> None:
    with pytest.raises(ValidationError):
        NewTeam(name=name)


def test_names_that_look_alike_are_alike(server: Serving) -> None:
    with server.acting() as transaction:
        add_team(transaction, "E\u0301quipe")
    with (
        server.acting() as transaction,
        pytest.raises(ConflictError, match="to another team"),
    ):
        add_team(transaction, " \u00c9quipe ")


def test_nobody_is_added_twice_or_to_no_team(server: Serving) -> None:
    for team, error in (("Blue", ConflictError), ("Nobody's", NotFoundError)):
        with pytest.raises(error), server.acting() as transaction:
            add_person(transaction, team, OWNER)


def organise(server: Serving, path: str, said: Any, status: int = 201) -> Any:
    """Let the organiser add something."""
    reply = server.ask(ORGANISER, "POST", f"/organiser/{path}", json=said)
    Description(server).check(reply)
    assert reply.status_code == status, reply.text
    return reply.json()


def test_an_organiser_brings_a_team_in_without_the_command_line(server: Serving) -> None:
    organise(server, "teams", {"name": "Green"})
    organise(server, "people", {"team": "Green", "name": "Dora"})
    made = organise(server, "tokens", {"person": "Dora", "expires_at": "2026-04-01T00:00:00Z"})
    token = accept(server, made["token"]).json()["token"]
    headers = {"Authorization": f"Bearer {token}"}
    upload = server.client.post(
        f"/api/v1/splits/{OPEN}/submissions?name=x", content=server.distinct(), headers=headers
    )
    assert upload.status_code == 201

    def listed(what: str) -> list[Any]:
        items: list[Any] = server.ask(ORGANISER, "GET", f"/organiser/{what}").json()
        return items

    assert [team["name"] for team in listed("teams")] == ["Blue", "Green", "Organisers", "Red"]
    assert next(team for team in listed("teams") if team["name"] == "Green")["people"] == ["Dora"]
    assert {person["name"]: person["role"] for person in listed("people")}["Dora"] == "participant"
    hints = {item["hint"]: item["kind"] for item in listed("tokens") if item["person"] == "Dora"}
    assert hints == {made["token"][:11]: "invite", token[:11]: "access"}
    assert made["token"][11:] not in str(listed("tokens"))

    server.ask(ORGANISER, "DELETE", f"/organiser/tokens/{token[:11]}")
    assert status_of(server, token) == 401
    assert [(entry["actor"], entry["action"]) for entry in listed("audit")[-7:]] == [
        (ORGANISER, "team added"),
        (ORGANISER, "person added"),
        (ORGANISER, "invite token created"),
        ("Dora", "invitation used"),
        ("Dora", "access token created"),
        ("Dora", "submitted"),
        (ORGANISER, "token revoked"),
    ]


@pytest.mark.parametrize(
    ("path", "said", "status"),
    [
        ("teams", {"name": "Blue"}, 409),
        ("teams", {"name": "a\u202eb"}, 400),
        ("people", {"team": "Blue", "name": OWNER}, 409),
        ("people", {"team": "Nobody's", "name": "Dora"}, 404),
        ("people", {"team": "Blue", "name": "Dora", "role": "king"}, 400),
        ("tokens", {"person": "Nobody"}, 404),
        ("tokens", {"person": OWNER, "kind": "session"}, 400),
    ],
)
def test_what_an_organiser_cannot_add(server: Serving, path: str, said: Any, status: int) -> None:
    before = server.ask(ORGANISER, "GET", "/organiser/audit").text
    organise(server, path, said, status)
    assert server.ask(ORGANISER, "GET", "/organiser/audit").text == before


GRANT = {
    "team": "Blue",
    "split": PRIVATE,
    "extra": 3,
    "reason": "our disk was full",
    "expires_at": "2026-03-03T12:00:00Z",
}


def left(server: Serving, who: str) -> int:
    remaining: int = server.ask(who, "GET", f"/splits/{PRIVATE}").json()["quota"]["remaining"]
    return remaining


def test_a_grant_raises_a_team_s_quota_until_a_date_and_says_why(server: Serving) -> None:
    given = organise(server, "grants", GRANT)
    assert given == {**GRANT, "created_at": "2026-03-02T12:00:00Z"}
    assert server.ask(ORGANISER, "GET", "/organiser/grants").json() == [given]
    assert [left(server, who) for who in (OWNER, "Ben", OTHER)] == [5, 5, 2]
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-1]
    assert (last["actor"], last["action"], last["subject"]) == (ORGANISER, "granted", "Blue")
    assert last["details"]["reason"] == "our disk was full"
    server.clock.turn(hours=24)
    assert left(server, OWNER) == 2


@pytest.mark.parametrize("extra", [1, MOST_EXTRA])
def test_the_least_and_the_most_that_a_grant_gives(server: Serving, extra: int) -> None:
    organise(server, "grants", {**GRANT, "extra": extra})
    assert left(server, OWNER) == 2 + extra


@pytest.mark.parametrize(
    ("change", "status"),
    [
        pytest.param({"extra": 0}, 400, id="nothing"),
        pytest.param({"extra": -1}, 400, id="less than nothing"),
        pytest.param({"extra": MOST_EXTRA + 1}, 400, id="one too many"),
        pytest.param({"extra": 10**30}, 400, id="more than a database can count"),
        pytest.param({"reason": ""}, 400, id="no reason"),
        pytest.param({"reason": "  "}, 400, id="a blank reason"),
        pytest.param({"reason": "two\nlines"}, 400, id="a reason of two lines"),
        pytest.param({"expires_at": "2026-03-02T12:00:00Z"}, 400, id="for no time"),
        pytest.param({"expires_at": None}, 400, id="for ever"),
        pytest.param({"team": "Nobody's"}, 404, id="to no team"),
        pytest.param({"split": "nothing"}, 404, id="for no split"),
    ],
)
def test_a_grant_that_is_none(server: Serving, change: Any, status: int) -> None:
    organise(server, "grants", {**GRANT, **change}, status)
    assert server.ask(ORGANISER, "GET", "/organiser/grants").json() == []


@pytest.mark.parametrize("kind", ["access", "invite"])
@pytest.mark.parametrize(
    ("seconds", "status"),
    [
        pytest.param(-1, 400, id="before now"),
        pytest.param(0, 400, id="now"),
        pytest.param(1, 201, id="after now"),
    ],
)
def test_no_token_is_made_that_is_worth_nothing(
    server: Serving, kind: str, seconds: int, status: int
) -> None:
    ends = (server.clock() + timedelta(seconds=seconds)).isoformat()
    asked = {"person": OWNER, "kind": kind, "expires_at": ends}
    said = organise(server, "tokens", asked, status)
    assert status == 201 or said["detail"].startswith("the expiry time is in the past")


def test_the_audit_log_says_who_changed_what(server: Serving) -> None:
    submission = server.upload(OWNER).json()["submission"]["id"]
    said = {"published": True, "method": {"name": "Runner"}}
    server.ask(OWNER, "PATCH", f"/submissions/{submission}", json=said)
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-1]
    assert (last["actor"], last["action"], last["subject"]) == (OWNER, "changed", submission)
    before = {"published": False, "method": {"name": "Walker"}}
    assert last["details"] == {"before": before, "after": said}


def test_a_team_is_renamed_over_http_whatever_its_name(server: Serving) -> None:
    submission = server.upload(OTHER).json()["submission"]
    server.ask(OTHER, "PATCH", f"/submissions/{submission['id']}", json={"published": True})
    for old, new in (("Red", "Red/Green"), ("Red/Green", "Purple")):
        path = f"/organiser/teams/{quote(old, safe='')}"
        reply = server.ask(ORGANISER, "PATCH", path, json={"name": new})
        assert (reply.status_code, reply.json()["name"]) == (200, new)
    (row,) = server.ask(None, "GET", f"/splits/{OPEN}/leaderboard").json()["rows"]
    assert row["team"] == "Purple"
    receipt = server.ask(OTHER, "GET", f"/submissions/{submission['id']}/receipt").json()
    assert receipt == submission["receipt"]
    last = server.ask(ORGANISER, "GET", "/organiser/audit").json()[-1]
    assert (last["action"], last["subject"]) == ("team renamed", "Red/Green")
    assert last["details"] == {"before": "Red/Green", "after": "Purple"}


@pytest.mark.parametrize(
    ("old", "new", "status"), [("Nobody's", "Purple", 404), ("Red", "Blue", 409), ("Red", " ", 400)]
)
def test_a_team_is_not_renamed_to_nothing_or_to_another(
    old: str, new: str, status: int, server: Serving
) -> None:
    reply = server.ask(ORGANISER, "PATCH", f"/organiser/teams/{old}", json={"name": new})
    assert reply.status_code == status
    teams = server.ask(ORGANISER, "GET", "/organiser/teams").json()
    assert [team["name"] for team in teams] == ["Blue", "Organisers", "Red"]
