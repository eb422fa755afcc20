"""Uploads are kept whole or not at all, in a folder and in an S3-compatible store."""

import hashlib
import os
import resource
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Event

import pytest

from reverie_eval.server.store import uploads as uploads_module
from reverie_eval.server.store.uploads import (
    PIECE,
    FolderUploads,
    S3Uploads,
    Uploads,
    UploadsError,
    name_of,
    open_uploads,
    pack,
    stored_pieces,
    stored_upload,
)
from tests.support.flat_world import Run
from tests.support.ports import free_port
from tests.support.serving import OTHER, OWNER, OpenServer, Serving, settings_of
from tests.support.waiting import PATIENCE, WatchedLock

CONTENT = b'[{"instr_id": "7_1_0"}]'
SHA256 = hashlib.sha256(CONTENT).hexdigest()
OTHER_SHA256 = hashlib.sha256(b"other").hexdigest()


@pytest.fixture(params=["folder", "s3", "s3 with a prefix"])
def uploads(request: pytest.FixtureRequest, tmp_path: Path) -> Uploads:
    """Return an empty store of each kind."""
    if request.param == "folder":
        return open_uploads("kept/uploads", tmp_path)
    prefix = "/a/b/" if request.param.endswith("prefix") else ""
    return open_uploads(f"s3://{request.getfixturevalue('bucket')}{prefix}", tmp_path)


def test_what_is_put_can_be_got(uploads: Uploads) -> None:
    uploads.put(SHA256, CONTENT)
    uploads.put(OTHER_SHA256, b"other")
    assert uploads.get(SHA256) == CONTENT
    assert uploads.get(OTHER_SHA256) == b"other"
    assert list(uploads.names()) == sorted([name_of(SHA256), name_of(OTHER_SHA256)])


def test_to_put_again_changes_nothing(uploads: Uploads) -> None:
    for _ in range(3):
        uploads.put(SHA256, CONTENT)
    assert uploads.get(SHA256) == CONTENT
    assert list(uploads.names()) == [name_of(SHA256)]


def test_many_may_put_the_same_at_once(uploads: Uploads) -> None:
    with ThreadPoolExecutor(16) as pool:
        list(pool.map(lambda _: uploads.put(SHA256, CONTENT), range(32)))
    assert uploads.get(SHA256) == CONTENT
    assert list(uploads.names()) == [name_of(SHA256)]


def test_what_is_large_comes_in_pieces(uploads: Uploads) -> None:
    content = CONTENT + b" " * 2 * PIECE
    uploads.put(SHA256, content)
    pieces = list(uploads.pieces(SHA256))
    assert b"".join(pieces) == content
    assert max(map(len, pieces)) == PIECE


def test_what_is_repetitive_takes_little_room(tmp_path: Path) -> None:
    FolderUploads(tmp_path).put(SHA256, CONTENT + b" " * (16 << 20))
    assert (tmp_path / name_of(SHA256)).stat().st_size < 1 << 17


def test_what_is_staged_and_not_kept_leaves_nothing(uploads: Uploads) -> None:
    with uploads.staged(SHA256, pack(CONTENT)):
        pass
    with suppress(RuntimeError), uploads.staged(OTHER_SHA256, pack(CONTENT)):
        raise RuntimeError
    assert list(uploads.names()) == []


