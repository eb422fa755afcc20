"""Signing keys: replaced, lost, stolen, and killed on the way; what was signed can be checked."""

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import text

from reverie_eval.receipts import NotGenuineError, verify_by_history
from reverie_eval.schemas.service import Envelope, KeyReport
from reverie_eval.server.audit.rows import mismatches
from reverie_eval.server.audit.signing import make_key
from reverie_eval.server.opening import acting, open_server
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.operations.keys import rotate_key
from reverie_eval.server.operations.restore import restore_backup
from reverie_eval.server.settings import load_settings
from reverie_eval.server.state import ServerState
from tests.server.test_doctor import sql
from tests.support.acting import NOON, add_team
from tests.support.flat_world import Run
from tests.support.serving import OPEN, ORGANISER, OTHER, OWNER, OpenServer, Serving, settings_of
from tests.support.signing import receipt_in
from tests.support.waiting import PATIENCE

ROTATE = """
import os, signal, sys
from pkgutil import resolve_name
from reverie_eval_cli.main import main
step, folder = sys.argv[1:]
owner, _, name = step.rpartition(".")
setattr(resolve_name(owner), name, lambda *_: os.kill(os.getpid(), signal.SIGKILL))
main(["server", "key", "rotate", folder])
"""
"""A process that is killed at a step of a rotation."""


def receipt_of(server: Serving, who: str = OWNER) -> Envelope:
    """Upload a new file, and return its receipt."""
    reply = server.upload(who, server.distinct())
    assert reply.status_code == 201, reply.text
    return Envelope.model_validate(reply.json()["submission"]["receipt"])


def received(server: Serving, envelope: Envelope, at: datetime) -> Envelope:
    """Return a receipt that a server has signed for another time."""
    receipt = receipt_in(envelope).model_copy(update={"received_at": at})
    return server.state.signer.sign(receipt)


def keys_of(server: Serving) -> list[KeyReport]:
    return [KeyReport.model_validate(key) for key in server.ask(None, "GET", "/keys").json()]


def faults(folder: Path) -> list[str]:
    return [finding.what for finding in examine(folder) if finding.kind == "fault"]


@pytest.fixture
def before(server: Serving) -> Envelope:
    """Return a receipt that the first key has signed."""
    return receipt_of(server)


@pytest.fixture
def after(
    before: Envelope,  # signed first
    server: Serving,
    folder: Path,
    open_server: OpenServer,
) -> Serving:
    """Return a server that was restarted after its key was rotated."""
    rotate_key(settings_of(folder), "test", "the yearly change")
    return open_server(settings_of(folder), server.tokens)


def test_receipts_of_all_keys_are_genuine_by_the_published_list(
    before: Envelope, after: Serving, folder: Path
) -> None:
    new, keys = receipt_of(after, OTHER), keys_of(after)
    assert [verify_by_history(each, keys) for each in (before, new)] == keys
    assert [(key.reason, key.valid_until is None) for key in keys] == [
        ("the yearly change", False),
        ("", True),
    ]
    assert after.ask(None, "GET", "/key").text == keys[-1].public_key
    assert faults(folder) == []


def test_an_old_key_signs_nothing_that_came_after_its_end(
    before: Envelope, server: Serving, after: Serving
) -> None:
    keys = keys_of(after)
    assert keys[0].valid_until is not None
    verify_by_history(received(server, before, keys[0].valid_until), keys)
    late = received(server, before, keys[0].valid_until + timedelta(microseconds=1))
    with pytest.raises(NotGenuineError, match=r"was valid until .* \(the yearly change\)"):
        verify_by_history(late, keys)


def test_a_server_with_the_old_key_changes_nothing_and_is_unwell(
    server: Serving, after: Serving
) -> None:
    refused = server.upload(OWNER, server.distinct())
    assert (refused.status_code, refused.json()["code"]) == (503, "key-replaced")
    renamed = server.ask(ORGANISER, "PATCH", "/organiser/teams/Blue", json={"name": "Azure"})
    assert renamed.status_code == 503
    assert server.client.get("/healthz").json()["failed"] == ["signing key"]
    assert server.ask(OWNER, "GET", "/me").status_code == 200
    assert after.client.get("/healthz").json()["failed"] == []
    assert after.ask(OWNER, "GET", f"/splits/{OPEN}").json()["quota"]["remaining"] == 199


