"""Tokens and browser sessions as the database has them: whose, until when, and what is said."""

import base64
import hashlib
import hmac
import re
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import select

from reverie_eval.schemas.organising import NewToken
from reverie_eval.server.accounts import tokens
from reverie_eval.server.accounts.people import person_named
from reverie_eval.server.accounts.tokens import (
    accept_invitation,
    list_tokens,
    revoke_token,
    revoke_tokens_of_person,
    revoke_tokens_of_team,
)
from reverie_eval.server.audit.log import audit_reports, entries
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import (
    ConflictError,
    ForgedError,
    MalformedError,
    NotFoundError,
    NotSignedInError,
)
from reverie_eval.server.identity import (
    Sessions,
    check_organiser_left,
    has_organiser,
    name_in,
    token_state,
    valid_token,
)
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import BrowserSession, Token
from tests.support.acting import NOON, acting, add_person, add_team, create_token

SECOND = timedelta(seconds=1)
HOUR = timedelta(hours=1)


@pytest.fixture
def change(sqlite: Database) -> Iterator[Transaction]:
    """Change a database with Ada and Ben of Blue, Ada of Red, and Olga, the organiser."""
    with acting(sqlite, "test") as transaction:
        for team in ("Blue", "Red"):
            add_team(transaction, team)
            add_person(transaction, team, "Ada")
        add_person(transaction, "Blue", "Ben")
        add_person(transaction, "Blue", "Olga", "organiser")
        yield transaction


def last_entry(change: Transaction) -> tuple[Any, ...]:
    *_, last = audit_reports(change.session, entries(change.session))
    return last.actor, last.action, last.subject, last.details


def test_a_token_is_reported_and_logged(change: Transaction) -> None:
    made = create_token(change, "Ben", "invite", NOON + HOUR)
    (listed,) = list_tokens(change.session, Page()).rows
    assert listed.model_dump() == made.model_dump(exclude={"token"})
    assert listed.model_dump() == {
        "hint": made.token[:11],
        "kind": "invite",
        "person": "Ben",
        "team": "Blue",
        "created_at": NOON,
        "expires_at": NOON + HOUR,
        "revoked_at": None,
    }
    about = {"person_id": 3, "hint": made.hint, "expires_at": (NOON + HOUR).isoformat()}
    assert last_entry(change) == ("test", "invite token created", "Ben", about)


def test_tokens_are_listed_the_latest_first(change: Transaction) -> None:
    made = [create_token(change, "Ben").hint for _ in range(3)]
    listed = [each.hint for each in list_tokens(change.session, Page()).rows]
    assert listed == made[::-1]
    assert [each.hint for each in list_tokens(change.session, Page(limit=1)).rows] == made[-1:]


def test_who_accepts_an_invitation_has_done_so_themselves(change: Transaction) -> None:
    invited = create_token(change, "Ben", "invite", NOON + SECOND)
    welcome = accept_invitation(change, invited.token)
    assert (welcome.person, welcome.team) == ("Ben", "Blue")
    used, made = list_tokens(change.session, Page()).rows[::-1]
    assert (used.hint, used.revoked_at) == (invited.hint, NOON)
    assert (made.kind, made.expires_at, made.revoked_at) == ("access", None, None)
    assert made.hint == welcome.token[:11]
    assert last_entry(change)[:3] == ("Ben", "access token created", "Ben")


@pytest.mark.parametrize("expires_at", [NOON, NOON - SECOND])
def test_a_token_that_would_be_over_is_not_made(change: Transaction, expires_at: datetime) -> None:
    with pytest.raises(MalformedError) as refused:
        create_token(change, "Ben", expires_at=expires_at)
    assert str(refused.value) == "the expiry time is in the past; choose a later time"


@pytest.mark.parametrize(
    ("kind", "ends", "told"),
    [
        pytest.param("access", "revoked", "this token was revoked", id="a revoked token"),
        pytest.param("access", "expired", "this token has expired", id="an expired token"),
        pytest.param(
            "invite", "revoked", "this invitation was used or revoked", id="a used invitation"
        ),
        pytest.param("invite", "expired", "this invitation has expired", id="an expired one"),
        pytest.param("access", "unknown", "unknown token", id="an unknown token"),
    ],
)
def test_what_is_said_of_a_token_that_does_not_count(
    change: Transaction, kind: Any, ends: str, told: str
) -> None:
    token = create_token(change, "Ben", kind, NOON + HOUR)
    text, now = token.token, NOON + HOUR - SECOND
    if ends == "unknown":
        text = "rv_unknown"
    elif ends == "expired":
        now = NOON + HOUR
    elif ends == "revoked":
        revoke_token(change, token.hint)
    with pytest.raises(NotSignedInError) as refused:
        valid_token(change.session, text, kind, now)
    assert str(refused.value) == f"{told}; ask the organiser for another"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("invite", "this is an invitation, not a token; exchange it for a token first"),
        ("access", "this is a token, not an invitation; sign in with it"),
    ],
)
def test_who_takes_an_invitation_for_a_token_or_the_reverse_is_told_so(
    change: Transaction, given: Any, told: str
) -> None:
    text = create_token(change, "Ben", given).token
    with pytest.raises(NotSignedInError, match=f"^{told}$"):
        valid_token(change.session, text, "access" if given == "invite" else "invite", NOON)


