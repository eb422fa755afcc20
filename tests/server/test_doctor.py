"""The doctor: every kind of damage is found and named, and nothing else is."""

import shutil
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.service import Method
from reverie_eval.server.operations import doctor
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.service.audit import entries
from reverie_eval.server.service.grants import grant
from reverie_eval.server.service.notices import post_notice
from reverie_eval.server.service.people import add_person, add_team, mint, revoke
from reverie_eval.server.service.receipts import make_key
from reverie_eval.server.service.reported import add_reported, remove_reported
from reverie_eval.server.service.reviews import lift, review
from reverie_eval.server.store.tables import AuditEntry, Submission
from tests.support.flat import Run
from tests.support.serving import OTHER, OWNER, PRIVATE, Serving, settings_of, submission_for

Damage = Callable[[Path], object]


@pytest.fixture
def kept(server: Serving, folder: Path) -> Path:
    """Return the folder of a server that has kept three submissions, and is stopped."""
    for who, split in ((OWNER, "val_unseen"), (OWNER, PRIVATE), (OTHER, PRIVATE)):
        assert server.upload(who, submission_for(split), split).status_code == 201
        server.clock.turn(hours=1)
    server.state.database.close()
    return folder


def test_a_sound_server_is_well(kept: Path, run: Run) -> None:
    outcome = run("server", "doctor", str(kept))
    assert outcome.status == 0
    assert " fault " not in outcome.out
    assert " note " not in outcome.out
    for told in ("2 uploads whole, of 2", "3 receipts verified", "entries in an unbroken chain"):
        assert told in outcome.out


def sql(statement: str) -> Damage:
    """Return what changes rows behind the server's back, checks off."""

    def damage(folder: Path) -> None:
        with closing(sqlite3.connect(folder / "server.db")) as database, database:
            assert database.execute(statement).rowcount > 0

    return damage


def upload(folder: Path) -> Path:
    """Return the file of an upload."""
    return min((folder / "uploads").rglob("*.json"))


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


FIRST = "id = (SELECT min(id) FROM submission)"
DAMAGES = [
    pytest.param(lambda folder: upload(folder).unlink(), "uploads", "is missing", id="no upload"),
    pytest.param(
        lambda folder: upload(folder).write_bytes(b"[]"),
        "uploads",
        "not what was sent",
        id="upload",
    ),
    pytest.param(put_a_folder, "uploads", "cannot be read", id="upload that is no file"),
    pytest.param(replace_key, "receipts", "this is key", id="another key"),
    pytest.param(
        sql(f"UPDATE submission SET report = json_set(report, '$.scores.spl', 1.0) WHERE {FIRST}"),
        "receipts",
        "says something else",
        id="score",
    ),
    pytest.param(
        sql(f"UPDATE submission SET receipt = json_set(receipt, '$.scores.spl', 1) WHERE {FIRST}"),
        "receipts",
        "changed",
        id="receipt's score",
    ),
    pytest.param(
        sql(f"UPDATE submission SET receipt = json_set(receipt, '$.proof', '') WHERE {FIRST}"),
        "receipts",
        "changed",
        id="receipt's proof",
    ),
    pytest.param(
        sql("UPDATE submission SET team_id = 3 - team_id WHERE split = 'val_unseen'"),
        "receipts",
        "says something else",
        id="another team's",
    ),
    pytest.param(
        sql(f"UPDATE submission SET received_at = '2026-01-01 00:00:00.000000' WHERE {FIRST}"),
        "receipts",
        "says something else",
        id="time",
    ),
    pytest.param(
        sql(
            "UPDATE submission SET report = json_set(report, '$.fingerprint', hex(zeroblob(32)))"
            f" WHERE {FIRST}"
        ),
        "reports",
        "does not name its ground truth",
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
        "an entry tells of it, and it is not there any more",
        id="submission removed",
    ),
    pytest.param(
        sql(f"UPDATE submission SET id = 'f00' WHERE {FIRST}"),
        "audit log",
        "submitted f00: no entry tells of it",
        id="submission slipped in",
    ),
    pytest.param(
        sql("UPDATE audit SET actor = 'nobody' WHERE id = 2"),
        "audit log",
        "entry 2 was changed",
        id="audit entry changed",
    ),
    pytest.param(
        sql("UPDATE audit SET at = datetime(at, '+1 second') || '.000000' WHERE id = 2"),
        "audit log",
        "entry 2 was changed",
        id="audit entry dated otherwise",
    ),
    pytest.param(
        sql("DELETE FROM audit WHERE id = 2"),
        "audit log",
        "entry 3 was changed, or one before it was removed",
        id="audit entry removed",
    ),
    pytest.param(
        sql("DELETE FROM audit WHERE id = 1"),
        "audit log",
        "entry 2 was changed, or one before it was removed",
        id="first audit entry removed",
    ),
    pytest.param(
        sql("DELETE FROM audit WHERE id = (SELECT max(id) FROM audit)"),
        "audit log",
        "no entry tells of it",
        id="last audit entry removed",
    ),
    pytest.param(
        sql("UPDATE audit SET details = '{' WHERE id = 2"),
        "audit log",
        "restore the last backup",
        id="audit entry that is no JSON",
    ),
    pytest.param(
        sql("DELETE FROM team WHERE id = 1"), "database", "has lost its team", id="team removed"
    ),
    pytest.param(spoil_pages, "database", "is malformed; restore the last", id="page"),
]


