"""What was done, as the audit log tells it and as the rows show it: one without the other is amiss.

The chain of the log shows what was removed from its midst. What was cut off its end shows here: a
row is still there, and no entry tells of it.
"""

from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import NamedTuple

from sqlalchemy import Executable, literal, null, select
from sqlalchemy.orm import Session

from reverie_eval.server.store.tables import (
    AuditEntry,
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
_REPEATED = frozenset({"changed", "token revoked"})
"""What may be done again and leaves no trace of each time."""


class Deed(NamedTuple):
    """Something that somebody did."""

    action: str
    subject: str
    at: datetime | None
    """None of a submission: there is one of its id, and it is entered some time after it came."""

    def __str__(self) -> str:
        when = "" if self.at is None else f", {self.at:%Y-%m-%d %H:%M:%S}"
        return f"{self.action} {self.subject}{when}"


class Unmatched(NamedTuple):
    """Deeds that only one of the two knows of, by their names."""

    told: Sequence[Deed]
    """By an entry; what it speaks of is not there any more."""
    shown: Sequence[Deed]
    """By a row, of which no entry speaks."""


def unmatched(session: Session) -> Unmatched:
    """Compare the audit log with the rows."""
    told, shown = set(_told(session)), set(_shown(session))
    lost = {deed for deed in told - shown if deed.action not in _REPEATED}
    return Unmatched(sorted(lost, key=str), sorted(shown - told, key=str))


def _told(session: Session) -> Iterator[Deed]:
    entered = select(AuditEntry.action, AuditEntry.subject, AuditEntry.at)
    for action, subject, at in session.execute(entered):
        yield Deed(action, subject, None if action == _SUBMITTED else at)


def _shown(session: Session) -> Iterator[Deed]:
    for rows in _SHOWN:
        for action, subject, at in session.execute(rows):
            if at is not None or action == _SUBMITTED:
                yield Deed(action, subject, at)


_REPORTED = ReportedResult.method["name"].as_string()
_SHOWN: Sequence[Executable] = (
    select(literal("team added"), Team.name, Team.created_at),
    select(literal("person added"), Person.name, Person.created_at),
    select(Token.kind.concat(" token minted"), Person.name, Token.created_at).join(Person),
    # An invitation that was used has no entry of its own, but the token has that it became.
    select(literal("token revoked"), Person.name, Token.revoked_at)
    .join(Person)
    .where(Token.kind == "access"),
    select(literal(_SUBMITTED), Submission.id, null()),
    select(literal("changed"), Submission.id, Submission.published_at),
    select(literal("changed"), Submission.id, Submission.withdrawn_at),
    select(literal("granted"), Team.name, Grant.created_at).join(Team),
    select(Review.verdict, Review.submission_id, Review.created_at),
    select(literal("review lifted"), Review.submission_id, Review.lifted_at),
    select(literal("reported result added"), _REPORTED, ReportedResult.created_at),
    select(literal("reported result removed"), _REPORTED, ReportedResult.removed_at),
    select(literal("notice posted"), literal("server"), Notice.created_at),
)
"""What rows show, in the words of an entry, and when it was; None if it was not."""
