"""The audit log: who did what, in a chain of signed digests that reveals later changes.

Each entry's digest is a SHA-256 over the entry and the digest before it, signed with the key in
use. So anyone who can write to the database, but does not have that key, cannot change or insert an
entry, or remove one that another follows, without breaking the chain. Only the owner of the signing
key could rewrite the log. The entry that replaces a key is signed with the next one, and names the
key that it replaces. So from the key in use, which is a file, the log itself tells which key was in
use at each entry; no other counts there. Public keys stay, so the log can be checked from its first
entry when old private keys were destroyed or lost, and later links protect earlier entries from
anyone who only has an old key.

The number of an entry is not in its digest. It only orders the entries, and so does the chain: one
with another number either stays at its place, or breaks the chain there.

Entries refer to persons by their rows, ``person:3``, never by name: a person's name and address can
be deleted without changing the log. Names are looked up when the log is read.

The chain does not show that entries were removed at its end, or that rows were changed. So each
entry has the digest of its row, with which :mod:`~reverie_eval.server.audit.rows` compares the row.
Of a person, it covers a random salt: nobody can test whether a deleted one had a certain name.
"""

import hashlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, NamedTuple, TypeAlias

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from sqlalchemy import ColumnElement, inspect, select
from sqlalchemy.orm import Session

from reverie_eval.receipts import public_key_of
from reverie_eval.schemas.organising import AuditReport
from reverie_eval.server.audit.signing import Signer
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
_NOT_LOGGED = frozenset({"report", "receipt", "earlier", "boards", "envelope"})
"""Columns that may change without an entry on their row, as a revoked key is an entry on the key.
Receipts and snapshots are signed, and compared with their rows."""
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

    def append(
        self,
        session: Session,
        at: datetime,
        actor: str,
        action: str,
        *,
        row: str,
        row_digest: str,
        subject: str,
        **details: Any,
    ) -> None:
        """Append an entry on a row, by its name and its digest, in the session's transaction."""
        last = session.scalars(select(AuditEntry.digest).order_by(AuditEntry.id.desc()).limit(1))
        entry = AuditEntry(
            at=at,
            actor=actor,
            action=action,
            subject=subject,
            row=row,
            row_digest=row_digest,
            details=details,
            previous=last.first() or _BEFORE_THE_FIRST,
        )
        entry.digest = entry_digest(entry)
        entry.seal = self.signer.seal(entry.digest)
        session.add(entry)
        session.flush()

    def altered(self, session: Session, entries: Sequence[AuditEntry]) -> Sequence[int]:
        """Return the ids of entries that were changed after they were written."""
        keys = self._keys(session)
        return [entry.id for entry in entries if not _is_genuine(entry, keys)]

    def broken_links(self, session: Session) -> Iterator[int]:
        """Return the ids of entries that were changed, or that follow a missing entry."""
        keys, previous = self._keys(session), _BEFORE_THE_FIRST
        chosen = select(AuditEntry).order_by(AuditEntry.id).execution_options(yield_per=AT_ONCE)
        for entry in session.scalars(chosen):
            if entry.previous != previous or not _is_genuine(entry, keys):
                yield entry.id
            previous = entry.digest

    def _keys(self, session: Session) -> "_Keys":
        """Return the keys that were in use, the latest first, each with its first entry."""
        keys, current = [], public_key_of(self.signer.public_pem)
        for entry in reversed(entries(session, AuditEntry.action == KEY_REPLACED)):
            if _is_sealed(entry, current):
                keys.append((entry.id, current))
                current = public_key_of(entry.details["public_key"])
        return [*keys, (-math.inf, current)]


_Keys: TypeAlias = Sequence[tuple[float, Ed25519PublicKey]]


def _is_genuine(entry: AuditEntry, keys: _Keys) -> bool:
    """Whether an entry is as it was written, with the key that was in use."""
    return _is_sealed(entry, next(key for first, key in keys if first <= entry.id))


def _is_sealed(entry: AuditEntry, key: Ed25519PublicKey) -> bool:
    try:
        key.verify(bytes.fromhex(entry.seal), entry.digest.encode())
        return entry.digest == entry_digest(entry)
    except (InvalidSignature, AttributeError, TypeError, ValueError):  # values of other types
        return False


def entry_digest(entry: AuditEntry) -> str:
    """Return the digest of an entry and the digest before it."""
    return _digest_of(
        entry.at.astimezone(UTC).isoformat(timespec="microseconds"),
        *(entry.actor, entry.action, entry.row, entry.subject),
        *(entry.row_digest, entry.details, entry.previous),
    )


def _digest_of(*parts: Any) -> str:
    if any(isinstance(part, bytes) for part in parts):
        # SQLite keeps them in columns of texts; in JSON, they would be like their text in base64.
        raise TypeError("bytes instead of a text")
    return hashlib.sha256(msgspec.json.encode(parts, order="sorted")).hexdigest()


def row_name(row: Base) -> str:
    """Return the name by which entries refer to a row, which never changes: ``team:3``."""
    return f"{row.__tablename__}:{inspect(row).mapper.primary_key_from_instance(row)[0]}"


def logged_columns(kind: type[Base]) -> Sequence[str]:
    """Return the names of the columns that the digests of a table's rows cover."""
    return [name for name in kind.__table__.columns.keys() if name not in _NOT_LOGGED]  # noqa: SIM118


def row_digest(values: Mapping[str, Any]) -> str:
    """Return the digest of a row, given the values of its :func:`logged_columns`.

    What is empty is left out, so a later version may add columns and fields.
    """
    return _digest_of(_comparable(values))


def _comparable(value: Any) -> Any:
    """Return a value of a row in the form that it has after any database has stored it."""
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat(timespec="microseconds")
    if not isinstance(value, Mapping):
        return value
    known = {name: _comparable(each) for name, each in value.items()}
    return {name: each for name, each in known.items() if each not in (None, "")}


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


def details_in_words(details: Mapping[str, Any]) -> Mapping[str, str]:
    """Return the details of an entry as people read them: of what is empty, only what changed."""
    return {
        name.replace("_", " "): _in_words(value, with_empty=name in ("before", "after"))
        for name, value in details.items()
        if value not in (None, "")
    }


def _in_words(value: Any, *, with_empty: bool) -> str:
    if isinstance(value, Mapping):
        return ", ".join(
            f"{name.replace('_', ' ')} {_in_words(each, with_empty=with_empty)}"
            for name, each in value.items()
            if with_empty or each not in (None, "")
        )
    if isinstance(value, list):
        return "; ".join(_in_words(each, with_empty=with_empty) for each in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value in (None, "") else str(value)


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
