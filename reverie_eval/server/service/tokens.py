"""Tokens, invitations that can be exchanged for a token once, and browser sessions.

A token is 32 random bytes; the database stores its SHA-256. Random tokens cannot be guessed, so
this needs no salt and no slow hash.

A session's cookie is its id, signed, so reading the database is not enough to forge one. A session
is a row: signing out ends it for every copy of the cookie. It is valid only while the token that it
began with is valid.
"""

import hashlib
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal, TypeAlias

from itsdangerous import BadSignature, Signer
from sqlalchemy import ColumnElement, delete, func, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewToken, NewTokenReport, TokenKind, TokenReport
from reverie_eval.schemas.service import Welcome
from reverie_eval.server.errors import (
    ConflictError,
    ForgedError,
    MalformedError,
    NotFoundError,
    NotSignedInError,
    RequestError,
)
from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.service.people import person_named, team_named
from reverie_eval.server.service.transactions import Transaction
from reverie_eval.server.store.tables import BrowserSession, Person, Token
from reverie_eval.text import first_few

PREFIX = "rv_"
"""Lets people and secret scanners recognise a token."""
HINT_LENGTH = len(PREFIX) + 8
"""The public beginning of a token: enough to identify it; 35 random characters stay secret."""

TokenState: TypeAlias = Literal["valid", "expired", "revoked", "used or revoked"]
TOKEN_NAMES: Mapping[TokenKind, str] = {"access": "token", "invite": "invitation"}
"""Names for people, by kind."""

INVITATION_LIFETIME = timedelta(days=14)
"""Lifetime of an invitation, unless the organiser chooses another."""
LIFETIME = timedelta(hours=12)
"""Lifetime of a session; using the session does not extend it."""


def create_token(transaction: Transaction, new: NewToken) -> NewTokenReport:
    """Create a token or an invitation for a person; its text is returned only once.

    Raises
    ------
    NotFoundError
        If there is no such person.
    ConflictError
        If several teams have a person of that name, and no team is given.
    MalformedError
        If it would already be expired.
    """
    person = person_named(transaction.session, new.person, new.team)
    return _create(transaction, person, new.kind, new.expires_at)


def accept_invitation(transaction: Transaction, invitation: str) -> Welcome:
    """Exchange an invitation for a token, once; its person becomes the actor.

    Raises
    ------
    NotSignedInError
        If the invitation is unknown, used, revoked or expired.
    """
    used = valid_token(transaction.session, invitation, "invite", transaction.now)
    used.revoked_at = transaction.now
    person = used.person
    created = _create(transaction.as_actor(person), person, "access", None)
    return Welcome(person=person.name, team=person.team.name, token=created.token)


def revoke_token(transaction: Transaction, hint: str) -> TokenReport:
    """Revoke a token, given its first characters, and the browser sessions that began with it.

    Raises
    ------
    NotFoundError
        If no token begins with them.
    ConflictError
        If they are too few to tell which token is meant; it names those that begin with them.
    """
    tokens = transaction.session.scalars(select(Token).where(Token.hint == hint)).all()
    if len(tokens) != 1:
        raise _not_one_token(transaction.session, hint)
    _revoke(transaction, tokens)
    return token_report(tokens[0])


def _not_one_token(session: Session, begins: str) -> RequestError:
    is_meant = func.substr(Token.hint, 1, len(begins)) == begins  # LIKE ignores case in SQLite
    valid_first = (Token.revoked_at.is_not(None), Token.id)
    tokens = session.scalars(select(Token).where(is_meant).order_by(*valid_first)).all()
    if not tokens:
        return NotFoundError(
            f"there is no token that begins with {begins!r}; `server token list` shows all"
        )
    hints = first_few([f"{each.hint} of {each.person.name}" for each in tokens])
    return ConflictError(
        f"{begins!r} is ambiguous: {hints}. Give the first {HINT_LENGTH} characters of one token"
    )