@pytest.mark.parametrize(("kind", "days"), [("invite", 14), ("access", None)])
def test_an_invitation_ends_by_itself_and_a_token_does_not(
    change: Transaction, kind: Any, days: int | None
) -> None:
    expected = None if days is None else NOON + timedelta(days=days)
    assert create_token(change, "Ben", kind).expires_at == expected


@pytest.mark.parametrize(
    ("kind", "revoked_at", "expires_at", "expected"),
    [
        pytest.param("access", None, None, "valid", id="without an end"),
        pytest.param("access", None, NOON + SECOND, "valid", id="before its end"),
        pytest.param("access", None, NOON, "expired", id="at its end"),
        pytest.param("access", NOON, None, "revoked", id="revoked"),
        pytest.param("access", NOON - HOUR, NOON, "revoked", id="revoked before its end"),
        pytest.param("invite", NOON, None, "used or revoked", id="an invitation"),
    ],
)
def test_the_state_of_a_token(
    kind: Any, revoked_at: datetime | None, expires_at: datetime | None, expected: str
) -> None:
    token = Token(kind=kind, revoked_at=revoked_at, expires_at=expires_at)
    assert token_state(token, NOON) == expected


def test_a_token_is_revoked_by_its_first_characters(change: Transaction) -> None:
    one, other = create_token(change, "Ben"), create_token(change, "Ben")
    assert revoke_token(change, one.hint).revoked_at == NOON
    assert last_entry(change) == ("test", "token revoked", "Ben", {"hint": one.hint})
    assert valid_token(change.session, other.token, "access", NOON).hint == other.hint
    with pytest.raises(NotFoundError) as missing:
        revoke_token(change, "rv-")
    told = "no token begins with 'rv-'; `server token list` lists all tokens"
    assert str(missing.value) == told


def test_too_few_characters_of_a_token_are_ambiguous(change: Transaction) -> None:
    """Even if one token alone begins with them: what is revoked was named in full."""
    tokens = [create_token(change, "Ben") for _ in range(3)]
    with pytest.raises(ConflictError) as several:
        revoke_token(change, "rv_")
    assert str(several.value).startswith("'rv_' is ambiguous: rv_")
    assert str(several.value).endswith(" of Ben. Give the first 11 characters of one token")
    with pytest.raises(ConflictError) as one:
        revoke_token(change, tokens[0].hint[:-1])
    assert f"is ambiguous: {tokens[0].hint} of Ben. Give" in str(one.value)
    with pytest.raises(NotFoundError):  # as LIKE would find it in SQLite
        revoke_token(change, "RV_")


def test_a_token_stays_revoked_since_the_first_time(change: Transaction) -> None:
    made = create_token(change, "Ben")
    revoke_token(change, made.hint)
    later = Transaction(change.session, "test", NOON + HOUR, change.audit_log)
    assert revoke_token(later, made.hint).revoked_at == NOON


Revoke = Callable[[Transaction], Any]


@pytest.mark.parametrize(
    ("revoke", "expected"),
    [
        pytest.param(lambda change: revoke_tokens_of_team(change, "Blue"), "0123", id="a team's"),
        pytest.param(
            lambda change: revoke_tokens_of_person(change, "Ben"), "2", id="a person's of one team"
        ),
        pytest.param(
            lambda change: revoke_tokens_of_person(change, "Ada", "Blue"), "01", id="a person's"
        ),
    ],
)
def test_all_that_are_revoked_at_once(change: Transaction, revoke: Revoke, expected: str) -> None:
    whose = (("Ada", "Blue"), ("Ada", "Blue"), ("Ben", "Blue"), ("Olga", "Blue"), ("Ada", "Red"))
    made = [
        tokens.create_token(change, NewToken(person=person, team=team)).hint
        for person, team in whose
    ]
    already = create_token(change, "Ben").hint
    revoke_token(Transaction(change.session, "test", NOON - HOUR, change.audit_log), already)
    revoked = [made[int(place)] for place in expected]
    assert [(each.hint, each.revoked_at) for each in revoke(change)] == [
        (hint, NOON) for hint in revoked
    ]
    rows = list_tokens(change.session, Page()).rows
    assert {each.hint: each.revoked_at for each in rows} == {
        **dict.fromkeys(made),
        **dict.fromkeys(revoked, NOON),
        already: NOON - HOUR,
    }


