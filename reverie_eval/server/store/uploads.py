"""Storage of uploads by their SHA-256, in a folder or an S3-compatible store.

They are stored compressed; the SHA-256 is that of the unpacked bytes, which every reader gets. A
file is written under another name first, and renamed in the transaction that adds its row, just
before it is committed. A crash between the two leaves an unused file, never a row without its file.
"""

import gzip
import hashlib
import os
import secrets
import typing
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile, mkstemp
from threading import Lock
from typing import Any, TypeAlias
from urllib.parse import urlsplit

from isal import igzip

from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import naming

PIECE = 256 << 10
"""Bytes of an upload that are in memory during a download."""
ENDING = ".json.gz"
"""How the names of uploads end; a file that is still being written has another name."""
_NO_UPLOAD = "0" * 64
_LEVEL = 1
"""Compresses trajectories to less than a third; level 2 gains 2 %."""

Keep: TypeAlias = Callable[[], None]
"""Gives an upload its name."""


class UploadsError(ReverieEvalError):
    """Uploads, or the store that has them, cannot be read; says why, and what to do."""


class DamagedUploadError(UploadsError):
    """An upload in a store that answers is missing, unreadable, or another file."""


class Uploads(typing.Protocol):
    """A store of uploads."""

    def staged(self, sha256: str, packed: bytes) -> AbstractContextManager[Keep]:
        """Write what :func:`pack` returned, kept by calling what is given, or leaving no trace."""

    def put(self, sha256: str, content: bytes) -> None:
        """Store an upload; storing it again changes nothing."""

    def get(self, sha256: str) -> bytes:
        """Return an upload. Raises FileNotFoundError if it is missing, OSError if it is damaged."""

    def pieces(self, sha256: str) -> Iterator[bytes]:
        """Return an upload in pieces.

        Nothing stays open between two pieces, so a reader may stop at any time.
        """

    def delete(self, sha256: str) -> None:
        """Delete an upload; deleting it again changes nothing."""

    def names(self) -> Iterator[str]:
        """Return the names of all files in order; that of an upload is :func:`name_of`."""

    def try_out(self) -> None:
        """Test whether uploads can be stored and read, without a change."""


def open_uploads(place: str, folder: Path) -> Uploads:
    """Open the store in a subfolder of the server's folder, or at ``s3://bucket/prefix``."""
    address = urlsplit(place)
    if address.scheme == "s3":
        return S3Uploads(address.netloc, address.path.strip("/"))
    return FolderUploads(folder / place)


def stored_upload(uploads: Uploads, sha256: str) -> bytes:
    """Return an upload that a row refers to.

    Raises UploadsError if the store does not answer, DamagedUploadError if the upload is damaged.
    """
    with _named(sha256):
        return uploads.get(sha256)


def stored_pieces(uploads: Uploads, sha256: str) -> Iterator[bytes]:
    """Yield an upload that a row refers to in pieces.

    Raises UploadsError if the store does not answer; DamagedUploadError, at the latest after the
    last piece, if the upload is missing, cannot be read, or is not the file that was uploaded.
    """
    digest = hashlib.sha256()
    with _named(sha256):
        for piece in uploads.pieces(sha256):
            digest.update(piece)
            yield piece
    if digest.hexdigest() != sha256:
        raise DamagedUploadError(_unusable(sha256, "is not the file that was uploaded"))


@contextmanager
def _named(sha256: str) -> Iterator[None]:
    """Turn errors of reading an upload into one that names it, and says what to do."""
    try:
        yield
    except FileNotFoundError:
        raise DamagedUploadError(_unusable(sha256, "is missing")) from None
    except (OSError, UploadsError) as error:
        kind = DamagedUploadError if isinstance(error, OSError) else UploadsError
        raise kind(_unusable(sha256, f"cannot be read ({error})")) from error


def _unusable(sha256: str, why: str) -> str:
    return f"the upload {sha256} {why}; run `reverie-eval server doctor`"