def revoke_tokens_of_team(transaction: Transaction, name: str) -> list[TokenReport]:
    """Revoke all tokens of a team's people. Raises NotFoundError if there is no such team."""
    team = team_named(transaction.session, name)
    return _revoke_valid(transaction, Token.person_id.in_([person.id for person in team.people]))


def revoke_tokens_of_person(
    transaction: Transaction, name: str, team: str | None = None
) -> list[TokenReport]:
    """Revoke all tokens of a person; raises the errors of :func:`person_named`."""
    return revoke_all(transaction, person_named(transaction.session, name, team))


def revoke_all(transaction: Transaction, person: Person) -> list[TokenReport]:
    """Revoke all tokens and invitations of a person."""
    return _revoke_valid(transaction, Token.person_id == person.id)


def has_organiser(session: Session, now: datetime) -> bool:
    """Whether an organiser has a valid token."""
    is_valid = Token.revoked_at.is_(None) & (Token.expires_at.is_(None) | (Token.expires_at > now))
    tokens = select(Token.id).join(Person)
    tokens = tokens.where(Person.is_organiser, Token.kind == "access", is_valid)
    return session.scalar(select(tokens.exists())) or False


def check_organiser_left(transaction: Transaction) -> None:
    """Make sure that an organiser can sign in. Raises ConflictError if none has a valid token.

    An action over HTTP is followed by this check: otherwise nobody could undo it over HTTP. It is
    not part of the actions, because commands must be able to revoke the last token, if it was
    stolen for example. On the server's machine, `server token add` can always create another:
    there is always an organiser, because the only one cannot be deleted.
    """
    if not has_organiser(transaction.session, transaction.now):
        raise ConflictError(
            "this would leave no organiser with a valid token; first create a token for an "
            "organiser who stays, or do this with `reverie-eval server` on the server's machine"
        )


def list_tokens(session: Session, page: Page) -> Listed[TokenReport]:
    """List tokens and invitations, the latest first."""
    return list_page(session, select(Token), Token.id, page, token_report, newest_first=True)


def token_report(token: Token) -> TokenReport:
    """Return what organisers see of a token."""
    return token.as_report(TokenReport, person=token.person.name, team=token.person.team.name)


def valid_token(session: Session, text: str, kind: TokenKind, now: datetime) -> Token:
    """Return the token that has this text.

    Raises
    ------
    NotSignedInError
        If there is no token of this kind, or it is no longer valid.
    """
    digest = _digest(text)
    token = session.scalars(select(Token).where(Token.digest == digest)).first()
    # The index compares digests, whose timing reveals nothing about the text; compare them fully.
    is_known = token is not None and secrets.compare_digest(token.digest, digest)
    if token is None or not is_known or token.kind != kind:
        raise NotSignedInError(f"unknown {TOKEN_NAMES[kind]}; ask the organiser for another")
    check_valid(token, now)
    return token


def check_valid(token: Token, now: datetime) -> None:
    """Refuse a token that is revoked, used or expired; at its time of expiry, it is expired.

    NotSignedInError says why it is refused.
    """
    state = token_state(token, now)
    if state != "valid":
        ended = "has expired" if state == "expired" else f"was {state}"
        raise NotSignedInError(
            f"this {TOKEN_NAMES[token.kind]} {ended}; ask the organiser for another"
        )


def token_state(token: Token | TokenReport, now: datetime) -> TokenState:
    """Return whether a token is valid, and if not, why."""
    if token.revoked_at is not None:
        return "used or revoked" if token.kind == "invite" else "revoked"
    return "expired" if token.expires_at is not None and token.expires_at <= now else "valid"


@dataclass(frozen=True, slots=True)
class NewSession:
    """A new session."""

    session: BrowserSession
    cookie: str
    csrf_token: str


