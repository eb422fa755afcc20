"""Changing what the server keeps: in one transaction, as somebody, at some time, on record.

Whatever can be done is a function that takes a :class:`Transaction` and what is asked for, checks,
writes, records, and returns a report. The API, the pages and the command line begin the transaction
and call it; nothing else is done in three places.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Self

from sqlalchemy.orm import Session

from reverie_eval.server.service.audit import AuditLog
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Base


@dataclass(frozen=True, slots=True)
class Transaction:
    """A change in progress; it is kept as a whole, with its entries of the audit log, or not."""

    session: Session
    actor: str
    """Who makes it, for the audit log."""
    now: datetime
    audit_log: AuditLog

    def as_actor(self, actor: str) -> Self:
        """Return the same transaction, continued by somebody else."""
        return replace(self, actor=actor)

    def add(self, row: Base) -> None:
        """Insert a row."""
        self.session.add(row)
        self.session.flush()

    def record(self, action: str, row: Base, subject: str, **details: Any) -> None:
        """Append to the audit log what was done to a row, which people know as ``subject``."""
        self.session.flush()
        self.audit_log.append(
            self.session, self.now, self.actor, action, row=row, subject=subject, **details
        )


@dataclass(frozen=True, slots=True)
class Transactions:
    """Begins the transactions of a server, one at a time."""

    database: Database
    audit_log: AuditLog
    clock: Callable[[], datetime]

    @contextmanager
    def begin(self, actor: str) -> Iterator[Transaction]:
        """Begin a transaction of somebody's; it is committed at the end, or leaves no trace."""
        with self.database.writing() as session:
            yield Transaction(session, actor, self.clock(), self.audit_log)
