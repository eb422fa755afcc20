"""Backups: made at any moment, whole or refused, and the same server wherever they are restored."""

import sqlite3
import stat
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from threading import Event
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select, text

from reverie_eval.schemas.organising import NewMerge
from reverie_eval.server.accounts.people import merge_teams, person_named
from reverie_eval.server.accounts.personal_data import delete_person
from reverie_eval.server.opening import acting
from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.folder import DatabaseTakenError
from reverie_eval.server.operations.restore import restore_backup
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.dump import RowsError, dump, load
from reverie_eval.server.store.tables import Base
from reverie_eval.server.store.uploads import open_uploads
from tests.support.acting import add_team
from tests.support.flat_world import Run
from tests.support.processes import TOKEN, Laptop
from tests.support.server_data import faults, rows_of
from tests.support.serving import GOOD, NO_TLS, OTHER, OWNER, Serving
from tests.support.waiting import PATIENCE

MANY = {"REVERIE_EVAL_LIMITS__REQUESTS_PER_MINUTE": "1000000"}


# While it serves.


def test_a_backup_in_a_stream_of_uploads_is_a_moment_that_was(tmp_path: Path) -> None:
    laptop = Laptop(tmp_path)
    sent: list[str] = []
    published: list[str] = []
    stop = Event()

    def send(thread: int) -> None:
        for serial in range(10_000):
            if stop.is_set():
                return
            content = GOOD + b" " * (1 + 4 * serial + thread)
            reply = server.upload(token, "val_seen" if thread == 9 else "val_unseen", content)
            assert reply.status_code == 201, reply.text
            sent.append(reply.json()["submission"]["id"])

    def publish() -> None:
        while not stop.wait(0.01):
            if len(published) < len(sent):
                path = f"{server.url}/api/v1/submissions/{sent[len(published)]}"
                headers = {"Authorization": f"Bearer {token}"}
                changed = httpx.patch(
                    path, json={"published": True}, headers=headers, timeout=PATIENCE, verify=NO_TLS
                )
                assert changed.status_code == 200, changed.text
                published.append(sent[len(published)])

    quota = "{ day = 100000, month = 100000, year = 100000 }"
    token = TOKEN.findall(laptop.run("server", "init", "lab").out)[0]
    settings = tmp_path / "lab" / "reverie-eval.toml"
    head, split, rest = settings.read_text().partition("[splits.val_unseen]\n")
    settings.write_text(f"{head}{split}quota = {quota}\n{rest}")
    with laptop.serving("lab", variables=MANY) as server, ThreadPoolExecutor(4) as pool:
        streams = [pool.submit(send, thread) for thread in range(3)]
        streams.append(pool.submit(publish))
        try:
            while len(published) < 5 and not any(stream.done() for stream in streams):
                stop.wait(0.01)
            there_before, shown_before = set(sent), list(published)
            laptop.run("server", "backup", "lab", "-o", "lab.tar.gz")
            at_the_end = len(sent)
            while len(sent) < at_the_end + 5 and not any(stream.done() for stream in streams):
                stop.wait(0.01)
        finally:
            stop.set()
        for stream in streams:
            stream.result()
    laptop.run("server", "restore", "lab.tar.gz", "elsewhere")

    restored = [row for table, row in rows_of(tmp_path / "elsewhere") if table == "submission"]
    known = {row["id"] for row in restored}
    assert there_before <= known < set(sent)
    shown = {row["id"] for row in restored if row["published_at"]}
    assert set(shown_before) <= shown
    assert shown == set(published[: len(shown)])
    assert faults(tmp_path / "elsewhere") == []
    with laptop.serving("elsewhere") as server:
        board = server.get("/splits/val_unseen/leaderboard").json()["rows"]
    assert {row["submission_id"] for row in board} <= shown


def test_rows_are_read_as_they_were_at_one_moment(server_on: Serving) -> None:
    server_on.upload(OWNER)
    expected = list(dump(server_on.state.database))
    reading = dump(server_on.state.database)
    read = [next(reading)]
    assert server_on.upload(OWNER, server_on.distinct()).status_code == 201
    assert [*read, *reading] == expected


# From one database, and one store, to another.


