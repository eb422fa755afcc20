"""The audit log: what a digest is of, how entries are read, and what the rows must show."""

import hashlib
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import select, text

from reverie_eval.receipts import public_key_of
from reverie_eval.schemas.organising import KeyRevocation, NewTeam
from reverie_eval.server.accounts.people import person_named, rename_team, team_named
from reverie_eval.server.audit.log import (
    INSPECTED,
    AuditLog,
    audit_reports,
    details_in_words,
    entries,
    entry_digest,
    history,
    list_entries,
    list_reports,
)
from reverie_eval.server.audit.rows import mismatches
from reverie_eval.server.audit.signing import Signer
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.operations.keys import replace_key, revoke_key
from reverie_eval.server.store.database import Database, count_rows
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import AuditEntry, News, Person, SigningKey, Team
from tests.support.acting import AUDIT_LOG, NOON, acting, add_person, add_team

NEXT = Signer(Ed25519PrivateKey.from_private_bytes(b"\1" * 32), "tests")
LAST = Signer(Ed25519PrivateKey.from_private_bytes(b"\2" * 32), "tests")
"""The signing keys after the first."""
SUBMISSION = "0123456789abcdef"
NO_ENTRY_BEFORE = "0" * 64


@pytest.fixture
def database(sqlite: Database) -> Database:
    """Return a database in which a program has added a team with a person."""
    with acting(sqlite) as transaction:
        add_team(transaction, "Blue")
        add_person(transaction, "Blue", "Ada")
    return sqlite


def sha256(message: str) -> str:
    return hashlib.sha256(message.encode()).hexdigest()


def test_a_digest_is_of_all_of_an_entry_and_the_digest_before(database: Database) -> None:
    with acting(database) as transaction:
        person = person_named(transaction.session, "Ada")
        transaction.as_actor(person).record("granted", person.team, person, extra=1, because="Ä")
        *_, added, last = entries(transaction.session)
        name_key = person.team.name_key
    row = sha256(
        '[{"created_at":"2026-03-02T12:00:00.000000+00:00","id":1,"name":"Blue",'
        f'"name_key":"{name_key}"}}]'
    )
    assert last.digest == sha256(
        '["2026-03-02T12:00:00.000000+00:00","person:1","granted","team:1","person:1",'
        f'"{row}",{{"because":"Ä","extra":1}},"{added.digest}"]'
    )
    key = public_key_of(AUDIT_LOG.signer.public_pem)
    key.verify(bytes.fromhex(last.seal), last.digest.encode())


def test_the_first_entry_and_the_digest_of_a_person(database: Database) -> None:
    with database.reading() as session:
        first, named = entries(session)
        salt = person_named(session, "Ada").name_salt
    assert first.previous == NO_ENTRY_BEFORE
    assert named.row_digest == sha256(
        '[{"created_at":"2026-03-02T12:00:00.000000+00:00","id":1,"name":"Ada",'
        f'"name_salt":"{salt}","role":"participant","team_id":1}}]'
    )
    assert len(salt) == 32


def test_entries_are_counted(sqlite: Database) -> None:
    with sqlite.writing() as session:
        assert count_rows(session, AuditEntry) == 0
    with acting(sqlite) as transaction:
        add_team(transaction, "Blue")
        add_team(transaction, "Red")
        assert count_rows(transaction.session, AuditEntry) == 2


def test_entries_are_listed_by_actor_and_subject(database: Database) -> None:
    with acting(database) as transaction:
        ada = person_named(transaction.session, "Ada")
        by_her, by_program = transaction.as_actor(ada), transaction.as_actor("Ada")
        add_team(by_her, "Green")
        add_team(by_program, "Lime")
        add_person(by_program, "Lime", "Emil")

        def found(**chosen: Any) -> list[int]:
            return [entry.id for entry in list_entries(transaction.session, Page(), **chosen).rows]

        assert found() == [1, 2, 3, 4, 5]
        assert found(newest_first=True) == [5, 4, 3, 2, 1]
        assert found(actor="Ada") == [3, 4, 5]
        assert found(subject="Ada") == [2]
        assert found(subject="Green") == [3]
        assert found(actor="Ada", subject="Emil") == [5]
        assert found(actor="Emil") == []