@pytest.mark.parametrize(
    ("person", "kind", "expires_at", "now", "expected"),
    [
        pytest.param("Olga", "access", None, NOON, True, id="a token without an end"),
        pytest.param("Olga", "access", NOON + HOUR, NOON + HOUR - SECOND, True, id="before"),
        pytest.param("Olga", "access", NOON + HOUR, NOON + HOUR, False, id="at its end"),
        pytest.param("Olga", "invite", None, NOON, False, id="an invitation"),
        pytest.param("Ben", "access", None, NOON, False, id="a participant's"),
    ],
)
def test_whether_an_organiser_can_sign_in(
    change: Transaction,
    person: str,
    kind: Any,
    expires_at: datetime | None,
    now: datetime,
    *,
    expected: bool,
) -> None:
    made = create_token(change, person, kind, expires_at)
    assert has_organiser(change.session, now) is expected
    if expected:
        check_organiser_left(change)
    revoke_token(change, made.hint)
    assert has_organiser(change.session, now) is False
    with pytest.raises(ConflictError) as refused:
        check_organiser_left(change)
    assert str(refused.value) == (
        "this would leave no organiser with a valid token; first create a token for an organiser "
        "who stays, or do this with `reverie-eval server` on the server's machine"
    )


# Browser sessions.

SECRET = b"secret"


def signed(name: str, purpose: bytes) -> str:
    """Return a signature as itsdangerous documents it: HMAC-SHA-256 with a key of the purpose."""
    key = hmac.new(SECRET, purpose, hashlib.sha256).digest()
    mac = hmac.new(key, name.encode(), hashlib.sha256).digest()
    return base64.urlsafe_b64encode(mac).decode().rstrip("=")


def test_cookies_and_csrf_tokens_have_keys_of_their_own() -> None:
    sessions = Sessions(SECRET)
    cookie = f"name.{signed('name', b'cookie')}"
    assert sessions.id_in(cookie) == "name"
    assert sessions.id_in(f"other.{signed('name', b'cookie')}") is None
    assert sessions.csrf_token("name") == signed("name", b"csrf")
    sessions.check_csrf_token("name", signed("name", b"csrf"))
    with pytest.raises(ForgedError) as refused:
        sessions.check_csrf_token("name", signed("name", b"cookie"))
    assert str(refused.value) == "the form is not of this browser session; open its page again"


def test_the_name_in_a_cookie_is_what_is_before_its_signature() -> None:
    assert [name_in(cookie) for cookie in ("a.b.c", "a.b", "a", "")] == ["a.b", "a", "", ""]


@pytest.mark.parametrize(
    ("expires_at", "ends"),
    [
        pytest.param(None, NOON + 12 * HOUR, id="half a day"),
        pytest.param(NOON + 13 * HOUR, NOON + 12 * HOUR, id="before its token"),
        pytest.param(NOON + HOUR, NOON + HOUR, id="with its token"),
    ],
)
def test_when_a_session_ends(
    change: Transaction, expires_at: datetime | None, ends: datetime
) -> None:
    sessions, session = Sessions(SECRET), change.session
    made = sessions.begin(session, create_token(change, "Ben", "access", expires_at).token, NOON)
    name = made.session.id
    assert re.fullmatch(r"[\w-]{43}", name)  # 32 bytes in base64
    assert (made.session.created_at, made.session.expires_at) == (NOON, ends)
    assert made.session.token.person is person_named(session, "Ben")
    assert sessions.id_in(made.cookie) == name
    session.flush()
    assert sessions.find(session, name, ends - SECOND) is made.session
    assert sessions.find(session, name, ends) is None
    assert sessions.find(session, "another", NOON) is None


def test_sessions_are_forgotten_when_another_begins_after_their_end(change: Transaction) -> None:
    sessions, session = Sessions(SECRET), change.session
    token = create_token(change, "Ben").token

    def begin(hours: float) -> str:
        return sessions.begin(session, token, NOON + hours * HOUR).session.id

    def known() -> set[str]:
        return set(session.scalars(select(BrowserSession.id)))

    first, second = begin(0), begin(1)
    assert known() == {first, second}
    third = begin(12)
    assert known() == {second, third}
    sessions.end(session, second)
    assert known() == {third}
