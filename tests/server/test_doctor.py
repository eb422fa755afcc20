"""The doctor: every kind of damage is found and named, and nothing else is."""

import gzip
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import time_machine
from anyio.from_thread import BlockingPortal
from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import (
    NewGrant,
    NewNews,
    NewNotice,
    NewReported,
    NewSchedule,
    NewSnapshot,
    NewTeam,
    ReportedChange,
)
from reverie_eval.schemas.service import Method
from reverie_eval.server.accounts.people import rename_team, team_named
from reverie_eval.server.accounts.tokens import revoke_token
from reverie_eval.server.audit.log import entries, row_name
from reverie_eval.server.audit.rows import mismatches
from reverie_eval.server.audit.signing import make_key
from reverie_eval.server.boards.news import add_news, remove_news
from reverie_eval.server.boards.reported import add_reported, change_reported, remove_reported
from reverie_eval.server.boards.reviews import lift_review
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.intake.quotas import grant
from reverie_eval.server.messages.notices import post_notice
from reverie_eval.server.opening import acting
from reverie_eval.server.operations import doctor
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.store.tables import AuditEntry, News, Submission
from tests.support.acting import AUDIT_LOG, NOON, add_person, add_team, create_token, review
from tests.support.flat_world import Run
from tests.support.serving import (
    OTHER,
    OWNER,
    PRIVATE,
    CopyServer,
    Populated,
    Serving,
    opening,
    settings_of,
    submission_for,
)

Damage = Callable[[Path], object]
ALL_UPLOADED = timedelta(hours=3)


def keep_three(server: Serving) -> None:
    """Upload three submissions."""
    for who, split in ((OWNER, "val_unseen"), (OWNER, PRIVATE), (OTHER, PRIVATE)):
        assert server.upload(who, submission_for(split), split).status_code == 201
        server.clock.turn(hours=1)


@pytest.fixture(scope="module")
def three(original: Serving) -> Serving:
    """Return a server that has kept three submissions."""
    keep_three(original)
    return original


@pytest.fixture
def kept(three: Serving, tmp_path: Path) -> Path:
    """Return a copy of its folder."""
    return Path(shutil.copytree(three.state.settings.folder, tmp_path / "server"))


def test_a_sound_server_is_well(kept: Path, run: Run) -> None:
    outcome = run("server", "doctor", str(kept))
    assert outcome.status == 0
    assert " fault " not in outcome.out
    assert " note " not in outcome.out
    for told in (
        "2 of 2 uploads intact",
        "3 receipts verified",
        "none missing between them",
    ):
        assert told in outcome.out


def sql(statement: str) -> Damage:
    """Return what changes rows behind the server's back, checks off."""

    def damage(folder: Path) -> None:
        with closing(sqlite3.connect(folder / "server.db")) as database, database:
            assert database.execute(statement).rowcount > 0

    return damage


def upload(folder: Path) -> Path:
    """Return the file of an upload."""
    return min((folder / "uploads").rglob("*.json.gz"))


def replace_key(folder: Path) -> None:
    (folder / "signing-key.pem").unlink()
    make_key(folder / "signing-key.pem")


def put_a_folder(folder: Path) -> None:
    file = upload(folder)
    file.unlink()
    file.mkdir()


def spoil_pages(folder: Path) -> None:
    with closing(sqlite3.connect(folder / "server.db")) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (page,) = database.execute(
            "SELECT rootpage FROM sqlite_schema WHERE name = 'submission'"
        ).fetchone()
    content = bytearray((folder / "server.db").read_bytes())
    content[(page - 1) * 4096 : (page - 1) * 4096 + 64] = b"\xff" * 64
    (folder / "server.db").write_bytes(content)


