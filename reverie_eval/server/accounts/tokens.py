"""Tokens, and invitations that can be exchanged for a token once: created, listed and revoked."""

import secrets
from collections.abc import Iterable
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import NewToken, NewTokenReport, TokenKind, TokenReport
from reverie_eval.schemas.service import Welcome
from reverie_eval.server.accounts.people import person_named, team_named
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ConflictError, MalformedError, NotFoundError, RequestError
from reverie_eval.server.identity import HINT_LENGTH, PREFIX, digest_of, valid_token
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import Person, Token
from reverie_eval.text import first_few

INVITATION_LIFETIME = timedelta(days=14)
"""Lifetime of an invitation, unless the organiser chooses another."""


def create_token(transaction: Transaction, new: NewToken) -> NewTokenReport:
    """Create a token or an invitation for a person; its text is returned only once.

    An invitation lasts 14 days, and a token for ever, unless an end is given.

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
    ends = new.expires_at
    if ends is None and new.kind == "invite":
        ends = transaction.now + INVITATION_LIFETIME
    return _create(transaction, person, new.kind, ends)


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
    own = transaction.as_actor(person)
    own.record("invitation used", used, person, hint=used.hint)
    created = _create(own, person, "access", None)
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
            f"no token begins with {begins!r}; `server token list` lists all tokens"
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


def list_tokens(session: Session, page: Page) -> Listed[TokenReport]:
    """List tokens and invitations, the latest first."""
    return list_page(session, select(Token), Token.id, page, token_report, newest_first=True)


def token_report(token: Token) -> TokenReport:
    """Return what organisers see of a token."""
    return token.as_report(TokenReport, person=token.person.name, team=token.person.team.name)


def _create(
    transaction: Transaction, person: Person, kind: TokenKind, expires_at: datetime | None
) -> NewTokenReport:
    if expires_at is not None and expires_at <= transaction.now:
        raise MalformedError("the expiry time is in the past; choose a later time")
    text = PREFIX + secrets.token_urlsafe(32)
    token = Token(
        person=person,
        kind=kind,
        digest=digest_of(text),
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
