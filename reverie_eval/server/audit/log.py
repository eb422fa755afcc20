"""The audit log: who did what, in a chain of keyed digests that reveals later changes.

Each entry's digest is an HMAC-SHA256 over the entry and the digest before it, under a key that is
derived from the signing key in use. So anyone who can write to the database, but does not have
that key, cannot change or insert an entry, or remove one that another follows, without breaking the
chain. Only the owner of the signing key could rewrite the log. After a key was replaced, the links
of later entries protect the earlier ones from anyone who only has the old key.

If a key was lost, the entries up to then cannot be checked. What says so is the entry that records
the loss, made with the next key: a key that is merely missing from the database is no excuse.

Entries refer to persons by their rows, ``person:3``, never by name: a person's name and address can
be deleted without changing the log. Names are looked up when the log is read. To reveal names that
were swapped behind the server's back, each entry that gives a person a name has the keyed digest of
that name.

The chain does not show that entries were removed at its end, or that rows were changed. Comparing
them does: see :mod:`~reverie_eval.server.audit.rows`.
"""

import hashlib
import hmac
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, NamedTuple

import msgspec
from sqlalchemy import ColumnElement, func, inspect, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import AuditReport
from reverie_eval.server.audit.keys import audit_key_of, audit_keys
from reverie_eval.server.audit.receipts import Signer
from reverie_eval.server.store.database import AT_ONCE, IS_READING
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import IS_CHANGE, SAME_FILE, AuditEntry, Base, Person

SERVER = "server"
"""The server itself: who makes changes that nobody asks for, and what some changes are about."""
_BEFORE_THE_FIRST = "0" * 64
KEY_REPLACED = "signing key replaced"
RULES = "rules recorded"
"""The action of a server that starts with other rules than the last one."""
INSPECTED = "inspected"
"""The action of an organiser who reads the values of a submission's episodes."""
_PERSON = re.compile(r"person:([0-9]{1,9})")
_SWITCHES = {
    ("withdrawn", True): "withdrawn",
    ("withdrawn", False): "restored",
    ("published", True): "published",
    ("published", False): "unpublished",
    ("shows_episodes", True): "episodes shown to everyone",
    ("shows_episodes", False): "episodes shown to the team only",
}


_NUMBERS = "last recorded"
"""Where a session that only reads keeps what :func:`last_recorded` returns."""


class AuditLog:
    """Writes and checks the log; the signer has the key in use, the same in all processes."""

    def __init__(self, signer: Signer) -> None:
        self.signer = signer
        self._key = audit_key_of(signer)

    def append(
        self,
        session: Session,
        at: datetime,
        actor: str,
        action: str,
        *,
        row: str,
        subject: str,
        **details: Any,
    ) -> None:
        """Append an entry on a row, by its name, in the transaction of the session."""
        last = session.scalars(select(AuditEntry.digest).order_by(AuditEntry.id.desc()).limit(1))
        entry = AuditEntry(
            at=at,
            actor=actor,
            action=action,
            subject=subject,
            row=row,
            details=details,
            key_id=self.signer.key_id,
            previous=last.first() or _BEFORE_THE_FIRST,
        )
        entry.digest = self.digest(entry)
        session.add(entry)
        session.flush()

    def name_digest(self, person: Person) -> str:
        """Return the keyed digest of a person's row and name."""
        return name_digest(person, self._key)

    def digest(self, entry: AuditEntry) -> str:
        """Return the digest of a new entry."""
        return _digest(entry, self._key)

    def altered(self, session: Session, entries: Sequence[AuditEntry]) -> Sequence[int]:
        """Return the ids of entries that were changed after they were written."""
        keys = self._keys(session)
        return [entry.id for entry in entries if not keys.accept(entry)]

    def broken_links(self, session: Session) -> Iterator[int]:
        """Return the ids of entries that were changed, or that follow a missing entry.

        If the key of an entry was lost, only its links are checked.
        """
        keys, previous = self._keys(session), _BEFORE_THE_FIRST
        chosen = select(AuditEntry).order_by(AuditEntry.id).execution_options(yield_per=AT_ONCE)
        for entry in session.scalars(chosen):
            if entry.previous != previous or not keys.accept(entry):
                yield entry.id
            previous = entry.digest

    def unprovable(self, session: Session) -> Mapping[str, int]:
        """Count the entries whose key was lost, by signing key."""
        keys = self._keys(session)
        if not keys.last_loss:
            return {}
        lost = [name for name, key in keys.by_name.items() if key is None]
        is_lost = AuditEntry.key_id.in_(lost), AuditEntry.id < keys.last_loss
        counted = select(AuditEntry.key_id, func.count()).where(*is_lost)
        rows = session.execute(counted.group_by(AuditEntry.key_id))
        return {str(key_id): number for key_id, number in rows}

    def _keys(self, session: Session) -> "_Keys":
        """Return the keys of all entries, and where the log itself proves that some were lost."""
        keys = _Keys(audit_keys(session, self.signer), 0)
        replacements = entries(session, AuditEntry.action == KEY_REPLACED)
        losses = [
            each.id for each in replacements if each.details.get("lost") and keys.accept(each)
        ]
        return keys._replace(last_loss=max(losses, default=0))


