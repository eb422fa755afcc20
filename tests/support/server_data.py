"""What a server has kept: its rows, what the doctor says of them, and a backup of it all."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
from anyio.from_thread import BlockingPortal

from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.doctor import examine
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.dump import Row, dump
from tests.support.serving import (
    GOOD,
    MATE,
    OTHER,
    OWNER,
    PRIVATE,
    Populated,
    Serving,
    opening,
    submission_for,
)


@contextmanager
def opened(folder: Path) -> Iterator[Database]:
    """Open the database of a server."""
    database = Database(load_settings(folder).database_url)
    try:
        yield database
    finally:
        database.close()


def rows_of(folder: Path) -> Sequence[Row]:
    """Return every row of a server's database."""
    with opened(folder) as database:
        return list(dump(database))


def faults(folder: Path) -> list[str]:
    """Return what the doctor complains of."""
    return [str(finding) for finding in examine(folder) if finding.kind == "fault"]


def use(server: Serving) -> None:
    """Do some of everything that a server keeps."""
    server.upload(OWNER, GOOD, key="a key", description="Équipe 蓝")
    server.upload(MATE, submission_for(PRIVATE), PRIVATE)
    server.upload(OTHER, submission_for(PRIVATE), PRIVATE)
    (newest, *_) = server.ask(OTHER, "GET", "/submissions").json()
    change = {"published": True, "anonymous_until": "2026-06-01T00:00:00.000001Z"}
    server.ask(OTHER, "PATCH", f"/submissions/{newest['id']}", json=change)


class UsedServer(NamedTuple):
    """What is made once for all tests of a process; they take copies."""

    folder: Path
    """The folder of a server that people have used."""
    archive: Path
    """The backup of that server."""


@pytest.fixture(scope="session")
def used_server(
    made_folder: Path,
    portal: BlockingPortal,
    populated: Populated,
    tmp_path_factory: pytest.TempPathFactory,
) -> UsedServer:
    """Use a server, and write a backup of it."""
    made = tmp_path_factory.mktemp("used_server")
    found = UsedServer(Path(shutil.copytree(made_folder, made / "server")), made / "backup.tar.gz")
    with opening(found.folder, portal, populated) as open_server:
        use(open_server())
        write_backup(found.folder, found.archive)
    return found


@pytest.fixture
def used(used_server: UsedServer, tmp_path: Path) -> Path:
    """Return the folder of a server that people have used."""
    return Path(shutil.copytree(used_server.folder, tmp_path / "server"))


@pytest.fixture
def archive(used_server: UsedServer, tmp_path: Path) -> Path:
    """Return its backup."""
    return Path(shutil.copy(used_server.archive, tmp_path))