def test_a_server_moves_between_databases(
    used: Path, archive: Path, empty_database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = rows_of(used)
    assert len(original) > 20
    with monkeypatch.context() as there:
        there.setenv("REVERIE_EVAL_DATABASE", empty_database)
        restore_backup(archive, tmp_path / "there")
        assert rows_of(tmp_path / "there") == original
        assert faults(tmp_path / "there") == []
        with acting(load_settings(tmp_path / "there"), "test") as transaction:
            add_team(transaction, "Newcomers")
        write_backup(tmp_path / "there", tmp_path / "again.tar.gz")
    restore_backup(tmp_path / "again.tar.gz", tmp_path / "back")
    returned = rows_of(tmp_path / "back")
    assert [row for row in original if row not in returned] == []
    assert {table for table, _ in (row for row in returned if row not in original)} == {
        "team",
        "audit",
    }
    assert faults(tmp_path / "back") == []


@pytest.mark.parametrize("pair", [("Blue", "Red"), ("Red", "Blue")], ids=["older", "newer"])
def test_merged_teams_move_to_another_database(
    pair: tuple[str, str], used: Path, empty_database: str, tmp_path: Path
) -> None:
    with acting(load_settings(used), "test") as transaction:
        merge_teams(transaction, NewMerge(team=pair[0], into=pair[1]))
    rows = rows_of(used)
    with closing(Database(empty_database)) as database:
        load(database, "0001", rows)
        assert list(dump(database)) == rows


def test_rows_may_come_in_any_order(used: Path, empty_database: str) -> None:
    rows = rows_of(used)
    with closing(Database(empty_database)) as database:
        load(database, "0001", reversed(rows))
        assert list(dump(database)) == rows


def test_new_rows_follow_those_that_were_loaded(
    used: Path, postgresql: Callable[[], str], tmp_path: Path
) -> None:
    with closing(Database(postgresql())) as database:
        load(database, "0001", rows_of(used))
        with database.reading() as session:
            for table in Base.metadata.sorted_tables:
                sequence = session.scalar(
                    text("SELECT pg_get_serial_sequence(:table, :key)"),
                    {"table": table.name, "key": next(iter(table.primary_key)).name},
                )
                if sequence is not None:
                    highest = session.scalar(select(func.max(table.c.id))) or 0
                    following = session.scalar(text(f"SELECT nextval('{sequence}')"))
                    assert (table.name, following) == (table.name, highest + 1)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        pytest.param({"merged_into_id": 999}, "missing row|violates foreign key", id="reference"),
        pytest.param({"name": None}, "(?i)not.null", id="empty name"),
        pytest.param({"colour": "blue"}, "rows of team are not stored as they were", id="column"),
        pytest.param({"created_at": "once"}, "isoformat", id="time"),
    ],
)
def test_rows_that_cannot_be_stored_are_refused(
    spoil: dict[str, Any], said: str, used: Path, empty_database: str
) -> None:
    rows = [(table, row | spoil if table == "team" else row) for table, row in rows_of(used)]
    with closing(Database(empty_database)) as database:
        with pytest.raises(RowsError, match=said) as caught:
            load(database, "0001", rows)
        assert "\n" not in str(caught.value)
        assert database.revision() is None