SIGNATURE = "$.signatures[0].sig"
FIRST = "id = (SELECT id FROM submission ORDER BY received_at LIMIT 1)"
DAMAGES = [
    pytest.param(lambda folder: upload(folder).unlink(), "uploads", "is missing", id="no upload"),
    pytest.param(
        lambda folder: upload(folder).write_bytes(gzip.compress(b"[]")),
        "uploads",
        "differs from the file that was uploaded",
        id="upload",
    ),
    pytest.param(
        lambda folder: upload(folder).write_bytes(b"[]"),
        "uploads",
        "cannot be read (Not a gzipped file",
        id="upload that is not compressed",
    ),
    pytest.param(put_a_folder, "uploads", "cannot be read", id="upload that is no file"),
    pytest.param(replace_key, "signing key", "is in use", id="another key"),
    pytest.param(
        sql(f"UPDATE submission SET report = json_set(report, '$.scores.spl', 1.0) WHERE {FIRST}"),
        "receipts",
        "differs from its row",
        id="score",
    ),
    pytest.param(
        sql(
            "UPDATE submission SET receipt = json_set(receipt, '$.payload', "
            f"replace(receipt ->> '$.payload', '0', '1')) WHERE {FIRST}"
        ),
        "receipts",
        "changed",
        id="receipt's bytes",
    ),
    pytest.param(
        sql(f"UPDATE submission SET receipt = json_set(receipt, '{SIGNATURE}', '') WHERE {FIRST}"),
        "receipts",
        "changed",
        id="receipt's signature",
    ),
    pytest.param(
        sql("UPDATE submission SET team_id = 3 - team_id WHERE split = 'val_unseen'"),
        "receipts",
        "differs from its row",
        id="another team's",
    ),
    pytest.param(
        sql(f"UPDATE submission SET received_at = '2026-01-01 00:00:00.000000' WHERE {FIRST}"),
        "receipts",
        "differs from its row",
        id="time",
    ),
    pytest.param(
        sql(
            "UPDATE submission SET report = json_set(report, '$.fingerprint', hex(zeroblob(32)))"
            f" WHERE {FIRST}"
        ),
        "receipts",
        "differs from its row",
        id="fingerprint",
    ),
    pytest.param(
        sql(f"UPDATE submission SET report = '{{' WHERE {FIRST}"),
        "submissions",
        "cannot be read",
        id="report that is no JSON",
    ),
    pytest.param(
        sql(f"UPDATE submission SET receipt = '[]' WHERE {FIRST}"),
        "submissions",
        "cannot be read",
        id="receipt that is none",
    ),
    pytest.param(
        sql(f"UPDATE submission SET received_at = 'once' WHERE {FIRST}"),
        "submissions",
        "cannot be read",
        id="time that is none",
    ),
    pytest.param(
        sql(f"DELETE FROM submission WHERE {FIRST}"),
        "audit log",
        "in the audit log, but no longer in the database",
        id="submission removed",
    ),
    pytest.param(
        sql(f"UPDATE submission SET id = 'f00' WHERE {FIRST}"),
        "audit log",
        "submission:f00: in the database, but not in the audit log",
        id="submission slipped in",
    ),
    pytest.param(
        sql("UPDATE audit SET actor = 'nobody' WHERE id = 2"),
        "audit log",
        "1 entry cannot be verified (2)",
        id="audit entry changed",
    ),
    pytest.param(
        sql("UPDATE audit SET at = datetime(at, '+1 second') || '.000000' WHERE id = 2"),
        "audit log",
        "1 entry cannot be verified (2)",
        id="audit entry dated otherwise",
    ),
    pytest.param(
        sql("UPDATE person SET role = 'organiser' WHERE name = 'Ada'"),
        "audit log",
        "person:1 was changed after its last entry in the audit log; compare with a backup",
        id="role given",
    ),
    pytest.param(
        sql("DELETE FROM audit WHERE id = 2"),
        "audit log",
        "1 entry cannot be verified (3): changed, not signed with the key that was in use, or",
        id="audit entry removed",
    ),
    pytest.param(
        sql("DELETE FROM audit WHERE id = 1"),
        "audit log",
        "1 entry cannot be verified (2): changed, not signed with the key that was in use, or",
        id="first audit entry removed",
    ),
    pytest.param(
        sql("DELETE FROM audit WHERE id = (SELECT max(id) FROM audit)"),
        "audit log",
        "in the database, but not in the audit log",
        id="last audit entry removed",
    ),
    pytest.param(
        sql("UPDATE audit SET details = '{' WHERE id = 2"),
        "audit log",
        "restore the last backup",
        id="audit entry that is no JSON",
    ),
    pytest.param(
        sql("DELETE FROM team WHERE id = 1"),
        "database",
        "refers to a missing team",
        id="team removed",
    ),
    pytest.param(spoil_pages, "database", "; restore the last backup", id="page"),
]


@pytest.mark.parametrize(("damage", "where", "told"), DAMAGES)
def test_damage_is_named(damage: Damage, where: str, told: str, kept: Path, run: Run) -> None:
    damage(kept)
    outcome = run("server", "doctor", str(kept))
    assert outcome.status == 1
    faults = [line for line in outcome.out.splitlines() if line.startswith(where)]
    assert any(" fault " in line and told in line for line in faults), outcome.out


CHANGED = "changed after its last entry in the audit log; compare with a backup"
ACTIONS = [
    "team added",
    "person added",
    "access token created",
    "invite token created",
    "token revoked",
    "granted",
    "flagged",
    "review lifted",
    "changed",
    "reported result added",
    "reported result removed",
    "notice posted",
    "schedule set",
    "snapshot taken",
    "news added",
    "news removed",
]
"""In their order."""


