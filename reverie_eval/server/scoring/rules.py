"""The rules by which the servers of a database score: each split's protocol, track, ground truth.

A server that starts records its rules in the audit log, unless the last server had the same, and so
does a correction, in the transaction that replaces the results. So each server can tell whether its
own rules are still in force: it would score the same file differently otherwise.
"""

import logging
from collections.abc import Mapping, Sequence
from threading import Lock

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.errors import Problem
from reverie_eval.server.audit.log import RULES, SERVER, last_recorded
from reverie_eval.server.audit.transactions import Transaction, Transactions
from reverie_eval.server.errors import BusyError
from reverie_eval.server.scoring.boards import Boards, load_boards, rules_of
from reverie_eval.server.scoring.contexts import SECONDS_TO_RETRY
from reverie_eval.server.settings import Settings, SettingsError
from reverie_eval.server.store.tables import AuditEntry

_LOGGER = logging.getLogger("reverie_eval.server")


def record_rules(transactions: Transactions, rules: Mapping[str, str]) -> None:
    """Record the rules of a server that starts, if those of the last one were different.

    Raises SettingsError if a correction has replaced its ground truth: it would undo the correction
    for uploads to come.
    """
    with transactions.database.reading() as session:
        if LastRules().read(session) == rules:
            return
    with transactions.begin(SERVER) as transaction:
        _check_not_replaced(transaction.session, rules)
        append_rules(transaction, rules)


def _check_not_replaced(session: Session, rules: Mapping[str, str]) -> None:
    recorded = select(AuditEntry.details).where(AuditEntry.action == RULES).order_by(AuditEntry.id)
    replaced: set[tuple[str, str]] = set()
    for details in session.scalars(recorded):
        replaced |= details.get("replaced", {}).items()
        replaced -= details["splits"].items()
    problems = [
        Problem(
            "replaced-ground-truth",
            f"splits.{label.partition(',')[0]}.bundle",
            "a correction has replaced this ground truth; put the corrected bundle here, or make "
            "this one the correct one again: `reverie-eval server rescore --bundle`",
        )
        for label, of_board in rules.items()
        if (label, of_board) in replaced
    ]
    if problems:
        raise SettingsError(problems)


def append_rules(
    transaction: Transaction, rules: Mapping[str, str], replaced: Mapping[str, str] | None = None
) -> None:
    """Record that these rules are in force from now on, and which ones a correction replaced."""
    transaction.audit_log.append(
        transaction.session,
        transaction.now,
        SERVER,
        RULES,
        row=SERVER,
        row_digest="",
        subject=SERVER,
        splits=dict(rules),
        **({"replaced": dict(replaced)} if replaced else {}),
    )


class LastRules:
    """The rules that were recorded last; only new entries of the audit log are read."""

    def __init__(self) -> None:
        self.rules: Mapping[str, str] = {}
        """By leaderboard; empty if no server has recorded any."""
        self._known_until = 0

    def read(self, session: Session) -> Mapping[str, str]:
        """Return the rules as they are recorded now; one statement unless there are new ones."""
        _, last, found = last_recorded(session, self._known_until)
        if found > self._known_until:
            self.rules = session.get_one(AuditEntry, found).details["splits"]
        self._known_until = last
        return self.rules


def different(rules: Mapping[str, str], last: Mapping[str, str]) -> Sequence[str]:
    """Return the leaderboards whose rules differ from those that were recorded last."""
    names = {**rules, **last} if last else {}
    return [name for name in names if rules.get(name) != last.get(name)]


class RulesInForce:
    """The rules of a running server, which follow a correction that another process makes."""

    def __init__(self, boards: Boards, settings: Settings) -> None:
        self._boards = boards
        self._settings = settings
        self._last = LastRules()
        self._without_files: Mapping[str, str] = {}
        """Rules whose ground truth this server does not have."""
        self._lock = Lock()

    @property
    def recorded(self) -> Mapping[str, str]:
        """The rules in force, by leaderboard, as they were last looked at."""
        return self._last.rules

    def follow(self, session: Session) -> Sequence[str]:
        """Load the ground truth again if it was replaced; return what still differs.

        Leaderboards do if another server of the database, with files of its own, has other rules.
        """
        with self._lock:
            last = self._last.read(session)
            splits = different(rules_of(self._boards), last)
            if splits and last != self._without_files:
                self._load(last)
                splits = different(rules_of(self._boards), last)
            return splits

    def check(self, session: Session, split: str) -> None:
        """Follow, before something is scored or stored.

        Raises BusyError if the split has to be scored by rules that this server does not have.
        """
        differing = self.follow(session)
        own = {board.label for board in self._boards[split].all}
        if own.intersection(differing) & self._last.rules.keys():
            raise BusyError(SECONDS_TO_RETRY, f"the ground truth of {split} was just corrected")

    def _load(self, last: Mapping[str, str]) -> None:
        try:
            loaded = load_boards(self._settings, last)
        except SettingsError:
            _LOGGER.exception("the corrected ground truth cannot be loaded")
            loaded = {}
        if different(rules_of(loaded), last):
            self._without_files = last
        else:
            self._boards.replace(loaded)
            _LOGGER.info("the corrected ground truth was loaded")