def test_reports_name_persons(database: Database) -> None:
    with acting(database) as transaction:
        ada = person_named(transaction.session, "Ada")
        transaction.as_actor(ada).record("did", ada.team, "thing", extra=1)
        ada.name = "Augusta"
        first, named, did = audit_reports(transaction.session, entries(transaction.session))
        listed = list_reports(transaction.session, Page(2))
        assert (listed.rows, listed.next_cursor) == ([first, named], "2")
        stored = transaction.session.get_one(AuditEntry, 3)
    assert did.model_dump() == {
        "id": 3,
        "at": NOON,
        "actor": "Augusta",
        "actor_row": "person:1",
        "action": "did",
        "subject": "thing",
        "row": "team:1",
        "details": {"extra": 1},
        "previous": named.digest,
        "digest": stored.digest,
    }
    assert (first.actor, first.actor_row, first.subject) == ("test", "", "Blue")
    assert named.subject == "Augusta"


EVENTS: list[tuple[str, dict[str, Any], str, str]] = [
    ("submitted", {}, "received and scored", ""),
    ("changed", {"after": {"published": True}}, "published", ""),
    ("changed", {"after": {"published": False}}, "unpublished", ""),
    ("changed", {"after": {"withdrawn": True}}, "withdrawn", ""),
    ("changed", {"after": {"withdrawn": False, "published": True}}, "restored; published", ""),
    ("changed", {"after": {"shows_episodes": True}}, "episodes shown to everyone", ""),
    ("changed", {"after": {"shows_episodes": False}}, "episodes shown to the team only", ""),
    (
        "changed",
        {"after": {"anonymous_until": "2026-06-01T00:00:00Z"}},
        "team hidden until 2026-06-01",
        "",
    ),
    ("changed", {"after": {"anonymous_until": None}}, "team named", ""),
    (
        "changed",
        {"after": {"method": {"name": "x", "paper_url": ""}}},
        "edited: name, paper url",
        "",
    ),
    ("changed", {"after": {"method": {}}}, "changed", ""),
    (
        "changed",
        {"before": {"published": False}, "after": {"published": True}},
        "published",
        "",
    ),
    (
        "changed",
        {
            "before": {"withdrawn": True, "anonymous_until": "2026-06-01T00:00:00Z"},
            "after": {"withdrawn": False, "anonymous_until": None},
        },
        "restored; team named",
        "",
    ),
    ("verified", {"published": True, "reason": "we ran it"}, "verified", "we ran it"),
    ("review lifted", {"verdict": "baseline"}, "no longer baseline", ""),
    ("review lifted", {}, "no longer reviewed", ""),
]
"""Action, details, and what the history of a submission says of it, and why."""


def test_the_history_of_a_submission_words_every_action(database: Database) -> None:
    with acting(database) as transaction:
        ada = person_named(transaction.session, "Ada")
        for action, details, _, _ in EVENTS:
            transaction.record(action, ada.team, SUBMISSION, **details)
        transaction.record(INSPECTED, ada.team, SUBMISSION)
        transaction.record("withdrawn", ada.team, "another")
        transaction.as_actor(ada).record("withdrawn", ada.team, SUBMISSION)
        *events, last = history(transaction.session, SUBMISSION, "Example Lab")
        assert list(AUDIT_LOG.broken_links(transaction.session)) == []
    assert [(event.what, event.why) for event in events] == [each[2:] for each in EVENTS]
    assert {(event.at, event.actor) for event in events} == {(NOON, "Example Lab")}
    assert (last.actor, last.what) == ("Ada", "withdrawn")


def test_changed_entries_are_named(database: Database) -> None:
    with acting(database) as transaction:
        found = entries(transaction.session)
        assert AUDIT_LOG.altered(transaction.session, found) == []
        found[1].subject = "person:2"
        assert AUDIT_LOG.altered(transaction.session, found) == [2]
        found[0].seal = found[1].seal
        assert AUDIT_LOG.altered(transaction.session, found) == [1, 2]
        found[0].seal = "none"
        assert AUDIT_LOG.altered(transaction.session, found) == [1, 2]


@pytest.mark.parametrize("is_lost", [False, True], ids=["replaced", "lost"])
def test_entries_are_checked_when_their_key_is_gone(is_lost: bool, database: Database) -> None:  # noqa: FBT001
    log = AuditLog(NEXT)
    with acting(database) as transaction:
        replace_key(transaction, NEXT, "a fire", is_lost=is_lost)
        session = transaction.session
        replace_key(replace(transaction, audit_log=log), LAST, "the yearly change")
        last = AuditLog(LAST)
        assert not [*last.broken_links(session), *mismatches(session)]
        first, *_, replaced = entries(session)
        person_named(session, "Ada").name = "Eve"
        assert list(mismatches(session)) == [
            "person:1 was changed after its last entry in the audit log"
        ]
        first.subject = "Azure"
        assert list(last.broken_links(session)) == [1]
        replaced.actor = "Eve"
        assert list(last.broken_links(session)) == [1, 2, 3, 4]  # it alone names their keys


