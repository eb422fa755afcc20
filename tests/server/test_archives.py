"""Archives that are not complete backups are rejected, and nothing is left of them."""

import hashlib
import io
import json
import os
import random
import re
import tarfile
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from reverie_eval.server.operations.backup import write_backup
from reverie_eval.server.operations.restore import BackupError, restore_backup
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.uploads import open_uploads
from tests.support.flat_world import Run
from tests.support.server_data import faults, rows_of


def refused(archive: Path, folder: Path, told: str) -> None:
    """Restoring leaves nothing behind and says why."""
    before = sorted(folder.parent.iterdir())
    with pytest.raises(BackupError, match=told) as caught:
        restore_backup(archive, folder)
    assert all("\n" not in problem.message for problem in caught.value.problems)
    assert sorted(folder.parent.iterdir()) == before


@pytest.mark.parametrize("share", [0, 0.001, 0.1, 0.5, 0.9, 0.99])
def test_what_is_cut_off_is_refused(share: float, archive: Path, tmp_path: Path) -> None:
    content = archive.read_bytes()
    archive.write_bytes(content[: int(share * len(content))])
    refused(archive, tmp_path / "there", "not a complete backup|is missing")


def test_a_changed_byte_is_refused_or_changes_nothing(
    archive: Path, used: Path, tmp_path: Path
) -> None:
    content, chosen = archive.read_bytes(), random.Random(5)
    original, refusals = rows_of(used), 0
    for number in range(60):
        changed = bytearray(content)
        changed[chosen.randrange(len(content))] ^= 1 << chosen.randrange(8)
        archive.write_bytes(changed)
        there = tmp_path / f"there-{number}"
        try:
            restore_backup(archive, there)
        except BackupError:
            refusals += 1
            assert not there.exists()
        else:
            assert rows_of(there) == original
            assert faults(there) == []
    assert refusals > 50


def test_what_is_no_archive_is_refused(tmp_path: Path, run: Run) -> None:
    (tmp_path / "notes.txt").write_text("not an archive")
    outcome = run("server", "restore", str(tmp_path / "notes.txt"), str(tmp_path / "there"))
    assert (outcome.status, outcome.out) == (1, "")
    assert "is not a complete backup (not a gzip file); use another" in outcome.err


def member(name: str, content: bytes = b"", **attributes: Any) -> tuple[tarfile.TarInfo, bytes]:
    """Return a member of an archive."""
    info = tarfile.TarInfo(name)
    info.size = len(content)
    for attribute, value in attributes.items():
        setattr(info, attribute, value)
    return info, content


Members = list[tuple[tarfile.TarInfo, bytes]]


def rewritten(archive: Path, change: Callable[[Members], object]) -> None:
    """Change the members of an archive."""
    with tarfile.open(archive) as old:
        contents: Members = []
        for info in old:
            file = old.extractfile(info)
            assert file is not None
            contents.append((info, file.read()))
    change(contents)
    with tarfile.open(archive, "w:gz", compresslevel=1) as new:
        for info, content in contents:
            info.size = len(content)
            new.addfile(info, io.BytesIO(content))


@pytest.mark.parametrize(
    "evil",
    [
        member("../evil", b"x"),
        member("bundles/../../evil", b"x"),
        member("uploads/../../../evil", b"x"),
        member("/ABSOLUTE/evil", b"x"),
        member("evil", type=tarfile.SYMTYPE, linkname="/etc/passwd"),
        member("evil", type=tarfile.LNKTYPE, linkname="reverie-eval.toml"),
        member("evil", type=tarfile.FIFOTYPE),
        member("evil", type=tarfile.DIRTYPE),
        member("./evil"),
        member("bundles//evil"),
        member("bundles/../evil"),
        member("reverie-eval.toml/evil"),
        member("uploads/"),
        member("evil" * 100),
        member("evil\n"),
        member("evil\udcff"),
    ],
    ids=[
        "up",
        "up from within",
        "up from uploads",
        "absolute",
        "symlink",
        "link",
        "pipe",
        "folder",
        "dot",
        "two slashes",
        "there and back",
        "below a file",
        "a folder's name",
        "long",
        "two lines",
        "no text",
    ],
)
def test_what_would_reach_outside_is_refused(
    evil: tuple[tarfile.TarInfo, bytes], archive: Path, tmp_path: Path
) -> None:
    evil[0].name = evil[0].name.replace("/ABSOLUTE", str(tmp_path))
    rewritten(archive, lambda members: members.insert(1, evil))
    refused(archive, tmp_path / "there", "does not belong in one")
    assert not list(tmp_path.rglob("*evil*"))


