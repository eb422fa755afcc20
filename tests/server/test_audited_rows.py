"""Whether the rows of a database are those that its audit log tells of."""

from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import Update, update

from reverie_eval.schemas.organising import NewSnapshot
from reverie_eval.server.audit.rows import mismatches
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.store.tables import (
    AuditEntry,
    Base,
    Correction,
    Grant,
    News,
    Notice,
    Person,
    ReportedResult,
    Review,
    SetSchedule,
    SigningKey,
    StoredSnapshot,
    Submission,
    Token,
)
from tests.support.acting import NOON, ask_to_join, review
from tests.support.entries import report_result
from tests.support.serving import OPEN, ORGANISER, OTHER, OWNER, PEOPLE, PRIVATE, Serving

LATER = NOON + timedelta(days=400)


def do_everything(server: Serving) -> str:
    """Do what the log tells of with values, some of it twice, and return a submission's id."""
    sent: str = server.upload(OWNER, description="It+walks.").json()["submission"]["id"]
    server.upload(OTHER, server.distinct())
    for changed in (
        {"published": True, "shows_episodes": True, "method": {"paper": "https://example.org/p"}},
        {"anonymous_until": LATER.isoformat(), "method": {"paper": None}},
    ):
        assert server.ask(OWNER, "PATCH", f"/submissions/{sent}", json=changed).is_success
    report_result(server, "FAST", success=0.5, spl=0.25)
    number = ask_to_join(server.state.transactions)
    grant = {"team": PEOPLE[OWNER], "split": OPEN, "extra": 2, "reason": "A fire."}
    more = {"expires_at": (NOON + timedelta(days=1)).isoformat()}
    for method, path, content in (
        ("PATCH", "reported/1", {"scores": {"success": 0.75, "spl": None}}),
        ("POST", "grants", grant | more),
        ("PUT", "notice", {"banner": "Hello"}),
        ("POST", "news", {"text": "We moved."}),
        ("PUT", f"schedules/{OPEN}", {"paused": True}),
        ("POST", f"requests/{number}/accept", {}),
        ("PATCH", f"people/{server.person(OTHER).id}", {"name": "Eva", "team": PEOPLE[OWNER]}),
        ("POST", "teams/merge", {"team": PEOPLE[OTHER], "into": PEOPLE[OWNER]}),
    ):
        reply = server.ask(ORGANISER, method, f"/organiser/{path}", json=content)
        assert reply.is_success, (path, reply.text)
    with server.acting() as transaction:
        review(transaction, sent, "verified", "run again")
        server.state.get(Snapshots).take(transaction, NewSnapshot(split=OPEN, title="A month"))
        row = Correction(split=OPEN, board="", signature="s", reason="Targets.", created_at=NOON)
        transaction.record("correction announced", row, OPEN, reason=row.reason)
    return sent