def test_a_server_moves_to_another_store(
    archive: Path, used: Path, bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REVERIE_EVAL_UPLOADS", f"s3://{bucket}/lab")
    restore_backup(archive, tmp_path / "there")
    assert not (tmp_path / "there" / "uploads").exists()
    assert faults(tmp_path / "there") == []
    write_backup(tmp_path / "there", tmp_path / "again.tar.gz")
    monkeypatch.delenv("REVERIE_EVAL_UPLOADS")
    restore_backup(tmp_path / "again.tar.gz", tmp_path / "back")
    names = [sorted(open_uploads("uploads", at).names()) for at in (used, tmp_path / "back")]
    assert names[0] == names[1] != []


def test_a_database_that_is_in_use_is_left_alone(
    archive: Path, database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", database)
    with pytest.raises(DatabaseTakenError, match="database: is not empty"):
        restore_backup(archive, tmp_path / "there")
    assert not (tmp_path / "there").exists()


# What is in one.


def test_only_the_owner_can_read_a_backup_and_what_it_becomes(
    archive: Path, tmp_path: Path
) -> None:
    assert stat.S_IMODE(archive.stat().st_mode) == 0o600
    restore_backup(archive, tmp_path / "there")
    assert stat.S_IMODE((tmp_path / "there").stat().st_mode) == 0o700
    files = [path for path in (tmp_path / "there").rglob("*") if path.is_file()]
    assert len(files) >= 7
    assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}


def test_everything_is_in_it(archive: Path, used: Path, tmp_path: Path) -> None:
    restore_backup(archive, tmp_path / "there")
    kept = {
        path.relative_to(used): path.read_bytes()
        for path in used.rglob("*")
        if path.is_file() and not path.name.startswith("server.db")
    }
    restored = {path: (tmp_path / "there" / path).read_bytes() for path in kept}
    assert restored == kept
    assert rows_of(tmp_path / "there") == rows_of(used)


def test_what_the_command_says(used: Path, tmp_path: Path, run: Run) -> None:
    archive, there = tmp_path / "b.tar.gz", tmp_path / "there"
    made = run("server", "backup", str(used), "-o", str(archive))
    assert (made.status, made.err) == (0, "")
    assert f"{archive}: 3 submissions, 3 teams, 4 people, " in made.out
    assert "keep it where nobody else can read it" in made.out
    restored = run("server", "restore", str(archive), str(there))
    assert restored.status == 0
    assert f"{there}: restored, 3 submissions, 3 teams, 4 people" in restored.out


def test_deleted_people_and_merged_teams_are_not_counted(
    used: Path, tmp_path: Path, run: Run
) -> None:
    archive, there = tmp_path / "b.tar.gz", tmp_path / "there"
    with acting(load_settings(used), "test") as transaction:
        add_team(transaction, "Pair")
        merge_teams(transaction, NewMerge(team="Pair", into="Red"))
        delete_person(transaction, person_named(transaction.session, OTHER).id)
    made = run("server", "backup", str(used), "-o", str(archive))
    assert f"{archive}: 3 submissions, 3 teams, 3 people, " in made.out
    restored = run("server", "restore", str(archive), str(there))
    assert f"{there}: restored, 3 submissions, 3 teams, 3 people" in restored.out
    assert rows_of(there) == rows_of(used)


def test_missing_uploads_are_named_and_the_rest_is_kept(
    used: Path, tmp_path: Path, run: Run
) -> None:
    lost, *_ = sorted((used / "uploads").rglob("*.json.gz"))
    lost.write_bytes(b"[]")
    made = run("server", "backup", str(used), "-o", str(tmp_path / "b.tar.gz"))
    assert made.status == 1
    assert f"1 upload missing or damaged, and not in the backup: {lost.name[:64]}" in made.err
    restore_backup(tmp_path / "b.tar.gz", tmp_path / "there")
    (fault,) = faults(tmp_path / "there")
    assert lost.name in fault


def test_files_from_elsewhere_come_into_the_folder(used: Path, tmp_path: Path, run: Run) -> None:
    elsewhere = tmp_path / "answers.npz"
    (used / "bundles" / "test.npz").rename(elsewhere)
    settings = used / "reverie-eval.toml"
    settings.write_text(settings.read_text().replace('"bundles/test.npz"', f'"{elsewhere}"'))
    made = run("server", "backup", str(used), "-o", str(tmp_path / "b.tar.gz"))
    assert "splits.test.bundle is outside of the folder; a restore puts it at" in made.err
    content = elsewhere.read_bytes()
    elsewhere.unlink()
    restored = run("server", "restore", str(tmp_path / "b.tar.gz"), str(tmp_path / "there"))
    assert restored.status == 0
    now = "outside the folder; it is now bundles/test.npz"
    assert f"splits.test.bundle was {elsewhere}, {now}" in restored.err
    assert (tmp_path / "there" / "bundles" / "test.npz").read_bytes() == content


def test_files_keep_their_names_wherever_the_settings_say_they_are(
    used: Path, tmp_path: Path, run: Run
) -> None:
    """By an absolute path, in other folders, and by a name that another file from outside takes."""
    (used / "truth").mkdir()
    (used / "data").mkdir()
    (used / "server.db").rename(used / "data" / "main.db")
    (used / "signing-key.pem").rename(used / "truth" / "key.pem")
    (used / "bundles" / "test.npz").rename(tmp_path / "test.npz")
    (used / "bundles" / "val_seen.npz").rename(used / "bundles" / "test.npz")
    settings = used / "reverie-eval.toml"
    text = settings.read_text()
    for old, new in (
        ("server.db", "data/main.db"),
        ("signing-key.pem", f"{used}/truth/key.pem"),
        ("bundles/test.npz", f"{tmp_path}/test.npz"),
        ("bundles/val_seen.npz", "./bundles/test.npz"),
    ):
        text = text.replace(f'{old}"', f'{new}"')
    settings.write_text(text)
    rows, there = rows_of(used), tmp_path / "there"
    made = run("server", "backup", str(used), "-o", str(tmp_path / "b.tar.gz"), "--verify")
    assert made.status == 0, made.err
    used.rename(tmp_path / "gone")
    restored = run("server", "restore", str(tmp_path / "b.tar.gz"), str(there))
    assert restored.status == 0, restored.out
    assert (there / "data" / "main.db").is_file()
    assert rows_of(there) == rows
    assert faults(there) == []
    assert (there / "bundles" / "test-2.npz").read_bytes() == (tmp_path / "test.npz").read_bytes()


# Verified.


VERIFIED = "verified: it was restored, all rows and files are the same, and the server opens"


def test_a_backup_is_verified_in_a_place_of_its_own(
    used: Path, database: str, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "backups").mkdir()
    words = ("server", "backup", str(used), "-o", str(tmp_path / "backups" / "b.tar.gz"))
    assert VERIFIED not in run(*words).out
    monkeypatch.setenv("REVERIE_EVAL_DATABASE", database)
    monkeypatch.setenv("REVERIE_EVAL_UPLOADS", str(tmp_path / "none"))
    rows = rows_of(used)
    made = run(*words, "--verify")
    assert (made.status, VERIFIED in made.out.splitlines()) == (0, True)
    assert rows_of(used) == rows
    assert [path.name for path in (tmp_path / "backups").iterdir()] == ["b.tar.gz"]
    assert not (tmp_path / "none").exists()


def lose_a_team(folder: Path) -> None:
    with closing(sqlite3.connect(folder / "server.db")) as database, database:
        database.execute("DELETE FROM team WHERE name = 'Blue'")


def cut_a_bundle_off(folder: Path) -> None:
    bundle = folder / "bundles" / "test.npz"
    bundle.write_bytes(bundle.read_bytes()[:1000])


def spoil_a_result(folder: Path) -> None:
    with closing(sqlite3.connect(folder / "server.db")) as database, database:
        database.execute("UPDATE submission SET report = '{}' WHERE published_at IS NOT NULL")


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        pytest.param(
            lose_a_team,
            "database.jsonl: its rows cannot be restored (rows of person, submission refer to "
            "missing rows)",
            id="team",
        ),
        pytest.param(cut_a_bundle_off, "server: settings rejected", id="bundle"),
        pytest.param(spoil_a_result, "stored value cannot be read", id="result"),
    ],
)
def test_a_backup_that_does_not_restore_is_not_kept(
    spoil: Callable[[Path], None], told: str, used: Path, tmp_path: Path, run: Run
) -> None:
    spoil(used)
    output = tmp_path / "backups" / "b.tar.gz"
    output.parent.mkdir()
    output.write_text("the one before")
    made = run("server", "backup", str(used), "-o", str(output), "--verify")
    assert (made.status, made.out) == (1, "")
    assert told in made.err
    assert f"{output} was not written: the backup does not restore" in made.err
    assert f"`reverie-eval server doctor {used}` may say why" in made.err
    assert output.read_text() == "the one before"
    assert [path.name for path in output.parent.iterdir()] == [output.name]