def test_who_has_no_key_or_an_old_one_adds_nothing(database: Database) -> None:
    """They can write to the database, and add a key of their own, or what names one."""
    log = AuditLog(NEXT)
    with acting(database) as transaction:
        session = transaction.session
        replace_key(transaction, NEXT, "the yearly change")
        session.add(
            SigningKey(key_id=LAST.key_id, public_key=LAST.public_pem, valid_from=NOON, reason="")
        )
        blue = team_named(session, "Blue")
        for forger in (AUDIT_LOG, AuditLog(LAST)):
            forged = replace(transaction, audit_log=forger)
            forged.record("granted", blue, "Blue", extra=1)
            forged.record(
                "signing key replaced", blue, "Blue", public_key=LAST.public_pem, lost=True
            )
        assert list(log.broken_links(session)) == [4, 5, 6, 7]


# What somebody without a key does to the log of three keys, and where the chain is broken then.
TAMPERINGS = [
    pytest.param("UPDATE audit SET actor = 'Eve' WHERE id = 2", [2], id="actor"),
    pytest.param("UPDATE audit SET action = 'x' WHERE id = 2", [2], id="action"),
    pytest.param("""UPDATE audit SET details = '{"a": 9}' WHERE id = 4""", [4], id="details"),
    pytest.param("UPDATE audit SET at = '2026-03-03 12:00:00.000000' WHERE id = 1", [1], id="time"),
    pytest.param("UPDATE audit SET digest = upper(digest) WHERE id = 4", [4, 5], id="digest"),
    pytest.param("DELETE FROM audit WHERE id = 2", [3], id="an entry less"),
    pytest.param("DELETE FROM audit WHERE id = 1", [2], id="the first less"),
    pytest.param(
        "UPDATE audit SET subject = x'69b71d79f821' WHERE id = 4", [4], id="bytes of base64"
    ),
    pytest.param("UPDATE audit SET seal = x'00' WHERE id = 4", [4], id="bytes for a seal"),
    pytest.param("UPDATE audit SET digest = x'00' WHERE id = 6", [6], id="bytes for a digest"),
    pytest.param(
        """UPDATE audit SET details = '{"a": "\\ud800"}' WHERE id = 4""", [4], id="no text"
    ),
    pytest.param("UPDATE audit SET details = 'null' WHERE id = 4", [4], id="no details"),
    pytest.param("UPDATE audit SET id = -1, actor = 'Eve' WHERE id = 1", [-1], id="no number"),
    pytest.param("UPDATE audit SET id = -id WHERE id IN (1, 2)", [-2, -1, 3], id="another order"),
    pytest.param("UPDATE audit SET id = 9 WHERE id = 4", [5, 9], id="a later place"),
    pytest.param(
        "INSERT INTO audit SELECT 7, at, actor, action, row, row_digest, subject, details, "
        "previous, digest || ' ', seal FROM audit WHERE id = 6",
        [7],
        id="the last again",
    ),
    pytest.param(
        "UPDATE audit SET details = json_set(details, '$.public_key', (SELECT public_key FROM "
        "signing_key WHERE id = 3)) WHERE id = 3",
        [1, 2, 3],
        id="another key before",
    ),
    pytest.param("DELETE FROM audit WHERE id = 3", [1, 2, 4], id="no end of a key"),
    pytest.param("DELETE FROM audit WHERE id >= 3", [1, 2], id="no later key"),
    pytest.param("DELETE FROM audit WHERE id >= 1", [], id="no entry"),
    pytest.param("DELETE FROM signing_key WHERE id < 3", [], id="no earlier key"),
]


@pytest.mark.parametrize(("statement", "broken"), TAMPERINGS)
def test_who_has_no_key_changes_nothing_unnoticed(
    statement: str, broken: list[int], database: Database
) -> None:
    with acting(database) as transaction:
        add_later_entries(transaction)
        transaction.session.execute(text(statement))
        transaction.session.expire_all()
        assert list(AuditLog(LAST).broken_links(transaction.session)) == broken
        assert broken or any(mismatches(transaction.session))


