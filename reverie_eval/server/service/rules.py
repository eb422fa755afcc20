"""The rules by which the servers of a database score: each split's protocol, track, ground truth.

A server that starts records its rules in the audit log, unless the last server had the same. So
each server can tell whether another one has since started with other rules, with another bundle for
example: it would score the same file differently.
"""

from collections.abc import Mapping, Sequence

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from reverie_eval.server.service.audit import RULES, SERVER
from reverie_eval.server.service.boards import Board, leaderboards, without_version
from reverie_eval.server.service.transactions import Transactions
from reverie_eval.server.store.tables import AuditEntry


def rules_of(boards: Mapping[str, Board]) -> Mapping[str, str]:
    """Return what scores depend on, by leaderboard; a protocol is that of every version."""
    return {board.label: without_version(board.signature) for board in leaderboards(boards)}


def record_rules(transactions: Transactions, rules: Mapping[str, str]) -> None:
    """Record the rules of a server that starts, if those of the last one were different."""
    with transactions.database.reading() as session:
        if LastRules().read(session) == rules:
            return
    with transactions.begin(SERVER) as transaction:
        transaction.audit_log.append(
            transaction.session,
            transaction.now,
            transaction.actor,
            RULES,
            row=SERVER,
            subject=SERVER,
            splits=dict(rules),
        )


class LastRules:
    """The rules of the server that started last; only new entries of the audit log are read."""

    def __init__(self) -> None:
        self.rules: Mapping[str, str] = {}
        """By leaderboard; empty if no server has recorded any."""
        self._known_until = 0

    def read(self, session: Session) -> Mapping[str, str]:
        """Return the rules as they are recorded now."""
        chosen = select(AuditEntry).where(
            AuditEntry.action == RULES, AuditEntry.id > self._known_until
        )
        entry = session.scalars(chosen.order_by(AuditEntry.id.desc()).limit(1)).first()
        if entry is not None:
            self.rules = entry.details["splits"]
        self._known_until = session.scalar(select(func.max(AuditEntry.id))) or 0
        return self.rules


def different(rules: Mapping[str, str], last: Mapping[str, str]) -> Sequence[str]:
    """Return the leaderboards whose rules differ from those of the server that started last."""
    names = {**rules, **last} if last else {}
    return [name for name in names if rules.get(name) != last.get(name)]