@pytest.mark.parametrize(
    ("output", "told"),
    [
        pytest.param("server/b.tar.gz", "is in the server's folder", id="in the folder"),
        pytest.param("nowhere/b.tar.gz", "an existing folder", id="no folder"),
        pytest.param(".", "cannot be written", id="a folder"),
        pytest.param("answers.npz", "is a file of the server", id="over what it backs up"),
    ],
)
def test_where_no_backup_is_written(
    output: str, told: str, folder: Path, tmp_path: Path, run: Run
) -> None:
    (folder / "bundles" / "test.npz").rename(tmp_path / "answers.npz")
    settings = folder / "reverie-eval.toml"
    settings.write_text(settings.read_text().replace('"bundles/test.npz"', '"../answers.npz"'))
    before = (tmp_path / "answers.npz").read_bytes()
    outcome = run("server", "backup", str(folder), "-o", str(tmp_path / output))
    assert (outcome.status, outcome.out) == (2, "")
    assert told in outcome.err
    assert (tmp_path / "answers.npz").read_bytes() == before


def test_a_backup_that_fails_leaves_the_one_before(used: Path, tmp_path: Path, run: Run) -> None:
    (tmp_path / "b.tar.gz").write_text("the one before")
    (used / "signing-key.pem").unlink()
    assert run("server", "backup", str(used), "-o", str(tmp_path / "b.tar.gz")).status == 2
    assert (tmp_path / "b.tar.gz").read_text() == "the one before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.tar.gz", "server"]
