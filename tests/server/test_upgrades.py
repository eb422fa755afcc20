"""Folders of released versions, which every later version opens.

The database of a released version is never edited again: a change is a new migration. Migration
0001 is the schema of 0.1.0, and the digest below holds it, letter for letter. Until 0.1.0 is
released, renew both after a change of the schema::

    sha256sum reverie_eval/server/store/migrations/versions/0001_initial_tables.py
    python -m fixtures.released_server
"""

import csv
import hashlib
import shutil
from pathlib import Path

import pytest

from fixtures.published import unpack
from fixtures.released_server import archive_of
from tests.conftest import REPOSITORY, SAMPLES
from tests.support.flat_world import Run

MIGRATIONS = REPOSITORY / "reverie_eval" / "server" / "store" / "migrations" / "versions"
FROZEN = {
    "0001_initial_tables.py": "d62bd50418fea757dc1a523281d6cdc2508fb9044d48844c32828f195d8e8255",
}
RELEASED = ("0.1.0",)


@pytest.mark.parametrize("name", FROZEN)
def test_a_released_migration_is_never_edited(name: str) -> None:
    assert hashlib.sha256((MIGRATIONS / name).read_bytes()).hexdigest() == FROZEN[name]


def rows_of(table: Path) -> list[dict[str, str]]:
    with table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("version", RELEASED)
def test_the_folder_of_a_released_version_works_on(version: str, tmp_path: Path, run: Run) -> None:
    unpack(archive_of(version), tmp_path)
    server, then, now = tmp_path / "server", tmp_path / "tables", tmp_path / "now"
    folder, written = str(server), str(now)
    for words in (
        ("upgrade", folder),
        ("doctor", "--quick", folder),
        ("doctor", folder),
        ("export", "tables", folder, "-o", written),
    ):
        outcome = run("server", *words)
        assert outcome.status == 0, outcome.err
    for table in then.glob("*.csv"):
        former, current = rows_of(table), rows_of(now / table.name)
        # A later version may have more columns, not other values.
        assert [{**row, **old} for row, old in zip(current, former, strict=True)] == current

    copy = shutil.copy(SAMPLES / "good.json", tmp_path)
    who = ["--split", "val_unseen", "--team", "Blue", "--person", "Ada"]
    again = run("server", "submit", str(server), copy, *who, "--received", "2026-11-02T12:00:00Z")
    (known,) = (row for row in rows_of(then / "results.csv") if row["team"] == "Blue")
    assert f"submission {known['submission_id']} of Blue: good" in again.out