def do_everything(server: Serving) -> None:
    """Do once what leaves an entry, each at a time of its own."""
    chosen = select(Submission.id).where(Submission.split == "val_unseen")
    with server.state.database.reading() as session:
        identity = session.scalars(chosen).one()

    def later(do: Callable[..., Any], *given: object) -> Any:
        server.clock.turn(minutes=1)
        with server.acting() as transaction:
            return do(transaction, *given)

    later(add_team, "Green")
    later(add_person, "Green", "Gus")
    later(rename_team, "Green", NewTeam(name="Lime"))
    created = later(create_token, "Gus")
    later(create_token, "Gus", "invite")
    later(revoke_token, created.hint)
    ends = server.clock() + timedelta(days=2)
    new = NewGrant(team="Lime", split=PRIVATE, extra=1, reason="why", expires_at=ends)
    later(grant, new, [PRIVATE])
    said = later(review, identity, "flagged")
    later(lift_review, said.id)
    server.clock.turn(minutes=1)
    published = server.ask(OWNER, "PATCH", f"/submissions/{identity}", json={"published": True})
    assert published.status_code == 200
    reported = NewReported(
        split=PRIVATE,
        method=Method(name="Theirs"),
        team="They",
        scores={"success": 0.5},
        source="https://example.org/paper",
    )
    result = later(add_reported, reported, server.state.settings.tasks)
    later(change_reported, result.id, ReportedChange(team="They all"), server.state.settings.tasks)
    later(remove_reported, result.id)
    later(post_notice, NewNotice(banner="Hello"))
    later(server.state.get(Schedules).set, PRIVATE, NewSchedule(paused=True))
    later(server.state.get(Snapshots).take, NewSnapshot(split=PRIVATE, title="2026"))
    later(remove_news, later(add_news, NewNews(text="Hello")).id)


@pytest.fixture(scope="module")
def full_log(
    made_folder: Path,
    portal: BlockingPortal,
    populated: Populated,
    tmp_path_factory: pytest.TempPathFactory,
) -> Serving:
    """Return a server with everything in its log, which is stopped; tests take copies."""
    folder = Path(shutil.copytree(made_folder, tmp_path_factory.mktemp("full_log") / "server"))
    with opening(folder, portal, populated) as open_server:
        server = open_server()
        keep_three(server)
        do_everything(server)
    assert faults_of(folder) == []
    return server


@pytest.mark.parametrize("action", ACTIONS)
def test_a_log_that_was_cut_off_is_seen_by_what_is_still_there(
    action: str, full_log: Serving, tmp_path: Path
) -> None:
    kept = Path(shutil.copytree(full_log.state.settings.folder, tmp_path / "server"))
    with acting(settings_of(kept), "test", full_log.clock) as transaction:
        found = [each for each in entries(transaction.session) if each.at > NOON + ALL_UPLOADED]
        cut = next(each for each in found if each.action == action)
        rows = {each.row for each in found if each.id >= cut.id}
        transaction.session.execute(delete(AuditEntry).where(AuditEntry.id >= cut.id))
        add_team(transaction, "Newcomers")  # with the same number
    told = [re.split(": | was ", fault)[:2] for fault in faults_of(kept)]
    seen = ("in the database, but not in the audit log; compare with a backup", CHANGED)
    assert sorted(row for row, why in told if why in seen) == sorted(rows)
    assert len(told) == len(rows)


def test_a_renamed_team_leaves_everything_whole(three: Serving, copy_server: CopyServer) -> None:
    server = copy_server(three)
    with server.acting() as transaction:
        rename_team(transaction, "Blue", NewTeam(name="Azure"))
    assert faults_of(server.state.settings.folder) == []


def test_a_team_that_was_renamed_without_an_entry_is_named(kept: Path) -> None:
    sql("UPDATE team SET name = 'Azure' WHERE name = 'Blue'")(kept)
    told = [fault for fault in faults_of(kept) if fault.startswith("team:")]
    assert told == [f"team:1 was {CHANGED}"]


def test_persons_whose_names_were_swapped_are_named(kept: Path) -> None:
    """The log has no names of persons, but digests of their rows."""
    sql("UPDATE person SET name = 'Eve' WHERE name = 'Ada'")(kept)
    told = [fault for fault in faults_of(kept) if fault.startswith("person:")]
    assert told == [f"person:1 was {CHANGED}"]


