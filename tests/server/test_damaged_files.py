"""Damage to any page of the database and any file of a server: it is found, and said in a line."""

import re
import shutil
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest
from sqlalchemy.exc import DBAPIError

from reverie_eval.server.app import jobs_of
from reverie_eval.server.audit.signing import make_key
from reverie_eval.server.operations import health
from reverie_eval.server.operations.checks import check_folder
from reverie_eval.server.operations.health import REMEDIES, Health
from reverie_eval.server.settings import SETTINGS_FILE
from reverie_eval.server.store.damage import damage_in
from reverie_eval.server.store.database import Database
from tests.conftest import REPOSITORY
from tests.support.acting import add_person, add_team, create_token
from tests.support.amounts import amount, tell
from tests.support.damaging import (
    PAGE,
    SPOILS,
    damage_at_random,
    overwrite,
    pages_by_kind,
    rows_of_file,
)
from tests.support.processes import Laptop
from tests.support.server_data import use
from tests.support.serving import (
    GOOD,
    OPEN,
    ORGANISER,
    OTHER,
    OWNER,
    PRIVATE,
    CopyServer,
    NewDatabase,
    Serving,
)

TEAMS = 120
KINDS = (
    "header",
    "schema",
    "leaf of a table",
    "interior of a table",
    "leaf of an index",
    "interior of an index",
    "overflow",
    "free list",
)
LOG_HEADER, FRAME = 32, 24 + PAGE
"""Bytes of the header of SQLite's write-ahead log, and of a frame with its page."""
DATABASE, KEY, BUNDLE = "server.db", "signing-key.pem", f"bundles/{PRIVATE}.npz"
REMEDY = "restore the last backup to another folder: `reverie-eval server restore BACKUP FOLDER`"


@pytest.fixture(scope="module")
def filled(original: Serving) -> Serving:
    """Fill a server until its database has pages of all kinds."""
    use(original)
    with original.acting() as transaction:
        for number in range(TEAMS):
            add_team(transaction, f"Team {number}")
            add_person(transaction, f"Team {number}", f"Person {number}")
            create_token(transaction, f"Person {number}")
    long = "what it does " * 150
    assert original.upload(OTHER, original.distinct(), description=long).status_code == 201
    original.state.database.close()
    with closing(sqlite3.connect(file_of(original))) as database:
        database.execute("CREATE TABLE filling (content)")
        database.execute("INSERT INTO filling VALUES (zeroblob(100000))")
        database.commit()
        database.execute("DROP TABLE filling")  # its pages are free
        database.commit()
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return original


def file_of(server: Serving) -> Path:
    return server.state.settings.folder / DATABASE


@pytest.fixture
def folder(filled: Serving, tmp_path: Path) -> Path:
    """Return a copy of its folder."""
    return Path(shutil.copytree(filled.state.settings.folder, tmp_path / "lab"))


@pytest.fixture
def lively(filled: Serving, copy_server: CopyServer, monkeypatch: pytest.MonkeyPatch) -> Serving:
    """Return a running copy of it, whose health is looked at whenever somebody asks."""
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    server = copy_server(filled)
    assert failing(server) == []
    return server


def failing(server: Serving) -> list[str]:
    """Return what health complains of; for each there is a remedy."""
    reply = server.client.get("/healthz")
    report = reply.json()
    assert reply.status_code == (503 if report["failed"] else 200)
    assert len(report["remedies"]) == len(report["failed"])
    return list(report["failed"])


def database_faults(folder: Path) -> list[str]:
    """Return what a check finds wrong with the database; nothing that it read is repeated."""
    faults = [each for each in check_folder(folder) if each.kind == "fault"]
    found = [fault.what for fault in faults if fault.check == "database"]
    assert len(found) <= 1
    assert all(what.isascii() and what.isprintable() and "\\x" not in what for what in found)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_page_of_any_kind_is_found_at_the_start(
    kind: str, folder: Path, laptop: Laptop
) -> None:
    content = bytearray((folder / DATABASE).read_bytes())
    overwrite(content, Random(kind).choice(pages_by_kind(content)[kind]), Random(kind))
    (folder / DATABASE).write_bytes(content)
    title, problem = laptop.run("serve", folder, "--port", "0", status=1).err.splitlines()
    assert title == "reverie-eval: server folder rejected, 1 problem"
    assert problem.startswith("database: is damaged (")
    assert problem.endswith(f"; {REMEDY}")
    assert laptop.run("server", "doctor", folder, status=1).out.count("is damaged") >= 1


