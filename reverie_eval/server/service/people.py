"""Teams, persons and the tokens that they show.

A token is 32 random bytes; the database has its SHA-256. That needs no salt and no slow hash: there
is nothing to guess. An invitation is a token that can be exchanged once for a token of access.
"""

import hashlib
import secrets
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from reverie_eval.schemas.wire import LONGEST_NAME, one_line
from reverie_eval.server.errors import (
    ConflictError,
    MalformedError,
    NotFoundError,
    NotSignedInError,
)
from reverie_eval.server.service.audit import record
from reverie_eval.server.store.tables import Person, Role, Team, Token, TokenKind

PREFIX = "rv_"
"""Lets people, and scanners of repositories, recognise a token."""
HINT_LENGTH = len(PREFIX) + 8
"""Letters of a token that may be known: enough to tell it apart, and 35 are left to guess."""

CALLED: Mapping[TokenKind, str] = {"access": "token", "invite": "invitation"}
"""What people call a token of a kind."""


@dataclass(frozen=True, slots=True)
class Minted:
    """A token, and the text that is shown once."""

    text: str
    token: Token


def add_team(session: Session, name: str, *, now: datetime, actor: str) -> Team:
    """Add a team.

    Raises
    ------
    ConflictError
        If there is one of that name.
    MalformedError
        If this is no name.
    """
    team = Team(name=_line(name, "team"), created_at=now)
    _insert(session, team, f"there is a team {name!r} already")
    record(session, now, actor, "team added", team.name)
    return team


def add_person(
    session: Session, team: str, name: str, role: Role, *, now: datetime, actor: str
) -> Person:
    """Add a person to a team.

    Raises
    ------
    ConflictError
        If there is one of that name.
    MalformedError
        If this is no name.
    NotFoundError
        If there is no such team.
    """
    found = team_named(session, team)
    person = Person(team_id=found.id, name=_line(name, "person"), role=role, created_at=now)
    _insert(session, person, f"there is a person {name!r} already")
    record(session, now, actor, "person added", person.name, team=team, role=role)
    return person


def team_named(session: Session, name: str) -> Team:
    """Return a team; NotFoundError if there is none of that name."""
    team = session.scalars(select(Team).where(Team.name == name)).first()
    if team is None:
        raise NotFoundError(f"there is no team {name!r}")
    return team


def person_named(session: Session, name: str) -> Person:
    """Return a person; NotFoundError if there is none of that name."""
    person = session.scalars(select(Person).where(Person.name == name)).first()
    if person is None:
        raise NotFoundError(f"there is no person {name!r}")
    return person


def all_teams(session: Session) -> Sequence[Team]:
    """Return the teams by name."""
    return session.scalars(select(Team).order_by(Team.name)).all()


def all_people(session: Session) -> Sequence[Person]:
    """Return everybody by name."""
    return session.scalars(select(Person).order_by(Person.name)).all()


def all_tokens(session: Session) -> Sequence[Token]:
    """Return what is known of the tokens, in the order in which they were made."""
    return session.scalars(select(Token).order_by(Token.id)).all()


def mint(
    session: Session,
    person: Person,
    kind: TokenKind,
    *,
    now: datetime,
    actor: str,
    expires_at: datetime | None = None,
) -> Minted:
    """Make a token; its text cannot be had again.

    Raises
    ------
    MalformedError
        If it would be worth nothing.
    """
    if expires_at is not None and expires_at <= now:
        raise MalformedError("it would have expired already; choose a later time")
    text = PREFIX + secrets.token_urlsafe(32)
    token = Token(
        person=person,
        kind=kind,
        digest=_digest(text),
        hint=text[:HINT_LENGTH],
        created_at=now,
        expires_at=expires_at,
    )
    session.add(token)
    session.flush()
    record(session, now, actor, f"{kind} token minted", person.name, hint=token.hint)
    return Minted(text, token)


def exchange(session: Session, invitation: str, now: datetime) -> Minted:
    """Turn an invitation into a token of access, once.

    Raises
    ------
    NotSignedInError
        If it is none, was used, or has expired.
    """
    used = valid_token(session, invitation, "invite", now)
    used.revoked_at = now
    return mint(session, used.person, "access", now=now, actor=used.person.name)


def revoke(session: Session, hint: str, *, now: datetime, actor: str) -> Token:
    """Make a token worthless, by its first letters."""
    tokens = session.scalars(select(Token).where(Token.hint == hint)).all()
    if len(tokens) != 1:
        raise NotFoundError(f"there is no token that begins with {hint!r}; `token list` shows all")
    (token,) = tokens
    token.revoked_at = token.revoked_at or now
    record(session, now, actor, "token revoked", token.person.name, hint=hint)
    return token


def revoke_all(
    session: Session, people: Iterable[Person], *, now: datetime, actor: str
) -> Sequence[Token]:
    """Make every token and invitation of these people worthless; return those that still were."""
    theirs = Token.person_id.in_([person.id for person in people])
    tokens = session.scalars(select(Token).where(theirs, Token.revoked_at.is_(None))).all()
    for token in tokens:
        token.revoked_at = now
        record(session, now, actor, "token revoked", token.person.name, hint=token.hint)
    return tokens


def who_shows(session: Session, text: str, now: datetime) -> Person:
    """Return whose token this is.

    Raises
    ------
    NotSignedInError
        If it is none, was revoked, or has expired.
    """
    return valid_token(session, text, "access", now).person


def valid_token(session: Session, text: str, kind: TokenKind, now: datetime) -> Token:
    """Return the token that has this text.

    Raises
    ------
    NotSignedInError
        If there is none of this kind, or it is not valid any more.
    """
    digest = _digest(text)
    token = session.scalars(select(Token).where(Token.digest == digest)).first()
    # The index has compared digests, whose timing tells nothing of the text; this compares all.
    is_known = token is not None and secrets.compare_digest(token.digest, digest)
    if token is None or not is_known or token.kind != kind:
        raise NotSignedInError(f"this is no {CALLED[kind]} of this server")
    demand_valid(token, now)
    return token


def demand_valid(token: Token, now: datetime) -> None:
    """Refuse a token that was revoked, was used, or has expired: it is worth nothing at its end.

    Raises
    ------
    NotSignedInError
        Saying which.
    """
    this = f"this {CALLED[token.kind]}"
    if token.revoked_at is not None:
        became = {"access": "was revoked", "invite": "was used or revoked"}[token.kind]
        raise NotSignedInError(f"{this} {became}; ask the organiser for another")
    if token.expires_at is not None and token.expires_at <= now:
        raise NotSignedInError(f"{this} has expired; ask the organiser for another")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _line(name: str, kind: str) -> str:
    """Return a name that fits a line of a log and a cell of a table."""
    try:
        line = one_line(name.strip())
    except ValueError:
        line = ""
    if not 0 < len(line) <= LONGEST_NAME:
        shown = name[:LONGEST_NAME]
        raise MalformedError(f"{shown!r} is no name of a {kind}; use up to {LONGEST_NAME} letters")
    return line


def _insert(session: Session, row: Team | Person, conflict: str) -> None:
    try:
        with session.begin_nested():
            session.add(row)
            session.flush()
    except IntegrityError:
        raise ConflictError(conflict) from None