@pytest.mark.parametrize(("damage", "where", "told"), DAMAGES)
def test_damage_is_named(damage: Damage, where: str, told: str, kept: Path, run: Run) -> None:
    damage(kept)
    outcome = run("server", "doctor", str(kept))
    assert outcome.status == 1
    faults = [line for line in outcome.out.splitlines() if line.startswith(where)]
    assert any(" fault " in line and told in line for line in faults), outcome.out


DEEDS = [
    "team added Green",
    "person added Gus",
    "access token minted Gus",
    "invite token minted Gus",
    "token revoked Gus",
    "granted Green",
    "flagged {id}",
    "review lifted {id}",
    "changed {id}",
    "reported result added Theirs",
    "reported result removed Theirs",
    "notice posted server",
]


def do_everything(server: Serving) -> str:
    """Do once what leaves an entry, each at a time of its own; return the submission's id."""
    chosen = select(Submission.id).where(Submission.split == "val_unseen")
    with server.state.database.writing() as session:
        identity: str = session.scalars(chosen).one()

    def later(do: Callable[..., Any], *given: object, **named: object) -> Any:
        server.clock.turn(minutes=1)
        with server.state.database.writing() as session:
            return do(session, *given, **named, now=server.clock(), actor="test")

    later(add_team, "Green")
    gus = later(add_person, "Green", "Gus", "participant")
    minted = later(mint, gus, "access")
    later(mint, gus, "invite")
    later(revoke, minted.token.hint)
    ends = server.clock() + timedelta(days=2)
    later(grant, "Green", PRIVATE, 1, splits=[PRIVATE], reason="why", expires_at=ends)
    said = later(review, identity, "flagged", "why")
    later(lift, said.id)
    server.clock.turn(minutes=1)
    published = server.ask(OWNER, "PATCH", f"/submissions/{identity}", json={"published": True})
    assert published.status_code == 200
    scores = {"success": 0.5}
    reported = {"team": "They", "scores": scores, "source": "a paper", "splits": [PRIVATE]}
    result = later(add_reported, PRIVATE, Method(name="Theirs"), **reported)
    later(remove_reported, result.id)
    later(post_notice, "Hello", paused=False)
    return identity


@pytest.mark.parametrize("deed", DEEDS)
def test_a_log_that_was_cut_off_is_seen_by_what_is_still_there(
    deed: str, server: Serving, kept: Path
) -> None:
    told = deed.format(id=do_everything(server))
    assert [finding for finding in examine(kept) if finding.kind == "fault"] == []
    with server.state.database.writing() as session:
        (cut,) = [each for each in entries(session) if told == f"{each.action} {each.subject}"]
        session.execute(delete(AuditEntry).where(AuditEntry.id >= cut.id))
        add_team(session, "Newcomers", now=server.clock(), actor="test")  # with the same number
    faults = [finding.what for finding in examine(kept) if finding.kind == "fault"]
    told_at = f"{told}, {cut.at:%Y-%m-%d %H:%M:%S}"
    assert any(fault.startswith(f"{told_at}: no entry tells of it; ") for fault in faults)
    assert len(faults) == len(DEEDS) - DEEDS.index(deed)


def test_damage_to_several_is_named_all_at_once(kept: Path, run: Run) -> None:
    upload(kept).unlink()
    sql("UPDATE audit SET actor = 'nobody' WHERE id = 2")(kept)
    replace_key(kept)
    outcome = run("server", "doctor", str(kept))
    faults = [line.split("  ")[0] for line in outcome.out.splitlines() if " fault " in line]
    assert faults == ["uploads", *["receipts"] * 3, "audit log"]


def test_a_stray_file_is_no_fault(kept: Path, run: Run) -> None:
    (kept / "uploads" / "ab").mkdir(exist_ok=True)
    (kept / "uploads" / "ab" / ".half").touch()
    outcome = run("server", "doctor", str(kept))
    assert (outcome.status, " note " in outcome.out) == (0, True)
    assert "1 file of no submission: .half" in outcome.out


def test_other_ground_truth_since_then_is_no_fault(kept: Path, run: Run) -> None:
    shutil.copy(kept / "bundles" / "val_seen.npz", kept / "bundles" / "spare.npz")
    settings = kept / "reverie-eval.toml"
    only_seen = settings.read_text().partition("[splits.val_unseen]")[0]
    settings.write_text(only_seen)
    outcome = run("server", "doctor", str(kept))
    assert outcome.status == 0
    assert "1 submission to val_unseen scored by ground truth" in outcome.out


def test_little_space_is_a_fault(kept: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=(1 << 30) - 1))
    assert "1.0 GiB free; make room" in run("server", "doctor", str(kept)).out
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1 << 30))
    assert run("server", "doctor", str(kept)).status == 0


def test_nothing_written_meanwhile_looks_amiss(
    server_on: Serving, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The doctor sees one moment, on either database: here a submission comes while it looks."""
    url = server_on.state.settings.database
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", url)
    assert server_on.upload(OWNER).status_code == 201

    def entries_before_another(session: Session) -> Sequence[AuditEntry]:
        found = entries(session)
        assert server_on.upload(OWNER, server_on.distinct()).status_code == 201
        return found

    monkeypatch.setattr(doctor, "entries", entries_before_another)
    assert [finding for finding in examine(folder) if finding.kind == "fault"] == []
    assert settings_of(folder, url).database == url