def changes(server: Serving, sent: str) -> Iterator[tuple[str, Update]]:
    """Yield changes of rows, each after what the doctor says about it."""

    def changed(row: str, table: type[Base], **values: Any) -> tuple[str, Update]:
        key = row.partition(":")[2]
        own = table.__table__.primary_key.columns[0]  # type: ignore[attr-defined]
        statement = update(table).where(own == own.type.python_type(key)).values(values)
        return f"{row} was changed after its last entry in the audit log", statement

    person = server.person(OWNER).id
    yield changed(f"person:{person}", Person, role="organiser")
    yield changed("token:1", Token, person_id=person + 1)
    yield changed("token:1", Token, expires_at=LATER)
    yield changed("quota_grant:1", Grant, extra=100, expires_at=LATER)
    yield changed("review:1", Review, reason="run again twice")
    yield changed("news:1", News, text="We moved back.")
    yield changed("notice:1", Notice, banner="Hallo")
    yield changed("schedule:1", SetSchedule, paused=False)
    yield changed("snapshot:1", StoredSnapshot, title="A year")
    yield changed("reported_result:1", ReportedResult, scores={"success": 0.5})
    yield changed("reported_result:1", ReportedResult, scores={"spl": 0.75})
    more = {"success": 0.75, "path_length": 9.5}
    yield changed("reported_result:1", ReportedResult, scores=more)
    yield changed("reported_result:1", ReportedResult, method={"name": "SLOW"})
    yield changed("reported_result:1", ReportedResult, team="Nobody")
    yield changed("correction:1", Correction, reason="None.")
    yield changed(f"submission:{sent}", Submission, anonymous_until=None)
    yield changed(f"submission:{sent}", Submission, shows_episodes=False)
    yield changed(f"submission:{sent}", Submission, sha256="0" * 64)
    yield changed(f"submission:{sent}", Submission, split=PRIVATE)
    with server.state.database.reading() as session:
        method = session.get_one(Submission, sent).method
    for name, value in (
        ("description", "It runs."),
        ("paper", "https://example.org/p"),
        ("human", True),
        ("extra_data", False),
    ):
        other = {**method, name: value}
        yield changed(f"submission:{sent}", Submission, method=other)
    key = f"signing key {server.state.signer.key_id}"
    told = f"{key}: it is in use, but has an end, or a reason for one"
    for ending in ({"valid_until": LATER}, {"revoked_at": LATER}, {"reason": "It leaked."}):
        yield told, update(SigningKey).values(ending)


def test_a_value_that_the_log_does_not_have_is_found(server_on: Serving) -> None:
    sent = do_everything(server_on)
    database = server_on.state.database
    with database.reading() as session:
        assert list(mismatches(session)) == []
    for told, statement in changes(server_on, sent):
        with database.trying() as session:
            session.execute(statement)
            assert list(mismatches(session)) == [told]
    with database.reading() as session:
        assert list(mismatches(session)) == []


def test_a_row_that_a_merge_moved_is_not_moved_back_unseen(server_on: Serving) -> None:
    server_on.upload(OWNER)
    repeat = server_on.upload(OTHER).json()["submission"]["id"]
    person, red = server_on.person(OTHER), PEOPLE[OTHER]
    end = (NOON + timedelta(days=1)).isoformat()
    grant = {"team": red, "split": OPEN, "extra": 2, "reason": "A fire.", "expires_at": end}
    merge = {"team": red, "into": PEOPLE[OWNER]}
    for path, content in (("grants", grant), ("teams/merge", merge)):
        assert server_on.ask(ORGANISER, "POST", f"/organiser/{path}", json=content).is_success
    database = server_on.state.database
    with database.reading() as session:
        assert list(mismatches(session)) == []
    back = {"team_id": person.team_id}
    of_repeat = update(Submission).where(Submission.id == repeat)
    for row, statement in (
        (f"person:{person.id}", update(Person).where(Person.id == person.id).values(back)),
        ("quota_grant:1", update(Grant).values(back)),
        (f"submission:{repeat}", of_repeat.values(back)),
        (f"submission:{repeat}", of_repeat.values(repeat="0")),
    ):
        with database.trying() as session:
            session.execute(statement)
            told = [f"{row} was changed after its last entry in the audit log"]
            assert list(mismatches(session)) == told


@pytest.mark.parametrize(
    "row", [f"person:{10**30}", "person:abc", "person:", "nothing:1", "fingerprint:1", ""]
)
def test_entries_that_were_changed_stop_nothing(row: str, server_on: Serving) -> None:
    person = server_on.person(OWNER).id
    with server_on.state.database.trying() as session:
        is_own = AuditEntry.row == f"person:{person}"
        session.execute(update(AuditEntry).where(is_own).values(row=row))
        session.execute(update(Person).where(Person.id != person).values(role="organiser"))
        gone, without, *changed = mismatches(session)
    assert gone == f"{row}: in the audit log, but no longer in the database"
    assert without == f"person:{person}: in the database, but not in the audit log"
    assert len(changed) == len(PEOPLE) - 2
