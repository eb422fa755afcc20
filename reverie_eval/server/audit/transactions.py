"""Transactions: each change has an actor, a time and an entry in the audit log.

An action is a function that takes a :class:`Transaction` and a request model, checks, writes, logs,
and returns a report. The API, the pages and the command line only begin a transaction and call it.
"""

import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Self, TypeAlias

from sqlalchemy.orm import Session

from reverie_eval.server.audit.log import AuditLog, logged_columns, row_digest, row_name
from reverie_eval.server.audit.signing import Signer, admit
from reverie_eval.server.settings import Channel
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Base, Person

Clock: TypeAlias = Callable[[], datetime]
"""Returns the current time."""

Actor: TypeAlias = Person | str
"""Who makes a change: a person, or the name of a user of the machine or of a program."""


def utc_now() -> datetime:
    """Return the current time."""
    return datetime.now(UTC)


@dataclass(frozen=True, slots=True)
class Transaction:
    """A change in progress; it is committed with its entries in the audit log, or not at all."""

    session: Session
    acting: Actor
    """Who makes the change, for the audit log."""
    now: datetime
    audit_log: AuditLog
    channels: Mapping[str, Channel] = field(default_factory=dict)
    """How the organiser is notified of it."""

    @property
    def actor(self) -> str:
        """The name of the person or program that makes the change."""
        return self.acting.name if isinstance(self.acting, Person) else self.acting

    def as_actor(self, acting: Actor) -> Self:
        """Return the same transaction with another actor."""
        return replace(self, acting=acting)

    def add(self, row: Base) -> None:
        """Insert a row."""
        self.session.add(row)
        self.session.flush()

    def record(self, action: str, row: Base, subject: Person | str, **details: Any) -> None:
        """Insert a row if it is new, and append an action on it to the audit log.

        ``subject`` is what or who the action is about.

        Persons are logged by their row, so that the log need not change when a person is deleted.
        So ``details`` must not name any person.
        """
        if isinstance(row, Person):
            row.name_salt = secrets.token_hex(16)
        self.add(row)
        values = {name: getattr(row, name) for name in logged_columns(type(row))}
        self.audit_log.append(
            self.session,
            self.now,
            _logged(self.acting),
            action,
            row=row_name(row),
            row_digest=row_digest(values),
            subject=_logged(subject),
            **details,
        )


@dataclass(slots=True)
class Transactions:
    """Begins the transactions of a server, one at a time."""

    database: Database
    audit_log: AuditLog
    clock: Clock
    channels: Mapping[str, Channel] = field(default_factory=dict)
    begins: Callable[[Transaction], None] = lambda _: None
    """Called at the beginning of each transaction, before anything is changed."""

    @property
    def signer(self) -> Signer:
        """Has the signing key in use."""
        return self.audit_log.signer

    @contextmanager
    def begin(self, actor: Actor) -> Iterator[Transaction]:
        """Begin a transaction; it is committed at the end, or rolled back after an error.

        Raises KeyReplacedError if the signing key was replaced.
        """
        with self.database.writing() as session:
            now = self.clock()
            admit(session, self.signer, now)
            transaction = Transaction(session, actor, now, self.audit_log, self.channels)
            self.begins(transaction)
            yield transaction


def difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the values that a change made different, as the details of its entry.

    Those of mappings are compared one by one. Empty if nothing is different.

    >>> difference({"paused": True, "banner": "Hello"}, {"paused": False, "banner": "Hello"})
    {'before': {'paused': True}, 'after': {'paused': False}}
    """
    details = {"before": _only_different(before, after), "after": _only_different(after, before)}
    return details if any(details.values()) else {}


def _only_different(values: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that differ from others, also inside mappings."""
    return {
        name: _only_different(value, others[name]) if isinstance(value, dict) else value
        for name, value in values.items()
        if name not in others or value != others[name]
    }


def _logged(name: Person | str) -> str:
    return row_name(name) if isinstance(name, Person) else name