class _Keys(NamedTuple):
    """The keys of the log's entries."""

    by_name: Mapping[str, bytes | None]
    """By signing key; None for a key that the server does not have."""
    last_loss: int
    """The entry that records that keys were lost; 0 if none does. Entries before it may have one
    that the server does not have."""

    def accept(self, entry: AuditEntry) -> bool:
        """Whether an entry is as it was written, or made with a key that was lost."""
        key = self.by_name.get(entry.key_id)
        if key is None:
            return entry.key_id in self.by_name and entry.id < self.last_loss
        return hmac.compare_digest(entry.digest, _digest(entry, key))


def _digest(entry: AuditEntry, key: bytes) -> str:
    parts = (
        entry.at.astimezone(UTC).isoformat(timespec="microseconds"),
        *(entry.actor, entry.action, entry.row, entry.subject),
        *(entry.details, entry.previous),
    )
    return _keyed_digest(key, parts)


def _keyed_digest(key: bytes, parts: tuple[Any, ...]) -> str:
    return hmac.new(key, msgspec.json.encode(parts, order="sorted"), hashlib.sha256).hexdigest()


def name_digest(person: Person, key: bytes) -> str:
    """Return the keyed digest of a person's row and name."""
    return _keyed_digest(key, (row_name(person), person.name))[:16]


def row_name(row: Base) -> str:
    """Return the name by which entries refer to a row, which never changes: ``team:3``."""
    return f"{row.__tablename__}:{inspect(row).mapper.primary_key_from_instance(row)[0]}"


def entries(session: Session, *where: ColumnElement[bool]) -> Sequence[AuditEntry]:
    """Return all entries, or those that meet conditions, the oldest first."""
    return session.scalars(select(AuditEntry).where(*where).order_by(AuditEntry.id)).all()


def list_entries(
    session: Session,
    page: Page,
    *,
    actor: str = "",
    subject: str = "",
    newest_first: bool = False,
) -> Listed[AuditEntry]:
    """List entries; only those by an actor or about a subject, if given."""
    rows = select(AuditEntry)
    if actor:
        rows = rows.where(AuditEntry.actor.in_([actor, *_rows_called(session, actor)]))
    if subject:
        rows = rows.where(AuditEntry.subject.in_([subject, *_rows_called(session, subject)]))
    return list_page(session, rows, AuditEntry.id, page, lambda row: row, newest_first=newest_first)


def list_reports(session: Session, page: Page) -> Listed[AuditReport]:
    """List entries as organisers see them, the oldest first."""
    listed = list_entries(session, page)
    return Listed(audit_reports(session, listed.rows), listed.next_cursor)


