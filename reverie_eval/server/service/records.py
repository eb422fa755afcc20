"""Rows beside the audit log: what one tells of, the other shows.

The log's chain shows what was removed from its midst. What was cut off its end shows here: a row is
still there, and no entry tells of it. So does what was written to the database by other means.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import NamedTuple

from sqlalchemy import Executable, literal, null, select
from sqlalchemy.orm import Session

from reverie_eval.server.store.tables import (
    AuditEntry,
    Base,
    Grant,
    Notice,
    Person,
    ReportedResult,
    Review,
    Submission,
    Team,
    Token,
)

_SUBMITTED = "submitted"
_LEAVE_NO_TRACE = frozenset({"changed", "token revoked", "team renamed"})
"""Actions that may be repeated; the row shows the last one at most."""


class Action(NamedTuple):
    """Something that was done to a row."""

    name: str
    row: str
    """As entries refer to it: ``team:3``."""
    at: datetime | None
    """None of a submission: there is one of its id, and it is entered some time after it came."""

    def __str__(self) -> str:
        when = "" if self.at is None else f", {self.at:%Y-%m-%d %H:%M:%S}"
        return f"{self.name} ({self.row}{when})"


def mismatches(session: Session) -> Iterator[str]:
    """Tell where the audit log and the rows disagree."""
    told, shown = set(_told(session)), set(_shown(session))
    for action in sorted(told - shown, key=str):
        if action.name not in _LEAVE_NO_TRACE:
            yield f"{action}: logged, but no longer in the database"
    for action in sorted(shown - told, key=str):
        yield f"{action}: in the database, but not logged"
    names = dict(_told_names(session))
    for table in (Team, Person):
        for key, name in session.execute(select(table.id, table.name)):
            row = f"{table.__tablename__}:{key}"
            if names.get(row, name) != name:
                yield f"{row} is called {name!r}; the audit log calls it {names[row]!r}"


def names_of_teams(session: Session) -> Mapping[str, frozenset[str]]:
    """Return every name that a team has had, by the one that it has now."""
    names = defaultdict(set)
    for row, name in _told_names(session):
        names[row].add(name)
    teams = session.execute(select(Team.id, Team.name))
    return {name: frozenset(names[f"{Team.__tablename__}:{key}"] | {name}) for key, name in teams}


def _told(session: Session) -> Iterator[Action]:
    entered = select(AuditEntry.action, AuditEntry.row, AuditEntry.at)
    for name, row, at in session.execute(entered):
        yield Action(name, row, None if name == _SUBMITTED else at)


def _shown(session: Session) -> Iterator[Action]:
    for table, rows in _SHOWN:
        for name, key, at in session.execute(rows):
            if at is not None or name == _SUBMITTED:
                yield Action(name, f"{table.__tablename__}:{key}", at)


def _told_names(session: Session) -> Iterator[tuple[str, str]]:
    """Tell what each team and each person is called, again whenever that changed."""
    named = AuditEntry.action.in_(["team added", "person added", "team renamed"])
    for entry in session.scalars(select(AuditEntry).where(named).order_by(AuditEntry.id)):
        yield entry.row, entry.details.get("after", entry.subject)


_SHOWN: Sequence[tuple[type[Base], Executable]] = (
    (Team, select(literal("team added"), Team.id, Team.created_at)),
    (Person, select(literal("person added"), Person.id, Person.created_at)),
    (Token, select(Token.kind.concat(" token created"), Token.id, Token.created_at)),
    # An invitation that was used has no entry of its own, but the token has that it became.
    (
        Token,
        select(literal("token revoked"), Token.id, Token.revoked_at).where(Token.kind == "access"),
    ),
    (Submission, select(literal(_SUBMITTED), Submission.id, null())),
    (Submission, select(literal("changed"), Submission.id, Submission.published_at)),
    (Submission, select(literal("changed"), Submission.id, Submission.withdrawn_at)),
    (Grant, select(literal("granted"), Grant.id, Grant.created_at)),
    (Review, select(Review.verdict, Review.id, Review.created_at)),
    (Review, select(literal("review lifted"), Review.id, Review.lifted_at)),
    (
        ReportedResult,
        select(literal("reported result added"), ReportedResult.id, ReportedResult.created_at),
    ),
    (
        ReportedResult,
        select(literal("reported result removed"), ReportedResult.id, ReportedResult.removed_at),
    ),
    (Notice, select(literal("notice posted"), Notice.id, Notice.created_at)),
)
"""What rows show, in the words of an entry, and when it was; None if it was not."""
