"""The rules that a server records when it starts, and how others notice that they changed."""

from collections.abc import Mapping

import pytest

from reverie_eval.server.audit.log import RULES, entries
from reverie_eval.server.audit.transactions import Transactions
from reverie_eval.server.scoring.boards import rules_of
from reverie_eval.server.scoring.rules import LastRules, different, record_rules
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import AuditEntry
from tests.support.acting import AUDIT_LOG, NOON
from tests.support.serving import OPEN, Serving


def start(database: Database, rules: Mapping[str, str]) -> None:
    """Do what a server does that starts with these rules."""
    record_rules(Transactions(database, AUDIT_LOG, lambda: NOON), rules)


def test_rules_are_recorded_by_a_server_that_starts_with_others(sqlite: Database) -> None:
    for rules in ("one", "one", "other", "other"):
        start(sqlite, {OPEN: rules})
    with sqlite.reading() as session:
        recorded = [entry for entry in entries(session) if entry.action == RULES]
    assert [(entry.actor, entry.row, entry.subject, entry.details) for entry in recorded] == [
        ("server", "server", "server", {"splits": {OPEN: "one"}}),
        ("server", "server", "server", {"splits": {OPEN: "other"}}),
    ]


def test_only_new_entries_are_read_for_the_last_rules(sqlite: Database) -> None:
    last = LastRules()

    def read() -> Mapping[str, str]:
        with sqlite.reading() as session:
            return last.read(session)

    assert read() == {}
    start(sqlite, {OPEN: "one"})
    assert read() == {OPEN: "one"}
    with sqlite.writing() as session:
        session.query(AuditEntry).filter_by(action=RULES).one().details = {"splits": {}}
    assert read() == {OPEN: "one"}
    start(sqlite, {OPEN: "other"})
    assert read() == {OPEN: "other"}


def test_rules_are_signatures_without_the_version(server: Serving) -> None:
    rules = rules_of(server.state.boards)
    assert sorted(rules) == ["test", "val_seen", "val_unseen"]
    start, _, number = rules[OPEN].rpartition("|n:")
    assert start.startswith("split:val_unseen|protocol:official-v1|data:")
    assert number == "84"


@pytest.mark.parametrize(
    ("last", "expected"),
    [
        pytest.param({}, [], id="no server has recorded any"),
        pytest.param({"a": "1", "b": "2"}, [], id="the same"),
        pytest.param({"a": "1", "b": "3"}, ["b"], id="another protocol"),
        pytest.param({"a": "1"}, ["b"], id="a new leaderboard"),
        pytest.param({"a": "1", "b": "2", "c": "3"}, ["c"], id="a leaderboard less"),
    ],
)
def test_leaderboards_with_other_rules(last: Mapping[str, str], expected: list[str]) -> None:
    assert different({"a": "1", "b": "2"}, last) == expected