def position(members: Members, name: str) -> int:
    """Return where a member is."""
    return next(i for i, (info, _) in enumerate(members) if info.name.startswith(name))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        pytest.param(
            lambda members: members.pop(position(members, "uploads/")),
            r"uploads/\w+\.json: is missing",
            id="upload left out",
        ),
        pytest.param(
            lambda members: members.pop(position(members, "database.jsonl")),
            "database.jsonl: is missing",
            id="database left out",
        ),
        pytest.param(
            lambda members: members.pop(position(members, "manifest.json")),
            "there is no valid manifest.json",
            id="manifest left out",
        ),
        pytest.param(
            lambda members: members.insert(0, member("further", b"x")),
            "further: differs from what was backed up",
            id="something slipped in",
        ),
        pytest.param(
            lambda members: members.append(member("signing-key.pem", b"x")),
            "signing-key.pem: differs from what was backed up",
            id="something replaced",
        ),
        pytest.param(
            lambda members: members.append(member("manifest.json", b"{}")),
            "there is no valid manifest.json",
            id="manifest that is none",
        ),
        pytest.param(
            lambda members: members.append(
                member("manifest.json", b'{"format": 2, "version": "9.0", "contents": []}')
            ),
            "was made by reverie-eval 9.0; install that version or a later one",
            id="later format",
        ),
        pytest.param(
            lambda members: members.append(
                member(
                    "manifest.json",
                    json.dumps(
                        json.loads(members[position(members, "manifest.json")][1])
                        | {"revision": "9999", "version": "0.9"}
                    ).encode(),
                )
            ),
            "was made by reverie-eval 0.9",
            id="later tables",
        ),
    ],
)
def test_what_is_not_what_was_written_is_refused(
    change: Callable[[Members], object], told: str, archive: Path, tmp_path: Path
) -> None:
    rewritten(archive, change)
    refused(archive, tmp_path / "there", told)


def adjusted(archive: Path, contents: Mapping[str, bytes], **changes: object) -> None:
    """Put other contents into an archive, with a manifest that says so."""

    def change(members: Members) -> None:
        manifest = json.loads(members.pop()[1])
        for name, content in contents.items():
            if name in manifest["sha256"]:
                members.pop(position(members, name))
            members.append(member(name, content))
            manifest["sha256"][name] = hashlib.sha256(content).hexdigest()
        members.append(member("manifest.json", json.dumps(manifest | changes).encode()))

    rewritten(archive, change)


@pytest.mark.parametrize(
    ("contents", "told"),
    [
        pytest.param({"server.db": b""}, "server.db: does not belong in a backup", id="database"),
        pytest.param({"uploads/x.json": b"[]"}, "uploads/x.json: does not belong", id="upload"),
        pytest.param({f"uploads/{'0' * 64}.json": b"[]"}, "0.json: differs", id="other upload"),
        pytest.param({"database.jsonl": b'["team", {"id": 1}]'}, "cannot be restored", id="row"),
        pytest.param({"database.jsonl": b'["evil", {}]'}, "cannot be restored", id="table"),
        pytest.param({"database.jsonl": b"5\n"}, "cannot be restored", id="number"),
        pytest.param({"database.jsonl": b"{"}, "cannot be restored", id="no JSON"),
    ],
)
def test_what_no_backup_has_is_refused(
    contents: dict[str, bytes], told: str, archive: Path, tmp_path: Path
) -> None:
    adjusted(archive, contents)
    refused(archive, tmp_path / "there", told)


@pytest.mark.parametrize(
    ("files", "told"),
    [
        pytest.param({"signing_key": "../evil"}, "../evil: is missing", id="up"),
        pytest.param({}, "signing_key: is not in the backup", id="none"),
    ],
)
def test_files_that_no_backup_has_are_refused(
    files: dict[str, str], told: str, archive: Path, tmp_path: Path
) -> None:
    adjusted(archive, {}, files=files)
    refused(archive, tmp_path / "there", told)