def name_of(sha256: str) -> str:
    """Return the name of an upload's file, in a folder of the first two letters."""
    return f"{sha256[:2]}/{sha256}{ENDING}"


def pack(content: bytes) -> bytes:
    """Return an upload as it is kept."""
    # zlib takes four times as long, a fifth of all that is computed for an upload.
    return igzip.compress(content, _LEVEL, mtime=0)


def _unpack(packed: bytes) -> bytes:
    if not packed:
        raise gzip.BadGzipFile("the file is empty")
    try:
        return gzip.decompress(packed)
    except (EOFError, zlib.error) as error:
        raise gzip.BadGzipFile(str(error)) from error


def _unpack_pieces(packed: Iterator[bytes]) -> Iterator[bytes]:
    """Unpack an upload from its pieces, into pieces of at most :data:`PIECE` bytes."""
    stream = zlib.decompressobj(zlib.MAX_WBITS | 16)  # 16: with a gzip header
    for piece in packed:
        left = piece
        while left:
            try:
                yield stream.decompress(left, PIECE)
            except zlib.error as error:
                raise gzip.BadGzipFile(str(error)) from error
            left = stream.unconsumed_tail
    if not stream.eof:
        raise gzip.BadGzipFile("the file is cut off")


class FolderUploads:
    """Uploads in a folder, in subfolders by the first two characters of their digest."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._making = Lock()

    @contextmanager
    def staged(self, sha256: str, packed: bytes) -> Iterator[Keep]:
        """Write a hidden file through to the disk, which is renamed or removed."""
        path = self._path(sha256)
        with self._making:
            _make_folder(path.parent)
        # Also if the file exists: it may be deleted before this one is kept.
        descriptor, name = mkstemp(dir=path.parent, prefix=".")
        hidden = Path(name)
        try:
            with naming(path, hidden), os.fdopen(descriptor, "wb") as file:
                file.write(packed)
                file.flush()
                os.fsync(file.fileno())
            yield partial(_rename, hidden, path)
        finally:
            hidden.unlink(missing_ok=True)

    def put(self, sha256: str, content: bytes) -> None:
        """Write the file whole and through to the disk, or not at all."""
        with self.staged(sha256, pack(content)) as keep:
            keep()

    def get(self, sha256: str) -> bytes:
        """Read the file."""
        return _unpack(self._path(sha256).read_bytes())

    def pieces(self, sha256: str) -> Iterator[bytes]:
        """Read the file, opened for each piece."""
        path = self._path(sha256)
        starts = range(0, path.stat().st_size, PIECE)
        return _unpack_pieces(_piece(path, start) for start in starts)

    def delete(self, sha256: str) -> None:
        """Remove the file."""
        self._path(sha256).unlink(missing_ok=True)

    def names(self) -> Iterator[str]:
        """List the files, including incomplete ones after a crash."""
        yield from _names_in(self.folder, "")

    def try_out(self) -> None:
        """Look for a missing upload, and write an unnamed file to the folder or its parent."""
        with suppress(FileNotFoundError):
            self.get(_NO_UPLOAD)
        there = next(place for place in (self.folder, *self.folder.parents) if place.exists())
        with TemporaryFile(dir=there) as file:
            file.write(_NO_UPLOAD.encode())

    def _path(self, sha256: str) -> Path:
        return self.folder / name_of(sha256)


def _names_in(folder: Path, prefix: str) -> Iterator[str]:
    """Return the names of the files in a folder and those below it, in order."""
    files = folder.iterdir() if folder.is_dir() else ()
    # A folder's name ends with its slash, as in the names of its files.
    for name in sorted(f"{prefix}{file.name}{'/' * file.is_dir()}" for file in files):
        is_folder = name.endswith("/")
        yield from _names_in(folder / name[len(prefix) :], name) if is_folder else [name]


def _piece(path: Path, start: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        return file.read(PIECE)


def _rename(hidden: Path, path: Path) -> None:
    hidden.replace(path)
    _sync_folder(path.parent)


def _make_folder(folder: Path) -> None:
    """Make a folder and its parents, and flush each to the disk."""
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        _sync_folder(folder.parent)


def _sync_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


_NOT_THERE = ("NoSuchKey", "404")
"""S3's codes for missing objects, of GET and of HEAD."""