def test_a_chain_that_was_linked_again_without_the_key_is_broken(
    three: Serving, copy_server: CopyServer
) -> None:
    """Whoever can write to the database, but does not have the key, cannot cover it up."""
    server, stranger = copy_server(three), AUDIT_LOG
    with server.acting() as transaction:
        session = transaction.session
        left = [each for each in entries(session) if each.id > 2]
        session.execute(delete(AuditEntry).where(AuditEntry.id > 1))
        for each in left:
            team = team_named(session, "Blue")
            stranger.append(
                *(session, each.at, each.actor, each.action),
                row=row_name(team),
                row_digest="",
                subject="Blue",
            )
    faults = faults_of(server.state.settings.folder)
    assert any(" cannot be verified (2, 3, 4" in fault for fault in faults)


def faults_of(folder: Path) -> Sequence[str]:
    return [finding.what for finding in examine(folder) if finding.kind == "fault"]


def test_damage_to_several_is_named_all_at_once(kept: Path, run: Run) -> None:
    upload(kept).unlink()
    sql("UPDATE audit SET actor = 'nobody' WHERE id = 2")(kept)
    sql(f"UPDATE submission SET receipt = json_set(receipt, '{SIGNATURE}', '') WHERE {FIRST}")(kept)
    outcome = run("server", "doctor", str(kept))
    faults = [line.split("  ")[0] for line in outcome.out.splitlines() if " fault " in line]
    assert faults == ["uploads", "receipts", "audit log"]


def test_an_upload_whose_row_was_lost_is_named(kept: Path) -> None:
    upload = next((kept / "uploads").glob("*/*.gz"))
    shutil.copy(upload, upload.parent / f"{'0' * 64}.json.gz")
    (fault,) = faults_of(kept)
    assert fault.startswith(f"1 upload without a submission: {upload.parent.name}/{'0' * 64}.json")
    assert "ask teams to send theirs again" in fault


def test_a_file_that_was_never_finished_is_no_fault(kept: Path, run: Run) -> None:
    (next((kept / "uploads").iterdir()) / ".tmp1a2b3c4d").touch()
    assert run("server", "doctor", str(kept)).status == 0


def test_a_split_that_was_removed_is_no_fault(kept: Path, run: Run) -> None:
    shutil.copy(kept / "bundles" / "val_seen.npz", kept / "bundles" / "spare.npz")
    settings = kept / "reverie-eval.toml"
    only_seen = settings.read_text().partition("[splits.val_unseen]")[0]
    settings.write_text(only_seen)
    outcome = run("server", "doctor", str(kept))
    assert outcome.status == 0
    assert "1 submission to val_unseen, which is not a split in the settings" in outcome.out


def test_little_space_is_a_fault(kept: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=(1 << 30) - 1))
    assert "1.0 GiB free; free some space" in run("server", "doctor", str(kept)).out
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1 << 30))
    assert run("server", "doctor", str(kept)).status == 0


@pytest.mark.parametrize(
    ("back", "is_told"), [(timedelta(minutes=1), False), (timedelta(minutes=2), True)]
)
def test_a_clock_that_was_set_back_is_noted(
    kept: Path, run: Run, back: timedelta, *, is_told: bool
) -> None:
    with closing(sqlite3.connect(kept / "server.db")) as database:
        ((latest,),) = database.execute("SELECT max(at) FROM audit")
    with time_machine.travel(datetime.fromisoformat(f"{latest}+00:00") - back, tick=False):
        outcome = run("server", "doctor", str(kept))
    assert (outcome.status, "by this machine's clock, but" in outcome.out) == (0, is_told)


def test_nothing_written_meanwhile_looks_amiss(
    server_on: Serving, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The doctor sees one moment, on either database: here a submission comes while it looks."""
    url = server_on.state.settings.database
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", url)
    assert server_on.upload(OWNER).status_code == 201

    def mismatches_after_another(session: Session) -> Iterator[str]:
        assert server_on.upload(OWNER, server_on.distinct()).status_code == 201
        return mismatches(session)

    monkeypatch.setattr(doctor, "mismatches", mismatches_after_another)
    assert [finding for finding in examine(folder) if finding.kind == "fault"] == []
    assert settings_of(folder, url).database == url


def test_the_audit_log_is_compared_with_all_rows(server_on: Serving) -> None:
    sent = server_on.upload(OWNER).json()["submission"]["id"]
    server_on.ask(OWNER, "PATCH", f"/submissions/{sent}", json={"published": True})
    with server_on.state.database.writing() as session:
        assert list(mismatches(session)) == []
        session.get_one(Submission, sent).published_at = NOON + timedelta(hours=1)
        session.execute(delete(AuditEntry).where(AuditEntry.action == "submitted"))
        session.add(News(text="Forged", created_at=NOON))
        session.flush()
        assert list(mismatches(session)) == [
            "news:1: in the database, but not in the audit log",
            f"submission:{sent} was changed after its last entry in the audit log",
        ]