def test_the_verify_command_names_the_key_with_and_without_the_server(
    before: Envelope, server: Serving, after: Serving, run: Run, tmp_path: Path
) -> None:
    file, keys = tmp_path / "receipt.json", tmp_path / "keys.json"
    keys.write_text(after.ask(None, "GET", "/keys").text)
    file.write_text(before.model_dump_json())
    outcome = run("verify", str(file), "--key", str(keys))
    first = keys_of(after)[0]
    dates = f"in use from {first.valid_from:%Y-%m-%d} to {first.valid_until:%Y-%m-%d}"
    assert outcome.status == 0
    assert f"signed with the key of {keys} ({first.key_id}, {dates})" in outcome.out
    future = received(server, before, NOON + timedelta(days=4000))
    file.write_text(future.model_dump_json())
    assert run("verify", str(file), "--key", str(keys)).status == 1
    keys.write_text('[{"key_id": 1}]')
    assert run("verify", str(file), "--key", str(keys)).status == 2


@pytest.mark.parametrize(
    ("step", "count"),
    [
        pytest.param("sqlalchemy.engine.default:DefaultDialect.do_commit", 1, id="the database"),
        pytest.param("pathlib:Path.replace", 2, id="the file"),
    ],
)
def test_a_rotation_that_is_killed_leaves_a_whole_server(
    step: str, count: int, before: Envelope, server: Serving, folder: Path
) -> None:
    killed = subprocess.run(
        [sys.executable, "-c", ROTATE, step, str(folder)], check=False, timeout=PATIENCE
    )
    assert killed.returncode == -signal.SIGKILL
    archive, restored = folder.with_name("backup.tar.gz"), folder.with_name("restored")
    write_backup(folder, archive)
    restore_backup(archive, restored)
    for place in (folder, restored):
        with closing(open_server(load_settings(place)).database):
            assert faults(place) == []
    keys = keys_of(server)
    assert len(keys) == count
    assert verify_by_history(before, keys) == keys[0]
    assert not (folder / "signing-key.pem.new").exists() or count == 1


@pytest.fixture
def lost(before: Envelope, folder: Path) -> Path:  # signed first
    """Return the folder of a server whose key is lost."""
    (folder / "signing-key.pem").unlink()
    return folder


def test_a_lost_key_is_replaced_and_what_it_signed_stays_genuine(
    before: Envelope, server: Serving, lost: Path, run: Run
) -> None:
    rotated = run("server", "key", "rotate", str(lost))
    backup = run("server", "backup", str(lost), "-o", str(lost.with_name("backup.tar.gz")))
    assert (rotated.status, backup.status) == (2, 2)
    for message in (rotated.err, backup.err, *faults(lost)):
        assert "; if it is lost for good, run `reverie-eval server key rotate FOLDER" in message
    assert run("server", "key", "rotate", str(lost), "--lost", "--reason", "a fire").status == 0
    doctor = run("server", "doctor", str(lost))
    assert doctor.status == 0, doctor.out
    assert "none missing between them" in doctor.out
    keys = keys_of(server)
    assert verify_by_history(before, keys).reason == "a fire"
    sql("UPDATE audit SET actor = 'nobody' WHERE id = (SELECT max(id) FROM audit)")(lost)
    assert any("cannot be verified" in fault for fault in faults(lost))


def test_a_key_that_is_there_is_not_lost(folder: Path, run: Run) -> None:
    outcome = run("server", "key", "rotate", str(folder), "--lost")
    assert (outcome.status, "so it is not lost" in outcome.err) == (2, True)


def test_another_file_in_the_place_of_a_lost_key_is_not_overwritten(lost: Path, run: Run) -> None:
    make_key(lost / "signing-key.pem")
    before = (lost / "signing-key.pem").read_bytes()
    outcome = run("server", "key", "rotate", str(lost), "--lost")
    assert (outcome.status, "move it to another place" in outcome.err) == (2, True)
    assert (lost / "signing-key.pem").read_bytes() == before


def test_a_damaged_key_is_replaced_after_its_file_was_moved(
    before: Envelope, server: Serving, folder: Path, run: Run
) -> None:
    key = folder / "signing-key.pem"
    key.write_bytes(key.read_bytes()[:60])
    assert "server key rotate FOLDER --lost" in run("server", "key", "rotate", str(folder)).err
    refused = run("server", "key", "rotate", str(folder), "--lost")
    assert (refused.status, "move it to another place" in refused.err) == (2, True)
    key.rename(folder / "damaged.pem")
    assert run("server", "key", "rotate", str(folder), "--lost").status == 0
    keys = keys_of(server)
    assert verify_by_history(before, keys) == keys[0]