def test_damage_at_random_is_found_unless_no_row_is_affected(folder: Path, tmp_path: Path) -> None:
    whole, found, harmless = rows_of_file(folder / DATABASE), 0, 0
    original = shutil.copy(folder / DATABASE, tmp_path / "original")
    seeds = amount(8)
    for seed in range(seeds):
        shutil.copy(original, folder / DATABASE)
        damage_at_random(folder / DATABASE, seed, blocks=5 if seed % 2 else 1)
        is_same = rows_of_file(Path(shutil.copy(folder / DATABASE, tmp_path / "copy"))) == whole
        faults = database_faults(folder)
        assert faults or is_same, seed
        found, harmless = found + bool(faults), harmless + is_same
    tell(damaged_databases=seeds, found_at_the_start=found, with_all_rows_intact=harmless)


def test_a_real_server_ends_with_one_message(folder: Path, laptop: Laptop) -> None:
    damage_at_random(folder / DATABASE, seed=0)
    ended = replace(laptop, is_real=True).run("serve", folder, "--port", "0", status=1)
    assert "database: is damaged (" in ended.err
    assert len(ended.err.splitlines()) == 2


@pytest.mark.parametrize(
    "statement",
    [
        pytest.param("UPDATE submission SET received_at = 'once'", id="time"),
        pytest.param("UPDATE submission SET report = '{'", id="JSON"),
        pytest.param("UPDATE person SET email = CAST(x'ff' AS TEXT)", id="text that is not UTF-8"),
        pytest.param("UPDATE team SET name = name || char(0)", id="text with a zero byte"),
        pytest.param("UPDATE submission SET size = 'large'", id="number"),
        pytest.param("UPDATE submission SET shows_episodes = 7", id="yes or no"),
    ],
)
def test_a_value_that_its_column_cannot_hold_is_damage(statement: str, folder: Path) -> None:
    with closing(sqlite3.connect(folder / DATABASE)) as database, database:
        assert database.execute(statement).rowcount > 0
    (fault,) = database_faults(folder)
    assert fault.endswith(f"cannot be read); {REMEDY}")


@pytest.mark.parametrize(
    ("change", "damage"),
    [
        ("received_at = 'once'", "a stored value cannot be read"),
        ("report = '{'", "a stored value cannot be read"),
        ("split = split || CAST(x'ff' AS TEXT)", "a stored text is not UTF-8"),
    ],
)
def test_a_request_or_command_that_meets_damage_is_told_so(
    change: str, damage: str, lively: Serving, laptop: Laptop
) -> None:
    lively.state.database.close()
    with closing(sqlite3.connect(file_of(lively))) as database, database:
        database.execute(f"UPDATE submission SET {change}")
    reply = lively.ask(ORGANISER, "GET", "/submissions")
    assert (reply.status_code, reply.json()["code"]) == (503, "damaged")
    told = laptop.run("server", "submissions", lively.state.settings.folder, status=1).err
    assert told.splitlines()[1:] == [f"database: is damaged ({damage}); {REMEDY}"]


@pytest.mark.parametrize(
    ("what", "how"),
    [*(("episodes", how) for how in SPOILS), ("file", "missing"), ("file", "anything")],
)
def test_a_request_that_meets_a_damaged_upload_is_told_so(
    what: str, how: str, lively: Serving
) -> None:
    sent = lively.upload(OWNER, lively.distinct(), OPEN).json()["submission"]
    SPOILS[how](next((lively.state.settings.folder / "uploads").rglob(f"{sent['sha256']}*")))
    reply = lively.ask(OWNER, "GET", f"/submissions/{sent['id']}/{what}")
    assert (reply.status_code, reply.json()["code"]) == (503, "damaged")


def test_a_row_that_a_leaderboard_cannot_show_is_damage(
    filled: Serving, copy_server: CopyServer
) -> None:
    """It is valid JSON, so only those who read it notice."""
    server = copy_server(filled)
    with closing(sqlite3.connect(file_of(server))) as database, database:
        shown = "published_at = received_at, report = '{\"x\": 1}'"
        database.execute(f"UPDATE submission SET {shown} WHERE split = '{PRIVATE}'")
    reply = server.ask(OTHER, "GET", f"/splits/{PRIVATE}/leaderboard")
    assert (reply.status_code, reply.json()["code"]) == (503, "damaged")
    assert failing(server) == ["leaderboards"]