class Sessions:
    """Begins, finds and ends browser sessions.

    ``secret`` is for signatures, and the same in all processes of a server.
    """

    def __init__(self, secret: bytes) -> None:
        self._cookies = _signer(secret, "cookie")
        self._csrf_tokens = _signer(secret, "csrf")

    def begin(self, session: Session, token: str, now: datetime) -> NewSession:
        """Begin a session for the owner of a token, and delete expired ones.

        Raises
        ------
        NotSignedInError
            If it is not a valid access token.
        """
        valid = valid_token(session, token, "access", now)
        session.execute(delete(BrowserSession).where(BrowserSession.expires_at <= now))
        browser = BrowserSession(
            id=secrets.token_urlsafe(32),
            token=valid,
            created_at=now,
            expires_at=min(now + LIFETIME, valid.expires_at or now + LIFETIME),
        )
        session.add(browser)
        return NewSession(
            browser, self._cookies.sign(browser.id).decode(), self.csrf_token(browser.id)
        )

    def id_in(self, cookie: str) -> str | None:
        """Return the session id in a cookie; None if its signature is wrong."""
        try:
            return self._cookies.unsign(cookie).decode()
        except BadSignature:
            return None

    def find(self, session: Session, session_id: str, now: datetime) -> BrowserSession | None:
        """Return a session; None if it does not exist or has ended."""
        browser = session.get(BrowserSession, session_id)
        if browser is None or browser.expires_at <= now:
            return None
        try:
            check_valid(browser.token, now)
        except NotSignedInError:
            return None
        return browser

    def end(self, session: Session, session_id: str) -> None:
        """End a session, if it has not ended already."""
        session.execute(delete(BrowserSession).where(BrowserSession.id == session_id))

    def csrf_token(self, session_id: str) -> str:
        """Return the token that this server's pages send and other sites cannot know."""
        return self._csrf_tokens.sign(session_id).decode().removeprefix(f"{session_id}.")

    def check_csrf_token(self, session_id: str, shown: str) -> None:
        """Make sure that a request shows the session's CSRF token.

        Raises ForgedError if it does not.
        """
        if not secrets.compare_digest(self.csrf_token(session_id).encode(), shown.encode()):
            raise ForgedError(
                "send the session's csrf_token as X-CSRF-Token; GET /api/v1/session returns it"
            )


def name_in(cookie: str) -> str:
    """Return the session id in a cookie, without checking the signature.

    One signature can be written in several valid ways, so whole cookies do not identify a session.
    """
    return cookie.rpartition(".")[0]


def _signer(secret: bytes, purpose: str) -> Signer:
    return Signer(secret, purpose, key_derivation="hmac", digest_method=hashlib.sha256)


def _create(
    transaction: Transaction, person: Person, kind: TokenKind, expires_at: datetime | None
) -> NewTokenReport:
    if expires_at is not None and expires_at <= transaction.now:
        raise MalformedError("the expiry time is in the past; choose a later time")
    text = PREFIX + secrets.token_urlsafe(32)
    token = Token(
        person=person,
        kind=kind,
        digest=_digest(text),
        hint=text[:HINT_LENGTH],
        created_at=transaction.now,
        expires_at=expires_at,
    )
    until = None if expires_at is None else expires_at.isoformat()
    about = {"person_id": person.id, "hint": token.hint, "expires_at": until}
    transaction.record(f"{kind} token created", token, person, **about)
    return NewTokenReport(**token_report(token).model_dump(), token=text)


def _revoke_valid(transaction: Transaction, whose: ColumnElement[bool]) -> list[TokenReport]:
    chosen = select(Token).where(whose, Token.revoked_at.is_(None)).order_by(Token.id)
    tokens = transaction.session.scalars(chosen).all()
    _revoke(transaction, tokens)
    return [token_report(token) for token in tokens]


def _revoke(transaction: Transaction, tokens: Iterable[Token]) -> None:
    for token in tokens:
        token.revoked_at = token.revoked_at or transaction.now
        transaction.record("token revoked", token, token.person, hint=token.hint)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
