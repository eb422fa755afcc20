"""Folders that appear complete or not at all, and files that nobody else may read."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from reverie_eval.files import (
    is_private,
    made_folder,
    replacing_folder,
    staged_file,
    staged_folder,
)
from tests.conftest import SAMPLES


def test_a_new_folder_appears_at_once(tmp_path: Path) -> None:
    place = tmp_path / "deep" / "place"
    with staged_folder(place) as staging:
        (staging / "a").touch()
        assert not place.exists()
    assert [path.name for path in place.iterdir()] == ["a"]
    assert [path.name for path in place.parent.iterdir()] == ["place"]


def test_an_existing_folder_is_filled_at_the_end(tmp_path: Path) -> None:
    """It may be a shell's working directory or a mounted disk, so it is not replaced."""
    before = tmp_path.stat().st_ino
    with staged_folder(tmp_path) as staging:
        (staging / "a").touch()
        assert [path.name[0] for path in tmp_path.iterdir()] == ["."]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert tmp_path.stat().st_ino == before


@pytest.mark.parametrize("is_new", [True, False])
def test_an_interrupted_write_leaves_nothing(tmp_path: Path, *, is_new: bool) -> None:
    place = tmp_path / "deep" / "place" if is_new else tmp_path
    with pytest.raises(KeyboardInterrupt), staged_folder(place) as staging:
        _begin(staging)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(KeyboardInterrupt), replacing_folder(tmp_path / "deep" / "other") as staging:
        _begin(staging)
    assert list(tmp_path.iterdir()) == []


def _begin(staging: Path) -> None:
    (staging / "a").touch()
    raise KeyboardInterrupt


@pytest.mark.parametrize("make", [staged_folder, replacing_folder])
def test_an_error_names_the_folder_instead_of_the_hidden_one(
    make: Callable[[Path], AbstractContextManager[Path]], tmp_path: Path
) -> None:
    place = tmp_path / ("a" * 255)  # the hidden one's name is longer
    with pytest.raises(OSError, match="too long") as caught, make(place):
        pass
    assert caught.value.filename == str(place)


def test_a_folder_that_cannot_be_made_leaves_none_above_it(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="too long"), made_folder(tmp_path / "a" / "b" / ("c" * 300)):
        pass
    assert list(tmp_path.iterdir()) == []


def test_the_last_entry_is_moved_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    moved: list[str] = []
    monkeypatch.setattr(Path, "rename", lambda part, _: moved.append(part.name))
    with staged_folder(tmp_path, last="b") as staging:
        for name in "abc":
            (staging / name).touch()
    assert sorted(moved[:2]) == ["a", "c"]
    assert moved[2:] == ["b"]


@pytest.mark.parametrize(("mode", "others"), [(0o777, 0o007), (0o700, 0)])
def test_permissions_of_a_new_folder(mode: int, others: int, tmp_path: Path) -> None:
    place, usual = tmp_path / "place", tmp_path / "usual"
    usual.mkdir()
    with staged_folder(place, mode=mode):
        pass
    assert place.stat().st_mode & 0o007 == usual.stat().st_mode & others


@pytest.mark.parametrize("is_new", [True, False])
def test_a_folder_is_replaced_as_a_whole(tmp_path: Path, *, is_new: bool) -> None:
    place = tmp_path / "deep" / "place"
    if not is_new:
        place.mkdir(parents=True)
        (place / "old").touch()
    with replacing_folder(place) as staging:
        (staging / "new").touch()
        assert (place / "old").exists() is not is_new
    assert [path.name for path in place.iterdir()] == ["new"]
    assert [path.name for path in place.parent.iterdir()] == ["place"]


def test_a_folder_is_kept_if_its_replacement_is_interrupted(tmp_path: Path) -> None:
    (tmp_path / "place" / "old").mkdir(parents=True)
    with pytest.raises(KeyboardInterrupt), replacing_folder(tmp_path / "place") as staging:
        _begin(staging)
    assert [path.name for path in (tmp_path / "place").iterdir()] == ["old"]
    assert [path.name for path in tmp_path.iterdir()] == ["place"]


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        pytest.param(0o600, True, id="the owner may read and write it"),
        pytest.param(0o700, True, id="and run it"),
        pytest.param(0o640, False, id="its group may read it"),
        pytest.param(0o604, False, id="everybody may read it"),
        pytest.param(0o602, False, id="everybody may write it"),
    ],
)
def test_a_file_is_private_if_only_its_owner_may_use_it(
    mode: int, tmp_path: Path, *, expected: bool
) -> None:
    file = tmp_path / "file"
    file.touch()
    file.chmod(mode)
    assert is_private(file) is expected


@pytest.mark.skipif(os.geteuid() != 0, reason="only an administrator can give files away")
def test_a_file_that_an_administrator_replaces_stays_that_of_the_service(tmp_path: Path) -> None:
    place = tmp_path / "answers"
    place.write_text("old")
    place.chmod(0o600)
    os.chown(place, 12345, 12346)
    with staged_file(place) as file:
        file.write(b"new")
    status = place.stat()
    assert (status.st_uid, status.st_gid, status.st_mode & 0o777) == (12345, 12346, 0o600)
    assert place.read_bytes() == b"new"


@pytest.mark.parametrize(
    ("words", "most"),
    [
        # The system names no file whose writing failed, and the copied one where copying failed.
        ([str(SAMPLES / "good.json"), "--split", "val_unseen", "-o", "made"], 100),
        (["demo", "made"], 100),
        (["demo", "made"], 120_000),
        (["server", "init", "made"], 100),
    ],
    ids=["file", "unpacked", "copied", "server"],
)
def test_what_there_is_no_space_for_is_named(words: list[str], most: int, tmp_path: Path) -> None:
    written = subprocess.run(
        [sys.executable, "-m", "reverie_eval_cli", *words],
        cwd=tmp_path,
        # The largest file that it may write, in bytes.
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert written.stderr == "reverie-eval: made: File too large\n"
    assert (written.returncode, list(tmp_path.iterdir())) == (2, [])
