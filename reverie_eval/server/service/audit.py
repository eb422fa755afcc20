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

The chain does not show that entries were removed at its end. :func:`mismatches` does, as long as
their rows are there: every lasting action in the log must be visible in a row of the database, by
its time, and vice versa. Of other values of rows, only the names of teams and persons and the ends
of signing keys are compared with the log.
"""

import hashlib
import hmac
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain
from typing import Any, NamedTuple, TypeAlias, get_args

import msgspec
from sqlalchemy import (
    ColumnElement,
    Select,
    SQLColumnExpression,
    String,
    case,
    cast,
    except_,
    func,
    inspect,
    literal,
    select,
    union_all,
)
from sqlalchemy.orm import InstrumentedAttribute, Session

from reverie_eval.receipts import key_id_of
from reverie_eval.schemas.organising import AuditReport, TokenKind
from reverie_eval.schemas.service import Verdict
from reverie_eval.server.service.keys import all_keys, audit_key_of, audit_keys
from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.service.receipts import Signer
from reverie_eval.server.store.database import AT_ONCE
from reverie_eval.server.store.tables import (
    AuditEntry,
    Base,
    Correction,
    Decision,
    Grant,
    JoinRequest,
    News,
    Notice,
    Person,
    ReportedResult,
    Review,
    SetSchedule,
    SigningKey,
    StoredSnapshot,
    Submission,
    Team,
    Token,
)

_BEFORE_THE_FIRST = "0" * 64
_SUBMITTED = "submitted"
_REPLACED = "signing key replaced"
_ENDS_OF_KEYS = (_REPLACED, "signing key revoked")
RULES = "rules recorded"
"""The action of a server that starts with other rules than the last one."""
INSPECTED = "inspected"
"""The action of an organiser who reads the values of a submission's episodes."""
_REPEATABLE = frozenset({"changed", "token revoked", "scored again", "signing key revoked"})
"""Actions that rows show, but only the last if there were several."""
_NAMING = ("person added", "person changed", "person deleted")
"""Actions that give a person a name."""
_PERSON = re.compile(r"person:([0-9]{1,9})")
_SWITCHES = {
    ("withdrawn", True): "withdrawn",
    ("withdrawn", False): "restored",
    ("published", True): "published",
    ("published", False): "unpublished",
    ("shows_episodes", True): "episodes shown to everyone",
    ("shows_episodes", False): "episodes shown to the team only",
}


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
        return _name_digest(person, self._key)

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
        replacements = entries(session, AuditEntry.action == _REPLACED)
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


def names_in(session: Session, entries: Iterable[AuditEntry]) -> Mapping[str, str]:
    """Return the current names of the persons that entries refer to, by row."""
    found = {name for entry in entries for name in (entry.actor, entry.subject)}
    numbers = {int(match[1]) for name in found if (match := _PERSON.fullmatch(name))}
    people = session.execute(select(Person.id, Person.name).where(Person.id.in_(numbers)))
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
    what: str
    why: str
    """Empty if the action needs no reason."""


def history(session: Session, submission_id: str) -> Sequence[Event]:
    """Return what happened to a submission, the earliest first.

    Its team sees this, so it does not say that an organiser inspected it.
    """
    own = AuditEntry.subject == submission_id
    found = entries(session, own, AuditEntry.action != INSPECTED)
    names = names_in(session, found)
    return [_event(entry, names.get(entry.actor, entry.actor)) for entry in found]


def _event(entry: AuditEntry, actor: str) -> Event:
    changes: Sequence[str] = ()
    if entry.action == "changed":  # version 0.1.0 recorded the new values alone
        changes = list(_changes(entry.details.get("after", entry.details)))
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


class Action(NamedTuple):
    """An action on a row of the database."""

    name: str
    row: str
    """The row as entries refer to it: ``team:3``."""
    at: datetime | None
    """None for `submitted`, whose entry is written some time after the submission arrived."""

    def __str__(self) -> str:
        when = "" if self.at is None else f", {self.at:%Y-%m-%d %H:%M:%S}"
        return f"{self.name} ({self.row}{when})"


_Actions: TypeAlias = Select[Any, Any, Any]
"""Selects name, row and time of actions."""


def mismatches(session: Session) -> Iterator[str]:
    """Describe every disagreement between the audit log and the rows of the database."""
    # The database compares them: there may be millions.
    visible = union_all(*(shown.actions for shown in _VISIBLE)).subquery().select()
    logged = select(AuditEntry.action, AuditEntry.row, _time(AuditEntry.action, AuditEntry.at))
    lasting = logged.where(AuditEntry.action.in_(_LASTING))
    for action in _difference(session, lasting, visible):
        yield f"{action}: logged, but no longer in the database"
    for action in _difference(session, visible, logged):
        yield f"{action}: in the database, but not logged"
    names = dict(_recorded_names(session))
    for team in session.scalars(select(Team)):
        recorded = names.get(row_name(team), team.name)
        if recorded != team.name:
            yield f"{row_name(team)} is called {team.name!r}; the audit log calls it {recorded!r}"
    yield from _mismatched_keys(session)


def _difference(session: Session, some: _Actions, others: _Actions) -> Sequence[Action]:
    """Return the actions that only the first statement selects."""
    rows = session.execute(except_(some, others))
    return sorted((Action(*row) for row in rows), key=str)