def remove_newest_upload(folder: Path) -> None:
    shutil.rmtree(folder / "uploads")


def replace_database(folder: Path) -> None:
    shutil.copy(folder / DATABASE, folder / "other.db")
    (folder / "other.db").replace(folder / DATABASE)


def remove_database(folder: Path) -> None:
    (folder / DATABASE).unlink()


def replace_key(folder: Path) -> None:
    (folder / KEY).unlink()
    make_key(folder / KEY)


@pytest.mark.parametrize(
    ("damage", "failed"),
    [
        (lambda folder: (folder / KEY).unlink(), ["signing key"]),
        (lambda folder: SPOILS["cut off"](folder / KEY), ["signing key"]),
        (replace_key, ["signing key"]),
        (remove_newest_upload, ["uploads"]),
        (replace_database, ["stored data", "database"]),
        (remove_database, ["stored data", "database"]),
    ],
)
def test_health_notices_what_became_of_any_file(
    damage: Callable[[Path], None], failed: Sequence[str], lively: Serving
) -> None:
    damage(lively.state.settings.folder)
    assert failing(lively) == failed
    assert lively.client.get("/readyz").status_code == 503


@pytest.mark.parametrize("damage", [replace_database, remove_database])
def test_no_upload_is_accepted_into_a_file_that_is_gone(
    damage: Callable[[Path], None], lively: Serving
) -> None:
    """SQLite would write on, to a file that nobody can open again."""
    damage(lively.state.settings.folder)
    reply = lively.upload(OWNER, GOOD + b" ", OPEN)
    assert (reply.status_code, reply.json()["code"]) == (503, "damaged")
    assert (lively.state.settings.folder / DATABASE).exists() == (damage is replace_database)


@pytest.mark.parametrize("how", SPOILS)
@pytest.mark.parametrize("name", [SETTINGS_FILE, DATABASE, KEY, BUNDLE])
def test_a_spoilt_file_keeps_a_server_from_starting(
    name: str, how: str, folder: Path, laptop: Laptop
) -> None:
    file = folder / name
    if (name, how) == (SETTINGS_FILE, "cut off"):
        file.write_bytes(file.read_bytes()[:-1] + b"[")  # at most places it is valid when cut off
    else:
        mode = file.stat().st_mode
        SPOILS[how](file)
        if file.is_file():
            file.chmod(mode)
    refused = laptop.run("serve", folder, "--port", "0", status=1)
    title, problem = refused.err.splitlines()[:2]
    assert title == "reverie-eval: server folder rejected, 1 problem"
    where = {SETTINGS_FILE: "settings", DATABASE: "database", KEY: "signing key"}
    assert problem.startswith(f"{where.get(name, 'ground truth')}: ")
    assert problem.isascii()
    assert where.get(name, "ground truth") in laptop.run("server", "doctor", folder, status=1).out


def test_uploads_that_are_gone_keep_a_server_from_starting(folder: Path, laptop: Laptop) -> None:
    shutil.rmtree(folder / "uploads")
    told = laptop.run("serve", folder, "--port", "0", status=1).err
    assert "newest upload: the upload " in told
    assert " is missing; run `reverie-eval server doctor`" in told


@pytest.mark.parametrize("how", SPOILS)
def test_a_spoilt_key_that_was_not_finished_is_no_obstacle(how: str, folder: Path) -> None:
    """A rotation that was interrupted may leave it; it is written again."""
    pending = folder / f"{KEY}.new"
    shutil.copy(folder / KEY, pending)
    SPOILS[how](pending)
    assert not [each for each in check_folder(folder) if each.kind == "fault"]


@pytest.mark.parametrize(
    ("names", "checks"),
    [
        pytest.param([SETTINGS_FILE], ["settings"], id="the settings"),
        pytest.param(
            [DATABASE, KEY, BUNDLE], ["database", "signing key", "ground truth"], id="all others"
        ),
    ],
)
def test_files_that_the_server_may_not_read_are_named(
    names: Sequence[str], checks: Sequence[str], folder: Path, laptop: Laptop
) -> None:
    for name in names:
        (folder / name).chmod(0)
    checked = laptop.like_anybody("server", "doctor", "--quick", str(folder))
    assert checked.status == 1
    for name, check in zip(names, checks, strict=True):
        (fault,) = re.findall(rf"^{check} +fault +(.*)$", checked.out, re.MULTILINE)
        assert name in fault or name == DATABASE


