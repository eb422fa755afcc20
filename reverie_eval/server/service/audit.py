"""The audit log: who did what, in a chain of keyed digests that shows what was changed later.

Each entry's digest is an HMAC-SHA256 over the entry and the digest before it, under a key that is
derived from the server's signing key. So whoever can write to the database, but does not have that
key, can neither change an entry, nor add one, nor remove one that another follows. Whoever has the
signing key can write the whole log anew.

Entries at the end can be cut off unseen by the chain, but :func:`mismatches` finds their rows: what
an entry tells of, a row shows, and the other way round. So what was written to the database by
other means shows there too.
"""

import hashlib
import hmac
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, NamedTuple, Self

import msgspec
from sqlalchemy import Executable, inspect, literal, null, select
from sqlalchemy.orm import Session

from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.service.receipts import Signer
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

_BEFORE_THE_FIRST = "0" * 64
_SUBMITTED = "submitted"
_LEAVE_NO_TRACE = frozenset({"changed", "token revoked", "team renamed"})
"""Actions that may be repeated; the row shows the last one at most."""
_SWITCHES = {
    ("withdrawn", True): "withdrawn",
    ("withdrawn", False): "restored",
    ("published", True): "published",
    ("published", False): "taken off the leaderboard",
}


class AuditLog:
    """Writes and checks the log.

    Parameters
    ----------
    key : bytes
        The same for all processes of a server, and secret.
    """

    def __init__(self, key: bytes) -> None:
        self._key = key

    @classmethod
    def of(cls, signer: Signer) -> Self:
        """Return the log of the server that signs with a key."""
        return cls(signer.secret_for("audit log"))

    def append(  # what happened is all of its parts
        self,
        session: Session,
        at: datetime,
        actor: str,
        action: str,
        *,
        row: Base,
        subject: str,
        **details: Any,
    ) -> None:
        """Append an entry; it is kept if the transaction is."""
        last = session.scalars(select(AuditEntry.digest).order_by(AuditEntry.id.desc()).limit(1))
        entry = AuditEntry(
            at=at,
            actor=actor,
            action=action,
            subject=subject,
            row=row_name(row),
            details=details,
            previous=last.first() or _BEFORE_THE_FIRST,
        )
        entry.digest = self._digest(entry)
        session.add(entry)
        session.flush()

    def altered(self, found: Sequence[AuditEntry]) -> Sequence[int]:
        """Return the ids of those entries that are not what was once written."""
        return [entry.id for entry in found if not self._is_sound(entry)]

    def broken_links(self, session: Session) -> Iterator[int]:
        """Return the entries that are not what was once written, or follow a missing one."""
        previous = _BEFORE_THE_FIRST
        for entry in session.scalars(select(AuditEntry).order_by(AuditEntry.id)):
            if entry.previous != previous or not self._is_sound(entry):
                yield entry.id
            previous = entry.digest

    def _is_sound(self, entry: AuditEntry) -> bool:
        return hmac.compare_digest(entry.digest, self._digest(entry))

    def _digest(self, entry: AuditEntry) -> str:
        parts = (
            entry.at.astimezone(UTC).isoformat(timespec="microseconds"),
            *(entry.actor, entry.action, entry.row, entry.subject),
            *(entry.details, entry.previous),
        )
        message = msgspec.json.encode(parts, order="sorted")
        return hmac.new(self._key, message, hashlib.sha256).hexdigest()


def row_name(row: Base) -> str:
    """Name a row as entries refer to it, whatever people call it by then: ``team:3``."""
    return f"{row.__tablename__}:{inspect(row).mapper.primary_key_from_instance(row)[0]}"


def entries(session: Session) -> Sequence[AuditEntry]:
    """Return everything that was recorded, the oldest first."""
    return session.scalars(select(AuditEntry).order_by(AuditEntry.id)).all()


def list_entries(
    session: Session,
    page: Page,
    *,
    actor: str = "",
    subject: str = "",
    newest_first: bool = False,
) -> Listed[AuditEntry]:
    """List what was recorded; only by an actor or about a subject, if these are given."""
    rows = select(AuditEntry)
    if actor:
        rows = rows.where(AuditEntry.actor == actor)
    if subject:
        rows = rows.where(AuditEntry.subject == subject)
    return list_page(session, rows, AuditEntry.id, page, lambda row: row, newest_first=newest_first)


@dataclass(frozen=True, slots=True)
class Event:
    """Something that somebody did."""

    at: datetime
    actor: str
    what: str
    why: str
    """Empty if nobody had to say."""


def history(session: Session, submission_id: str) -> Sequence[Event]:
    """Return what happened to a submission, the earliest first."""
    chosen = select(AuditEntry).where(AuditEntry.subject == submission_id).order_by(AuditEntry.id)
    return [_event(entry) for entry in session.scalars(chosen)]


def _event(entry: AuditEntry) -> Event:
    changes = list(_changes(entry.details)) if entry.action == "changed" else []
    what = "; ".join(changes) or entry.action.replace("submitted", "received and scored")
    if entry.action == "review lifted":
        what = f"no longer {entry.details.get('verdict', 'reviewed')}"
    return Event(entry.at, entry.actor, what, str(entry.details.get("reason", "")))


def _changes(details: Mapping[str, Any]) -> Iterator[str]:
    for switch, words in _SWITCHES.items():
        if (switch[0], details.get(switch[0])) == switch:
            yield words
    if "anonymous_until" in details:
        until = details["anonymous_until"]
        yield f"team hidden until {until[:10]}" if until else "team named"
    if details.get("method"):
        yield f"edited: {', '.join(name.replace('_', ' ') for name in details['method'])}"


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
    told = {
        Action(name, row, None if name == _SUBMITTED else at)
        for name, row, at in session.execute(
            select(AuditEntry.action, AuditEntry.row, AuditEntry.at)
        )
    }
    shown = {
        Action(name, f"{table.__tablename__}:{key}", at)
        for table, rows in _SHOWN
        for name, key, at in session.execute(rows)
        if at is not None or name == _SUBMITTED
    }
    for action in sorted(told - shown, key=str):
        if action.name not in _LEAVE_NO_TRACE:
            yield f"{action}: logged, but no longer in the database"
    for action in sorted(shown - told, key=str):
        yield f"{action}: in the database, but not logged"
    names = dict(_recorded_names(session))
    for table in (Team, Person):
        for key, name in session.execute(select(table.id, table.name)):
            row = f"{table.__tablename__}:{key}"
            if names.get(row, name) != name:
                yield f"{row} is called {name!r}; the audit log calls it {names[row]!r}"


def all_names_of_teams(session: Session) -> Mapping[str, frozenset[str]]:
    """Return every name that a team has had, by the one that it has now."""
    names = defaultdict(set)
    for row, name in _recorded_names(session):
        names[row].add(name)
    teams = session.execute(select(Team.id, Team.name))
    return {name: frozenset(names[f"{Team.__tablename__}:{key}"] | {name}) for key, name in teams}


def _recorded_names(session: Session) -> Iterator[tuple[str, str]]:
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