def swapped_names(session: Session, audit_log: AuditLog) -> Iterator[str]:
    """Describe every person whose name is not the one that the audit log records.

    Names that were recorded with a lost key cannot be checked.
    """
    keys = audit_keys(session, audit_log.signer)
    named = entries(session, AuditEntry.action.in_(_NAMING))
    recorded = {
        entry.row: (entry.key_id, entry.details["name_digest"])
        for entry in named
        if "name_digest" in entry.details
    }
    for person in session.scalars(select(Person)):
        key_id, digest = recorded.get(row_name(person), ("", ""))
        key = keys.get(key_id)
        if key is not None and _name_digest(person, key) != digest:
            yield f"{row_name(person)} is called {person.name!r}; the audit log has another name"


def _name_digest(person: Person, key: bytes) -> str:
    return _keyed_digest(key, (row_name(person), person.name))[:16]


def _mismatched_keys(session: Session) -> Iterator[str]:
    """Describe every signing key that disagrees with its name or the audit log."""
    keys = all_keys(session)
    ends: dict[str, Mapping[str, Any]] = {}
    for entry in entries(session, AuditEntry.action.in_(_ENDS_OF_KEYS)):
        ends[entry.subject] = {**ends.get(entry.subject, {}), **entry.details}
    lost = [place for place, key in enumerate(keys) if ends.get(key.key_id, {}).get("lost")]
    for place, key in enumerate(keys):
        end, name = ends.get(key.key_id, {}), f"signing key {key.key_id}"
        until = None if key.valid_until is None else key.valid_until.isoformat()
        following = keys[place + 1].key_id if place + 1 < len(keys) else None
        if key_id_of(key.public_key) != key.key_id:
            yield f"{name}: its public key was changed"
        if (end.get("by"), end.get("until")) != (following, until):
            yield f"{name}: its end or its successor differs from the log"
        if following and key.audit_key is None and place > max(lost, default=-1):
            yield f"{name}: the key of its audit entries was removed"


def all_names_of_teams(session: Session) -> Mapping[str, frozenset[str]]:
    """Return all names that each team and those merged into it have had, by its current name."""
    names = defaultdict(set)
    for row, name in _recorded_names(session):
        names[row].add(name)
    # In the order in which they were merged, so that names pass through every team on their way.
    teams = session.scalars(select(Team).order_by(Team.merged_at)).all()
    for team in teams:
        names[row_name(team)].add(team.name)
    for team in teams:
        if team.merged_into is not None:
            names[row_name(team.merged_into)] |= names[row_name(team)]
    return {team.name: frozenset(names[row_name(team)]) for team in teams}


def _recorded_names(session: Session) -> Iterator[tuple[str, str]]:
    """Yield each recorded name of a team, with its row, the earliest first."""
    for entry in entries(session, AuditEntry.action.in_(["team added", "team renamed"])):
        yield entry.row, entry.details.get("after", entry.subject)


def _time(action: SQLColumnExpression[Any], at: SQLColumnExpression[Any]) -> ColumnElement[Any]:
    """Return when an action happened; None for one that is logged some time after it happened."""
    return case((action != _SUBMITTED, at))


class _Shown(NamedTuple):
    """Actions that the rows of a table show."""

    names: Collection[str]
    actions: _Actions


def _shown(action: str, at: InstrumentedAttribute[Any], *where: ColumnElement[bool]) -> _Shown:
    """Select an action that the rows of a table show, as entries refer to it, by its time."""
    return _shown_as(literal(action), [action], at, *where)


def _shown_as(
    name: SQLColumnExpression[Any],
    names: Collection[str],
    at: InstrumentedAttribute[Any],
    *where: ColumnElement[bool],
) -> _Shown:
    """Select actions whose names the rows of a table have, one of these."""
    table = at.class_
    row = literal(f"{table.__tablename__}:").concat(cast(table.id, String))
    return _Shown(names, select(name, row, _time(name, at)).where(at.is_not(None), *where))


_CREATED = " token created"
_VISIBLE: Sequence[_Shown] = (
    _shown("team added", Team.created_at),
    _shown("team merged", Team.merged_at),
    _shown("person added", Person.created_at),
    _shown("person deleted", Person.deleted_at),
    _shown_as(JoinRequest.decision, get_args(Decision), JoinRequest.decided_at),
    _shown_as(
        Token.kind.concat(_CREATED),
        [f"{kind}{_CREATED}" for kind in get_args(TokenKind)],
        Token.created_at,
    ),
    # Using an invitation is not logged; creating the token that it was exchanged for is.
    _shown("token revoked", Token.revoked_at, Token.kind == "access"),
    _shown(_SUBMITTED, Submission.received_at),
    _shown("changed", Submission.published_at),
    _shown("changed", Submission.withdrawn_at),
    _shown("upload deleted", Submission.upload_deleted_at),
    _shown("scored again", Submission.rescored_at),
    _shown("granted", Grant.created_at),
    _shown_as(Review.verdict, get_args(Verdict), Review.created_at),
    _shown("review lifted", Review.lifted_at),
    _shown("reported result added", ReportedResult.created_at),
    _shown("reported result removed", ReportedResult.removed_at),
    _shown(_REPLACED, SigningKey.replaced_at),
    _shown("signing key revoked", SigningKey.revoked_at),
    _shown("news added", News.created_at),
    _shown("news removed", News.removed_at),
    _shown("notice posted", Notice.created_at),
    _shown("schedule set", SetSchedule.created_at),
    _shown("snapshot taken", StoredSnapshot.created_at),
    _shown("correction announced", Correction.created_at),
)
"""The actions that the rows of the database show. Others need not be named here."""
_LASTING = frozenset(chain.from_iterable(shown.names for shown in _VISIBLE)) - _REPEATABLE
"""Actions that the rows of the database show for ever."""
