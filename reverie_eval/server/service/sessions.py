"""Browser sessions: what a cookie carries, and how a request shows that our own page made it.

The cookie is the session's name, signed: whoever reads the database cannot make one. A session is a
row, so that signing out ends it for everybody who has the cookie, and it is worth what the token is
worth that it began with: revoked or expired, it takes its sessions with it.
"""

import hashlib
import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta

from itsdangerous import BadSignature, Signer
from sqlalchemy import delete
from sqlalchemy.orm import Session

from reverie_eval.server.errors import ForgedError, NotSignedInError
from reverie_eval.server.service.tokens import demand_valid, valid_token
from reverie_eval.server.store.tables import BrowserSession

LIFETIME = timedelta(hours=12)
"""After which one signs in again, however busy the session was."""


@dataclass(frozen=True, slots=True)
class Begun:
    """A session that has begun."""

    session: BrowserSession
    cookie: str
    csrf_token: str


class Sessions:
    """Begins, finds and ends browser sessions.

    Parameters
    ----------
    secret : bytes
        Signs cookies; the same for all processes of a server.
    """

    def __init__(self, secret: bytes) -> None:
        self._cookies = _signer(secret, "cookie")
        self._csrf_tokens = _signer(secret, "csrf")

    def begin(self, session: Session, token: str, now: datetime) -> Begun:
        """Begin a session of whoever shows a token, and forget those that are over.

        Raises
        ------
        NotSignedInError
            If the token is none of access, was revoked, or has expired.
        """
        shown = valid_token(session, token, "access", now)
        session.execute(delete(BrowserSession).where(BrowserSession.expires_at <= now))
        begun = BrowserSession(
            id=secrets.token_urlsafe(32),
            token=shown,
            created_at=now,
            expires_at=min(now + LIFETIME, shown.expires_at or now + LIFETIME),
        )
        session.add(begun)
        return Begun(begun, self._cookies.sign(begun.id).decode(), self.csrf_token(begun.id))

    def id_in(self, cookie: str) -> str | None:
        """Return the id of the session that a cookie is of; None if we did not sign it."""
        try:
            return self._cookies.unsign(cookie).decode()
        except BadSignature:
            return None

    def find(self, session: Session, session_id: str, now: datetime) -> BrowserSession | None:
        """Return a session; None if it is over, or there is none."""
        found = session.get(BrowserSession, session_id)
        if found is None or found.expires_at <= now:
            return None
        try:
            demand_valid(found.token, now)
        except NotSignedInError:
            return None
        return found

    def end(self, session: Session, session_id: str) -> None:
        """End a session; that it was ended meanwhile is no error."""
        session.execute(delete(BrowserSession).where(BrowserSession.id == session_id))

    def csrf_token(self, session_id: str) -> str:
        """Return what our own pages send, and other sites cannot know."""
        return self._csrf_tokens.sign(session_id).decode().removeprefix(f"{session_id}.")

    def demand_csrf_token(self, session_id: str, shown: str) -> None:
        """Refuse a request without the session's token.

        Raises
        ------
        ForgedError
            If it is none, or another session's.
        """
        if not secrets.compare_digest(self.csrf_token(session_id).encode(), shown.encode()):
            raise ForgedError(
                "send the session's csrf_token as X-CSRF-Token; GET /api/v1/session tells it"
            )


def name_in(cookie: str) -> str:
    """Return the name of the session that a cookie is of, if it is signed.

    A signature may be written in several ways, and all of them hold; a name in one.
    """
    return cookie.rpartition(".")[0]


def _signer(secret: bytes, purpose: str) -> Signer:
    return Signer(secret, purpose, key_derivation="hmac", digest_method=hashlib.sha256)
