"""Archives that are not complete backups are rejected, and nothing is left of them."""

import io
import json
import random
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from reverie_eval.server.operations.restore import BackupError, restore_backup
from tests.support.flat import Run
from tests.support.kept import faults, rows_of


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
    ],
)
def test_what_would_reach_outside_is_refused(
    evil: tuple[tarfile.TarInfo, bytes], archive: Path, tmp_path: Path
) -> None:
    evil[0].name = evil[0].name.replace("/ABSOLUTE", str(tmp_path))
    rewritten(archive, lambda members: members.insert(0, evil))
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


def test_a_folder_with_something_in_it_is_left_alone(
    archive: Path, tmp_path: Path, run: Run
) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "thesis.tex").touch()
    outcome = run("server", "restore", str(archive), str(tmp_path / "there"))
    assert (outcome.status, outcome.out) == (1, "")
    assert "is not empty; choose a new or an empty folder" in outcome.err
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["thesis.tex"]