def audit_reports(session: Session, entries: Sequence[AuditEntry]) -> list[AuditReport]:
    """Return entries as organisers see them, with the names of persons."""
    names = names_in(session, entries)
    return [
        entry.as_report(
            AuditReport,
            actor=names.get(entry.actor, entry.actor),
            actor_row=entry.actor if entry.actor in names else "",
            subject=names.get(entry.subject, entry.subject),
        )
        for entry in entries
    ]


def names_in(
    session: Session, entries: Iterable[AuditEntry], *where: ColumnElement[bool]
) -> Mapping[str, str]:
    """Return the current names of the persons that entries refer to, by row; maybe only of some."""
    found = {name for entry in entries for name in (entry.actor, entry.subject)}
    numbers = {int(match[1]) for name in found if (match := _PERSON.fullmatch(name))}
    chosen = select(Person.id, Person.name).where(Person.id.in_(numbers), *where)
    people = session.execute(chosen)
    return {f"{Person.__tablename__}:{key}": name for key, name in people}


def _rows_called(session: Session, name: str) -> Iterator[str]:
    """Yield the persons with a name, as entries refer to them."""
    for key in session.scalars(select(Person.id).where(Person.name == name)):
        yield f"{Person.__tablename__}:{key}"


@dataclass(frozen=True, slots=True)
class Event:
    """An action in the history of a submission."""

    at: datetime
    actor: str
    """A person who takes part, the server, or the public name of the organiser."""
    what: str
    why: str
    """Empty if the action needs no reason."""


def history(session: Session, submission_id: str, organiser: str) -> Sequence[Event]:
    """Return what happened to a submission, the earliest first.

    Its team sees this. So it does not say that an organiser inspected it, and whatever an account
    of an organiser or a command did has the public name of the organiser.
    """
    own = AuditEntry.subject == submission_id
    found = entries(session, own, AuditEntry.action != INSPECTED)
    names = {SERVER: SERVER, **names_in(session, found, Person.role != "organiser")}
    return [_event(entry, names.get(entry.actor, organiser)) for entry in found]


def _event(entry: AuditEntry, actor: str) -> Event:
    changes: Sequence[str] = ()
    if entry.action == "changed":
        changes = list(_changes(entry.details.get("after", {})))
    what = "; ".join(changes) or entry.action.replace("submitted", "received and scored")
    if entry.action == "review lifted":
        what = f"no longer {entry.details.get('verdict', 'reviewed')}"
    return Event(entry.at, actor, what, str(entry.details.get("reason", "")))


def _changes(details: Mapping[str, Any]) -> Iterator[str]:
    for switch, words in _SWITCHES.items():
        if (switch[0], details.get(switch[0])) == switch:
            yield words
    if "anonymous_until" in details:
        until = details["anonymous_until"]
        yield f"team hidden until {until[:10]}" if until else "team named"
    if details.get("method"):
        yield f"edited: {', '.join(name.replace('_', ' ') for name in details['method'])}"


class Recorded(NamedTuple):
    """The numbers of the last entries of the audit log, by kind; 0 if there is no such entry."""

    change: int
    """The last entry that changed a leaderboard."""
    last: int
    rules: int
    """The last entry about rules, if it is later than the one that the caller knows."""


def last_recorded(session: Session, known_rules: int = 0) -> Recorded:
    """Return the numbers of the last entries; those about rules after ``known_rules`` only."""
    if _NUMBERS in session.info:
        return session.info[_NUMBERS]  # type: ignore[no-any-return]
    last = select(AuditEntry.id).order_by(AuditEntry.id.desc()).limit(1)
    change = last.where(IS_CHANGE, AuditEntry.action != SAME_FILE)
    rules = last.where(AuditEntry.action == RULES, AuditEntry.id > known_rules)
    row = session.execute(select(*(each.scalar_subquery() for each in (change, last, rules)))).one()
    recorded = Recorded(*(number or 0 for number in row))
    if IS_READING in session.info:
        session.info[_NUMBERS] = recorded
    return recorded