class S3Uploads:
    """Uploads in an S3-compatible store; credentials and endpoint as boto3 finds them."""

    def __init__(self, bucket: str, prefix: str) -> None:
        try:
            import boto3
        except ModuleNotFoundError as error:
            remedy = "install it: pip install 'reverie-eval[s3]'"
            raise UploadsError(f"{error}; {remedy}") from error
        self._bucket = bucket
        self._prefix = f"{prefix}/" if prefix else ""
        with self._asking():
            self._client: Any = boto3.client("s3")

    @contextmanager
    def staged(self, sha256: str, packed: bytes) -> Iterator[Keep]:
        """Write an object under another key; the store copies it, and it is removed."""
        staging = f"{self._key(sha256)}.{secrets.token_hex(8)}"
        with self._asking():
            self._client.put_object(Bucket=self._bucket, Key=staging, Body=packed)
        try:
            yield partial(self._copy, staging, self._key(sha256))
        finally:
            with suppress(UploadsError), self._asking():  # what is left over harms nobody
                self._client.delete_object(Bucket=self._bucket, Key=staging)

    def put(self, sha256: str, content: bytes) -> None:
        """Write the object, which is atomic."""
        with self._asking():
            key = self._key(sha256)
            self._client.put_object(Bucket=self._bucket, Key=key, Body=pack(content))

    def get(self, sha256: str) -> bytes:
        """Read the object."""
        return _unpack(self._read(sha256))

    def pieces(self, sha256: str) -> Iterator[bytes]:
        """Read the object by ranges of bytes."""
        with self._asking():
            known = self._client.head_object(Bucket=self._bucket, Key=self._key(sha256))
        starts = range(0, known["ContentLength"], PIECE)
        ranges = (f"bytes={start}-{start + PIECE - 1}" for start in starts)
        return _unpack_pieces(self._read(sha256, Range=each) for each in ranges)

    def delete(self, sha256: str) -> None:
        """Remove the object."""
        with self._asking():
            self._client.delete_object(Bucket=self._bucket, Key=self._key(sha256))

    def names(self) -> Iterator[str]:
        """List the objects."""
        pages = self._client.get_paginator("list_objects_v2")
        with self._asking():
            for page in pages.paginate(Bucket=self._bucket, Prefix=self._prefix):
                for found in page.get("Contents", ()):
                    yield found["Key"].removeprefix(self._prefix)

    def try_out(self) -> None:
        """Look for a missing upload."""
        with suppress(FileNotFoundError):
            self.get(_NO_UPLOAD)

    def _copy(self, source: str, target: str) -> None:
        with self._asking():
            origin = {"Bucket": self._bucket, "Key": source}
            self._client.copy_object(Bucket=self._bucket, Key=target, CopySource=origin)

    def _read(self, sha256: str, **part: str) -> bytes:
        with self._asking():
            answer = self._client.get_object(Bucket=self._bucket, Key=self._key(sha256), **part)
            content: bytes = answer["Body"].read()
        return content

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """Translate the errors of the store."""
        from botocore.exceptions import BotoCoreError, ClientError

        try:
            yield
        except ClientError as error:
            if error.response["Error"]["Code"] in _NOT_THERE:
                raise FileNotFoundError(str(error)) from error
            raise self._refusal(error) from error
        except (BotoCoreError, ValueError) as error:  # the endpoint is not a URL
            raise self._refusal(error) from error

    def _refusal(self, error: Exception) -> UploadsError:
        remedy = "check that it, and the bucket with these credentials, can be reached"
        return UploadsError(f"s3://{self._bucket}: {error}; {remedy}")

    def _key(self, sha256: str) -> str:
        return f"{self._prefix}{name_of(sha256)}"
