"""Two servers on one PostgreSQL and one S3-compatible store: one server, or they say why not."""

import json
import os
import shutil
from collections.abc import Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import httpx
import pytest

from reverie_eval.server.audit.log import RULES, entries
from reverie_eval.server.store.database import Database
from tests.support.processes import Laptop, Server
from tests.support.serving import GOOD, NO_TLS, OPEN, OWNER, Template, replace_answers, settings_of
from tests.support.waiting import PATIENCE, wait_until

NAME = "same rules as other servers"


@pytest.fixture
def shared(
    postgresql: Any, postgresql_template: Template, bucket: str, folder: Path
) -> Mapping[str, str]:
    """Return environment variables that name the database and the store of all replicas."""
    return {
        "REVERIE_EVAL_DATABASE": postgresql(postgresql_template.populated),
        "REVERIE_EVAL_UPLOADS": f"s3://{bucket}/uploads",
        **{name: os.environ[name] for name in os.environ if name.startswith("AWS_")},
    }


@pytest.fixture
def other_folder(folder: Path) -> Path:
    """Return a copy of a server's folder, for a second machine."""
    return Path(shutil.copytree(folder, folder.with_name("other")))


def files_of(folder: Path) -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def health(server: Server) -> tuple[int, list[str]]:
    reply = httpx.get(f"{server.url}/healthz", timeout=PATIENCE, verify=NO_TLS)
    return reply.status_code, reply.json()["failed"]


WELL: tuple[int, list[str]] = (200, [])


def test_replicas_are_one_server(
    laptop: Laptop,
    folder: Path,
    other_folder: Path,
    shared: Mapping[str, str],
    postgresql_template: Template,
) -> None:
    token, before = postgresql_template.tokens[OWNER], files_of(folder)
    with (
        laptop.serving(folder, variables=shared) as one,
        laptop.serving(other_folder, variables=shared) as other,
    ):
        first = one.upload(token, OPEN, GOOD)
        again = other.upload(token, OPEN, GOOD)
        assert (first.status_code, again.status_code) == (201, 200)
        assert again.json()["submission"] == first.json()["submission"]
        assert again.json()["quota"] == first.json()["quota"]
        submission = f"/submissions/{first.json()['submission']['id']}"
        assert other.get(f"{submission}/file", token).content == GOOD
        assert one.get(f"/splits/{OPEN}/leaderboard").json()["rows"] == []
        httpx.patch(
            f"{other.url}/api/v1{submission}",
            json={"published": True},
            headers={"Authorization": f"Bearer {token}"},
            timeout=PATIENCE,
            verify=NO_TLS,
        ).raise_for_status()
        assert len(one.get(f"/splits/{OPEN}/leaderboard").json()["rows"]) == 1
        wait_until(lambda: health(one) == health(other) == WELL)
    assert files_of(folder) == before
    settings = settings_of(folder, shared["REVERIE_EVAL_DATABASE"])
    with closing(Database(settings.database_url)) as database, database.reading() as session:
        assert [entry.action for entry in entries(session)].count(RULES) == 1


def test_replicas_with_different_bundles_say_so(
    laptop: Laptop, folder: Path, other_folder: Path, shared: Mapping[str, str]
) -> None:
    replace_answers(other_folder, OPEN)
    with ExitStack() as later:
        with laptop.serving(folder, "--workers", "2", variables=shared) as one:
            wait_until(lambda: health(one) == WELL)
            checked = laptop.run("server", "doctor", "--quick", other_folder, variables=shared)
            note = f"{OPEN}: this folder has split:{OPEN}|"
            assert note in " ".join(checked.out.split())
            other = later.enter_context(laptop.serving(other_folder, variables=shared))
            assert note in " ".join(other.log.read_text().split())
            wait_until(lambda: health(one) == (503, [NAME]))
            wait_until(lambda: health(other) == WELL)
            log = [json.loads(line) for line in one.log.read_text().splitlines()]
            (line, *_) = (line for line in log if "started later" in line["event"])
            assert line["splits"] == [OPEN]
            assert line["rules"][OPEN] != line["other"][OPEN]
            checked = laptop.run("server", "doctor", "--quick", folder, variables=shared)
            assert note in " ".join(checked.out.split())
        replace_answers(folder, OPEN)
        with laptop.serving(folder, variables=shared) as one:
            wait_until(lambda: health(one) == health(other) == WELL)
            assert OPEN not in laptop.run("server", "doctor", folder, variables=shared).err