@pytest.mark.parametrize(
    ("old", "own", "next_link"),
    [
        pytest.param(AUDIT_LOG.signer, [1, 2], 3, id="the first key"),
        pytest.param(NEXT, [3, 4], 5, id="the second key"),
    ],
)
def test_who_has_an_old_key_cannot_rewrite_its_time(
    old: Signer, own: list[int], next_link: int, database: Database
) -> None:
    with acting(database) as transaction:
        add_later_entries(transaction)
        session = transaction.session
        for entry in entries(session, AuditEntry.id.in_(own)):
            entry.actor = "Eve"
            earlier = session.get(AuditEntry, entry.id - 1)
            entry.previous = earlier.digest if earlier else NO_ENTRY_BEFORE
            entry.digest = entry_digest(entry)
            entry.seal = old.seal(entry.digest)
        assert list(AuditLog(LAST).broken_links(session)) == [next_link]


def add_later_entries(transaction: Transaction) -> None:
    """Add the entries 3 and 4 of the second key, 5 and 6 of the third."""
    for key in (NEXT, LAST):
        replace_key(transaction, key, "the yearly change")
        transaction = replace(transaction, audit_log=AuditLog(key))
        transaction.record("did", team_named(transaction.session, "Blue"), "abcdefgh")


def test_an_action_that_no_row_shows_needs_no_row(database: Database) -> None:
    with acting(database) as transaction:
        blue = team_named(transaction.session, "Blue")
        transaction.record("website set", blue, "Blue", before="", after="https://blue.example")
        assert list(mismatches(transaction.session)) == []


def test_a_name_that_the_log_does_not_have_is_found(database: Database) -> None:
    with acting(database) as transaction:
        session = transaction.session
        assert list(mismatches(session)) == []
        person_named(session, "Ada").name = "Eve"
        rename_team(transaction, "Blue", NewTeam(name="Azure"))
        forged = Team(name="Lime", created_at=NOON)
        session.add(Person(team=forged, name="Eve", role="organiser", created_at=NOON))
        session.flush()
        team_named(session, "Azure").name = "Blue"
        session.flush()
        assert list(mismatches(session)) == [
            "person:2: in the database, but not in the audit log",
            "team:2: in the database, but not in the audit log",
            "person:1 was changed after its last entry in the audit log",
            "team:1 was changed after its last entry in the audit log",
        ]


def test_what_the_log_and_the_rows_do_not_share_is_listed(database: Database) -> None:
    with acting(database) as transaction:
        session = transaction.session
        team = team_named(session, "Blue")
        assert list(mismatches(session)) == []
        transaction.record("granted", team, "Blue")
        session.add(News(text="Forged", created_at=NOON))
        session.delete(session.scalars(select(Person)).one())
        session.flush()
        assert list(mismatches(session)) == [
            "person:1: in the audit log, but no longer in the database",
            "news:1: in the database, but not in the audit log",
        ]


def test_keys_that_are_not_as_the_log_says_are_named(database: Database) -> None:
    with acting(database) as transaction:
        session = transaction.session
        replace_key(transaction, NEXT, "the yearly change")
        first, second = session.scalars(select(SigningKey).order_by(SigningKey.id))
        name = f"signing key {first.key_id}"
        assert list(mismatches(session)) == []
        revocation = KeyRevocation(since=NOON - timedelta(hours=1), reason="stolen")
        revoke_key(replace(transaction, audit_log=AuditLog(NEXT)), first.key_id, revocation)
        assert list(mismatches(session)) == []
        first.valid_until = second.valid_until = None
        first.public_key = second.public_key
        session.flush()
        assert list(mismatches(session)) == [
            "signing_key:1 was changed after its last entry in the audit log",
            f"{name}: its public key was changed",
        ]


@pytest.mark.parametrize(
    ("details", "told"),
    [
        pytest.param({"paused": False, "extra": 0}, {"paused": "no", "extra": "0"}, id="plain"),
        pytest.param({"expires_at": None, "dataset": ""}, {}, id="empty"),
        pytest.param(
            {"method": {"name": "Ours", "code": None, "extra_data": True}},
            {"method": "name Ours, extra data yes"},
            id="a method",
        ),
        pytest.param(
            {"phases": [{"name": "a", "opens": None}, {"name": "b", "opens": "2027-01-01"}]},
            {"phases": "name a; name b, opens 2027-01-01"},
            id="phases",
        ),
        pytest.param(
            {"before": {"anonymous_until": None}, "after": {"anonymous_until": "2027-01-01"}},
            {"before": "anonymous until none", "after": "anonymous until 2027-01-01"},
            id="a change from nothing",
        ),
    ],
)
def test_details_in_words(details: dict[str, Any], told: dict[str, str]) -> None:
    assert details_in_words(details) == told