def test_a_key_that_others_can_read_is_not_lost(folder: Path, run: Run) -> None:
    (folder / "signing-key.pem").chmod(0o644)
    outcome = run("server", "key", "rotate", str(folder), "--lost")
    assert (outcome.status, "run `chmod 600" in outcome.err) == (2, True)


def test_a_stolen_key_is_revoked_and_honest_receipts_are_signed_again(
    before: Envelope, server: Serving, folder: Path, open_server: OpenServer, run: Run
) -> None:
    server.clock.turn(days=2)
    stolen_at, (first,) = server.clock(), keys_of(server)
    server.clock.turn(days=1)
    affected = receipt_of(server, OTHER)
    since = ("--since", stolen_at.isoformat(), "--reason", "stolen")
    in_use = run("server", "key", "revoke", str(folder), first.key_id, *since)
    assert (in_use.status, "is in use" in in_use.err) == (2, True)
    assert run("server", "key", "rotate", str(folder)).status == 0
    revoked = run("server", "key", "revoke", str(folder), first.key_id, *since)
    assert revoked.out.splitlines()[-1] == "1 signature renewed with the key in use"
    again = run("server", "key", "revoke", str(folder), first.key_id, *since)
    assert (again.status, "give an earlier time" in again.err) == (2, True)
    assert run("server", "key", "revoke", str(folder), "none", *since).status == 2
    assert faults(folder) == []
    keys = keys_of(server)
    assert verify_by_history(before, keys) == keys[0]
    with pytest.raises(NotGenuineError, match="stolen"):
        verify_by_history(affected, keys)
    restarted = open_server(settings_of(folder), server.tokens)
    reply = restarted.ask(OTHER, "GET", f"/submissions/{receipt_in(affected).submission_id}")
    new = Envelope.model_validate(reply.json()["receipt"])
    assert verify_by_history(new, keys) == keys[1]
    assert new.payload == affected.payload


CHANGES_OF_KEYS = [
    "UPDATE signing_key SET valid_from = '2020-01-01 00:00:00.000000' WHERE id = 2",
    "UPDATE signing_key SET valid_until = '2099-01-01 00:00:00.000000' WHERE id = 1",
    "UPDATE signing_key SET public_key = 'mine' WHERE id = 1",
    "DELETE FROM signing_key WHERE id = 1",
    """INSERT INTO signing_key (key_id, public_key, valid_from, valid_until, replaced_at, reason)
    SELECT 'mine', public_key, valid_from, valid_until, replaced_at, reason FROM signing_key
    WHERE id = 1""",
]


@pytest.mark.parametrize("statement", CHANGES_OF_KEYS)
def test_a_key_that_was_changed_without_an_entry_is_found(
    statement: str, once_rotated: ServerState
) -> None:
    with once_rotated.database.trying() as session:
        assert not [*mismatches(session), *once_rotated.audit_log.broken_links(session)]
        session.execute(text(statement))
        session.expire_all()
        assert [*mismatches(session), *once_rotated.audit_log.broken_links(session)]


@pytest.fixture(scope="module")
def once_rotated(
    made_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServerState]:
    """Return a server whose key was rotated."""
    folder = shutil.copytree(made_folder, tmp_path_factory.mktemp("rotated") / "server")
    settings = load_settings(folder)
    with acting(settings, "test") as transaction:
        add_team(transaction, "Blue")
    rotate_key(settings, "test", "the yearly change")
    state = open_server(settings)
    with closing(state.database):
        yield state


def test_the_list_of_keys_says_which_is_in_use(after: Serving, folder: Path, run: Run) -> None:
    first, second = keys_of(after)
    lines = run("server", "key", "list", str(folder)).out.splitlines()[-2:]
    assert [(first.key_id in lines[0], "the yearly change" in lines[0])] == [(True, True)]
    assert [(second.key_id in lines[1], "in use" in lines[1])] == [(True, True)]
    page = after.client.get("/guide/api").text
    assert first.key_id in page
    entries = run("server", "audit", str(folder)).out.splitlines()[1:]
    assert "public key: -----BEGIN PUBLIC KEY-----\\n" in entries[-1]  # on one line


def test_the_old_file_is_refused_with_the_way_out(folder: Path, run: Run) -> None:
    key, copy = folder / "signing-key.pem", folder / "copy.pem"
    shutil.copy(key, copy)
    assert run("server", "key", "rotate", str(folder)).status == 0
    copy.replace(key)
    outcome = run("server", "doctor", "--quick", str(folder))
    assert (outcome.status, "copy its file here" in " ".join(outcome.out.split())) == (1, True)
    assert run("server", "team", "add", str(folder), "Green").status == 2
