"""Who somebody is: by a token, or by a browser session that began with one.

A token is 32 random bytes; the database stores its SHA-256. Random tokens cannot be guessed, so
this needs no salt and no slow hash.

A session's cookie is its id, signed, so reading the database is not enough to forge one. A session
is a row: signing out ends it for every copy of the cookie. It is valid only while the token that it
began with is valid.
"""

import hashlib
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal, Self, TypeAlias

from itsdangerous import BadSignature, Signer
from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import TokenKind, TokenReport
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ConflictError, ForgedError, NotSignedInError
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import BrowserSession, Person, Token

PREFIX = "rv_"
"""Lets people and secret scanners recognise a token."""

HINT_LENGTH = len(PREFIX) + 8
"""The public beginning of a token: enough to identify it; 35 random characters stay secret."""

TokenState: TypeAlias = Literal["valid", "expired", "revoked", "used or revoked"]

TOKEN_NAMES: Mapping[TokenKind, str] = {"access": "token", "invite": "invitation"}
"""Names for people, by kind."""

_OF_OTHER_KIND: Mapping[TokenKind, str] = {
    "access": "this is a token, not an invitation; sign in with it",
    "invite": "this is an invitation, not a token; exchange it for a token first",
}
"""What to do with a token that was given in place of the other kind; both look alike."""

LIFETIME = timedelta(hours=12)
"""Lifetime of a session; using the session does not extend it."""


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


def valid_token(session: Session, text: str, kind: TokenKind, now: datetime) -> Token:
    """Return the token that has this text.

    Raises
    ------
    NotSignedInError
        If there is no token of this kind, or it is no longer valid.
    """
    digest = digest_of(text)
    token = session.scalars(select(Token).where(Token.digest == digest)).first()
    # The index compares digests, whose timing reveals nothing about the text; compare them fully.
    is_known = token is not None and secrets.compare_digest(token.digest, digest)
    if token is None or not is_known:
        raise NotSignedInError(f"unknown {TOKEN_NAMES[kind]}; ask the organiser for another")
    if token.kind != kind:
        raise NotSignedInError(_OF_OTHER_KIND[token.kind])
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


class Sessions:
    """Begins, finds and ends browser sessions.

    ``secret`` is for signatures, and the same in all processes of a server.
    """

    def __init__(self, secret: bytes) -> None:
        self._cookies = _signer(secret, "cookie")
        self._csrf_tokens = _signer(secret, "csrf")

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the sessions of a server."""
        return cls(server.signer.secret_for("browser sessions"))

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
        return NewSession(browser, self._cookies.sign(browser.id).decode())

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
        """Make sure that a form has the session's CSRF token.

        Raises ForgedError if it does not.
        """
        if not secrets.compare_digest(self.csrf_token(session_id).encode(), shown.encode()):
            raise ForgedError("the form is not of this browser session; open its page again")


def name_in(cookie: str) -> str:
    """Return the session id in a cookie, without checking the signature.

    One signature can be written in several valid ways, so whole cookies do not identify a session.
    """
    return cookie.rpartition(".")[0]


def _signer(secret: bytes, purpose: str) -> Signer:
    return Signer(secret, purpose, key_derivation="hmac", digest_method=hashlib.sha256)


def digest_of(text: str) -> str:
    """Return by what a token is stored."""
    return hashlib.sha256(text.encode()).hexdigest()