def test_uploads_that_cannot_be_listed_are_a_fault(folder: Path, laptop: Laptop) -> None:
    (folder / "uploads").chmod(0)
    checked = laptop.like_anybody("server", "doctor", str(folder))
    assert checked.status == 1
    assert re.search(r"^uploads +fault +they cannot be listed: ", checked.out, re.MULTILINE)


@pytest.fixture
def killed(folder: Path, tmp_path: Path) -> Path:
    """Return a copy of a server's folder as it is when the server is killed between two uploads."""
    with closing(sqlite3.connect(folder / DATABASE, isolation_level=None)) as database:
        for day in range(1, 6):
            database.execute(f"UPDATE team SET created_at = '2026-01-0{day} 12:00:00.000000'")
        return Path(shutil.copytree(folder, tmp_path / "killed"))


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda content: content, id="all of it"),
        pytest.param(lambda content: content[:-FRAME], id="without the last frame"),
        pytest.param(lambda content: content[:-20], id="with an incomplete frame"),
        pytest.param(lambda content: content + content[LOG_HEADER:][::-1], id="with older frames"),
        pytest.param(lambda content: content[:0], id="nothing"),
    ],
)
def test_a_server_that_was_killed_starts_again(
    change: Callable[[bytes], bytes], killed: Path, laptop: Laptop
) -> None:
    log = killed / f"{DATABASE}-wal"
    log.write_bytes(change(log.read_bytes()))
    (killed / f"{DATABASE}-shm").write_bytes(Random(0).randbytes(1 << 15))
    listed = laptop.run("server", "team", "list", killed)
    assert "Team 1" in listed.out


def without_log(log: Path) -> None:
    log.unlink()


def with_damaged_log(log: Path) -> None:
    content = bytearray(log.read_bytes())
    content[LOG_HEADER + 100] ^= 1
    log.write_bytes(content)


@pytest.mark.parametrize("damage", [without_log, with_damaged_log])
def test_a_submission_that_the_log_alone_had_is_missed(
    damage: Callable[[Path], None], lively: Serving, tmp_path: Path, laptop: Laptop
) -> None:
    assert lively.upload(OWNER, lively.distinct()).status_code == 201
    killed = Path(shutil.copytree(lively.state.settings.folder, tmp_path / "killed"))
    assert (
        " fault "
        not in laptop.run("server", "doctor", shutil.copytree(killed, tmp_path / "it")).out
    )
    damage(killed / f"{DATABASE}-wal")
    (killed / f"{DATABASE}-shm").unlink()
    assert " without a submission: " in laptop.run("server", "doctor", killed, status=1).out


def test_damage_that_postgresql_finds_is_recognised(postgresql: NewDatabase) -> None:
    with closing(Database(postgresql())) as database:
        known = {"XX001": "a page is malformed", "XX002": "an index is malformed"}
        for state, damage in known.items():
            failing = f"DO $$ BEGIN RAISE EXCEPTION 'x' USING ERRCODE = '{state}'; END $$"
            with database.engine.connect() as connection, pytest.raises(DBAPIError) as error:
                connection.exec_driver_sql(failing)
            assert damage_in(error.value) == damage


@pytest.mark.parametrize("page", ["SECURITY.md", "docs/reference/server-operations.md"])
def test_every_check_of_health_is_explained(page: str, lively: Serving) -> None:
    state = lively.state
    names = [*Health(state, jobs_of(state)).checks, "job mail"]
    lines = (REPOSITORY / page).read_text().splitlines()
    explained = [line.split(" | ") for line in lines if line.startswith("| `")]
    for name in names:
        kind = next(kind for kind in REMEDIES if name.startswith(kind))
        (row,) = [row for row in explained if row[0].startswith(f"| `{kind}") and len(row) == 3]
        assert all(row), name  # what it means, and what to do
    assert all(any(name.startswith(kind) for name in names) for kind in REMEDIES)