@pytest.mark.parametrize(
    ("key", "place"),
    [
        ("database", '"sqlite:///OUTSIDE/evil.db"'),
        ("database", "'sqlite:///../evil.db'"),
        ("database", '"sqlite:///a/../../evil.db"'),
        ("uploads", '"OUTSIDE/evil"'),
        ("uploads", '"../evil"'),
        ("signing_key", '"OUTSIDE/evil.pem"'),
        ("signing_key", "'../evil.pem'"),
        ("bundle", '"OUTSIDE/evil.npz"'),
        ("bundle", '"bundles/../../evil.npz"'),
    ],
)
def test_places_outside_the_folder_are_not_used(
    key: str, place: str, archive: Path, used: Path, tmp_path: Path
) -> None:
    outside, there = tmp_path / "outside", tmp_path / "there"
    outside.mkdir()
    place = place.replace("OUTSIDE", str(outside))
    text = (used / "reverie-eval.toml").read_text()
    evil, n = re.subn(rf'(?m)^{key} = ".*"', f"{key} = {place}", text, count=1)
    assert n == 1
    adjusted(archive, {"reverie-eval.toml": evil.encode()})
    before = {*outside.iterdir(), *tmp_path.iterdir()}

    (changed,) = restore_backup(archive, there).changed
    assert (changed.setting.rpartition(".")[2], changed.before) == (key, place[1:-1])
    assert {*outside.iterdir(), *tmp_path.iterdir()} - before == {there}
    assert (there / "reverie-eval.toml").read_text() == text
    assert rows_of(there) == rows_of(used)
    assert faults(there) == []


def test_a_database_and_a_store_are_used_only_if_the_caller_names_them(
    used: Path, postgresql: Callable[[], str], bucket: str, run: Run
) -> None:
    folder, archive = used.parent, used.parent / "backup.tar.gz"
    named, mine = postgresql(), postgresql()
    text = (used / "reverie-eval.toml").read_text()
    rows = rows_of(used)
    with_password = named.replace("postgres:@", "postgres:hushhush@")
    evil = text.replace("sqlite:///server.db", with_password)
    evil = evil.replace('uploads = "uploads"', f'uploads = "s3://{bucket}/there"')
    write_backup(used, archive)
    adjusted(archive, {"reverie-eval.toml": evil.encode()})
    restored = run("server", "restore", str(archive), str(folder / "there"))
    assert restored.status == 0
    assert "set REVERIE_EVAL_DATABASE, and restore again" in restored.err
    assert "set REVERIE_EVAL_UPLOADS, and restore again" in restored.err
    assert "hushhush" not in restored.err
    assert rows_of(folder / "there") == rows
    assert list(open_uploads(f"s3://{bucket}/there", folder).names()) == []

    variables = {"REVERIE_EVAL_DATABASE": mine, "REVERIE_EVAL_UPLOADS": f"s3://{bucket}/mine"}
    with patch.dict(os.environ, variables):
        restored = run("server", "restore", str(archive), str(folder / "elsewhere"))
        assert rows_of(folder / "elsewhere") == rows
    assert restored.status == 0
    assert "restore again" not in restored.err
    assert not list((folder / "elsewhere").glob("*.db"))
    names = [
        list(open_uploads(f"s3://{bucket}/{each}", used).names()) for each in ("there", "mine")
    ]
    assert (names[0], len(names[1])) == ([], 2)
    with closing(Database(named)) as database:
        assert database.revision() is None


def test_a_place_in_a_form_that_nobody_writes_is_refused(
    archive: Path, used: Path, tmp_path: Path
) -> None:
    text = (used / "reverie-eval.toml").read_text()
    evil = text.replace('"sqlite:///server.db"', '"""sqlite:////tmp/evil.db"""')
    adjusted(archive, {"reverie-eval.toml": evil.encode()})
    refused(archive, tmp_path / "there", "database: names a place outside the folder")


def test_a_folder_with_something_in_it_is_left_alone(
    archive: Path, tmp_path: Path, run: Run
) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "thesis.tex").touch()
    outcome = run("server", "restore", str(archive), str(tmp_path / "there"))
    assert (outcome.status, outcome.out) == (1, "")
    assert "is not empty; choose a new or an empty folder" in outcome.err
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["thesis.tex"]