def test_a_full_disk_is_told_with_the_upload_that_it_has_no_space_for(tmp_path: Path) -> None:
    put = f"from {uploads_module.__name__} import *; FolderUploads(Path()).put({SHA256!r}, b'[]')"
    ended = subprocess.run(
        [sys.executable, "-c", put],
        cwd=tmp_path,
        # The largest file that it may write, in bytes.
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (10, 10)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.stderr.splitlines()[-1].endswith(f"File too large: '{name_of(SHA256)}'")
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_what_is_staged_and_kept_is_there_at_once(uploads: Uploads) -> None:
    with uploads.staged(SHA256, pack(CONTENT)) as keep:
        keep()
        assert uploads.get(SHA256) == CONTENT
    assert list(uploads.names()) == [name_of(SHA256)]


def test_who_does_not_keep_takes_nothing_from_who_does(uploads: Uploads) -> None:
    with uploads.staged(SHA256, pack(CONTENT)), uploads.staged(SHA256, pack(CONTENT)) as keep:
        keep()
    assert uploads.get(SHA256) == CONTENT
    assert list(uploads.names()) == [name_of(SHA256)]


@pytest.mark.parametrize("length", [0, 5, 20, 30])
def test_a_damaged_file_is_an_error_of_reading(length: int, tmp_path: Path) -> None:
    store = FolderUploads(tmp_path)
    store.put(SHA256, CONTENT)
    (file,) = tmp_path.rglob("*.json.gz")
    file.write_bytes(file.read_bytes()[:length] + b"?" * (length > 5))
    with pytest.raises(OSError, match=r"."):
        store.get(SHA256)
    told = f"the upload {SHA256} cannot be read .*; run `reverie-eval server doctor`"
    with pytest.raises(UploadsError, match=told):
        stored_upload(store, SHA256)
    with pytest.raises(UploadsError, match=told):
        list(stored_pieces(store, SHA256))


def test_another_file_in_place_of_an_upload_is_an_error_of_reading(uploads: Uploads) -> None:
    uploads.put(SHA256, b"other")
    pieces = stored_pieces(uploads, SHA256)
    assert next(pieces) == b"other"
    with pytest.raises(UploadsError, match=f"{SHA256} is not the file that was uploaded; run"):
        next(pieces)
    with pytest.raises(UploadsError, match=f"{OTHER_SHA256} is missing; run"):
        next(stored_pieces(uploads, OTHER_SHA256))


def test_what_was_never_put_is_not_found(uploads: Uploads) -> None:
    assert list(uploads.names()) == []
    with pytest.raises(FileNotFoundError):
        uploads.get(SHA256)
    with pytest.raises(FileNotFoundError):
        uploads.pieces(SHA256)


def test_to_try_a_store_leaves_nothing_in_it(uploads: Uploads) -> None:
    uploads.try_out()
    uploads.put(SHA256, CONTENT)
    uploads.try_out()
    assert list(uploads.names()) == [name_of(SHA256)]


@pytest.mark.usefixtures("bucket")
def test_a_bucket_that_is_not_there_is_named(tmp_path: Path) -> None:
    elsewhere = open_uploads("s3://no-such-bucket", tmp_path)
    told = "s3://no-such-bucket: .* the bucket with these credentials"
    for ask in (
        elsewhere.try_out,
        lambda: elsewhere.put(SHA256, CONTENT),
        lambda: elsewhere.get(SHA256),
        lambda: list(elsewhere.names()),
    ):
        with pytest.raises(UploadsError, match=told):
            ask()


def test_an_s3_store_names_more_than_a_page(bucket: str, tmp_path: Path) -> None:
    store = open_uploads(f"s3://{bucket}", tmp_path)
    assert isinstance(store, S3Uploads)
    names = [hashlib.sha256(bytes([number, number])).hexdigest() for number in range(5)]
    for name in names:
        store.put(name, b"x")
    store._client.meta.events.register(  # noqa: SLF001  # pages are of a thousand otherwise
        "provide-client-params.s3.ListObjectsV2", lambda params, **_: {**params, "MaxKeys": 2}
    )
    assert list(store.names()) == sorted(name_of(name) for name in names)


def test_two_prefixes_of_a_bucket_are_two_stores(bucket: str, tmp_path: Path) -> None:
    first, second = (open_uploads(f"s3://{bucket}/{prefix}", tmp_path) for prefix in "ab")
    first.put(SHA256, CONTENT)
    assert list(second.names()) == []
    with pytest.raises(FileNotFoundError):
        second.get(SHA256)


def test_a_kept_file_is_its_owners_alone(tmp_path: Path) -> None:
    FolderUploads(tmp_path / "uploads").put(SHA256, CONTENT)
    (file,) = (tmp_path / "uploads").rglob("*.json.gz")
    assert file.relative_to(tmp_path) == Path("uploads") / name_of(SHA256)
    assert file.stat().st_mode & 0o777 == 0o600


class _CrashError(BaseException):
    """Stands for the end of the process."""


@pytest.mark.parametrize(
    ("owner", "step"),
    [pytest.param(os, "fsync", id="half-written"), pytest.param(Path, "replace", id="unnamed")],
)
def test_a_crash_leaves_no_half_of_a_file(
    owner: object, step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither under its name, nor in the way of the next try; what is left over is hidden."""
    uploads = FolderUploads(tmp_path)

    def crash(*_: object) -> None:
        raise _CrashError

    with monkeypatch.context() as broken:
        # A process that ends cleans up no more than a machine without power does.
        broken.setattr(Path, "unlink", lambda *_, **__: None)
        broken.setattr(owner, step, crash)
        with pytest.raises(_CrashError):
            uploads.put(SHA256, CONTENT)
    with pytest.raises(FileNotFoundError):
        uploads.get(SHA256)
    assert name_of(SHA256) not in uploads.names()
    uploads.put(SHA256, CONTENT)
    assert uploads.get(SHA256) == CONTENT


def test_a_write_that_fails_leaves_nothing_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    uploads = FolderUploads(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    uploads.put(OTHER_SHA256, b"other")
    with monkeypatch.context() as broken:
        broken.setattr(Path, "replace", full)
        with pytest.raises(OSError, match="No space"):
            uploads.put(SHA256, CONTENT)
    assert list(uploads.names()) == [name_of(OTHER_SHA256)]


def test_a_file_and_every_new_folder_is_written_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Content first, then the name; of a new folder, its name in the one above."""
    done: list[Path] = []
    fsync, replace = os.fsync, Path.replace

    def note_fsync(handle: int) -> None:
        done.append(Path(f"/proc/self/fd/{handle}").readlink())
        fsync(handle)

    def note_replace(old: Path, new: Path) -> None:
        done.append(new)
        replace(old, new)

    monkeypatch.setattr(os, "fsync", note_fsync)
    monkeypatch.setattr(Path, "replace", note_replace)
    uploads = FolderUploads(tmp_path / "a" / "uploads")
    uploads.put(SHA256, CONTENT)
    folder = tmp_path / "a" / "uploads" / SHA256[:2]
    temporary = done[3]
    assert temporary.parent == folder
    named = tmp_path / "a" / "uploads" / name_of(SHA256)
    assert done == [tmp_path, tmp_path / "a", folder.parent, temporary, named, folder]
    done.clear()
    uploads.put(SHA256, CONTENT)  # another's name may not be on the disk yet
    assert done[1:] == [named, folder]


def test_a_new_folder_is_written_through_before_another_upload_uses_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a power cut could take the folder with an upload that has been answered."""
    folder, early = FolderUploads(tmp_path / "uploads"), list[bool]()
    made, came, written = Event(), Event(), Event()
    sync_folder = uploads_module._sync_folder  # noqa: SLF001

    def sync(path: Path) -> None:
        if path == folder.folder and not made.is_set():
            made.set()
            assert came.wait(PATIENCE)
            sync_folder(path)
            written.set()
        else:
            sync_folder(path)

    def note(_: object) -> None:
        early.append(not written.is_set())
        came.set()

    monkeypatch.setattr(folder, "_making", WatchedLock(came))
    monkeypatch.setattr(uploads_module, "_sync_folder", sync)
    beside = SHA256[:2] + OTHER_SHA256[2:]  # in the same folder
    with ThreadPoolExecutor(2) as pool:
        pool.submit(folder.put, SHA256, CONTENT)
        assert made.wait(PATIENCE)
        pool.submit(folder.put, beside, b"other").add_done_callback(note)
    assert early == [False]
    assert sorted(folder.names()) == sorted([name_of(SHA256), name_of(beside)])


# A server with a store that is away.


@pytest.fixture
def without_store(
    folder: Path, bucket: str, open_server: OpenServer, monkeypatch: pytest.MonkeyPatch
) -> Serving:
    """Return a server with two uploads in an S3-compatible store that does not answer any more."""
    monkeypatch.setenv("REVERIE_EVAL_UPLOADS", f"s3://{bucket}")
    settings = settings_of(folder).model_copy(update={"uploads": f"s3://{bucket}"})
    server = open_server(settings)
    for _ in range(2):
        assert server.upload(OWNER, server.distinct()).status_code == 201
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", f"http://127.0.0.1:{free_port()}")
    return open_server(settings, server.tokens)


def test_a_store_that_does_not_answer_takes_no_upload_and_says_when_to_try_again(
    without_store: Serving,
) -> None:
    refused = without_store.upload(OTHER)
    assert refused.status_code == 503, refused.text
    assert refused.json()["code"] == "store-down"
    assert refused.headers["Retry-After"] == "10"
    assert "no file is counted twice" in refused.json()["detail"]
    assert without_store.ask(OTHER, "GET", "/submissions").json() == []


def test_a_store_that_does_not_answer_is_one_fault_and_not_one_of_each_upload(
    without_store: Serving, folder: Path, run: Run
) -> None:
    checked = run("server", "doctor", str(folder))
    assert checked.status == 1
    assert checked.out.count("fault   0 of 2 uploads intact; then s3://") == 1
    assert "from a backup" not in checked.out, checked.out
