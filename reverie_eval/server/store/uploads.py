"""Storage of uploads by their SHA-256, in a folder or an S3-compatible store.

A file is stored before the row that refers to it is committed. A crash between the two leaves an
unused file, never a row without its file.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryFile
from threading import Lock
from typing import Any, Protocol
from urllib.parse import urlsplit

from reverie_eval.errors import ReverieEvalError

PIECE = 256 << 10
"""Bytes of an upload that are in memory during a download."""
_NO_UPLOAD = "0" * 64


class UploadsError(ReverieEvalError):
    """The S3-compatible store cannot be used; says why, and what to do."""


class Uploads(Protocol):
    """A store of uploads."""

    def put(self, sha256: str, content: bytes) -> None:
        """Store an upload; storing it again changes nothing."""

    def get(self, sha256: str) -> bytes:
        """Return an upload; FileNotFoundError if it is missing."""

    def pieces(self, sha256: str) -> Iterator[bytes]:
        """Return an upload in pieces.

        Nothing stays open between two pieces, so a reader may stop at any time.
        """

    def names(self) -> Iterator[str]:
        """Return the names of all files; those of complete uploads are ``SHA-256.json``."""

    def try_out(self) -> None:
        """Test whether uploads can be stored and read, without a change."""


def open_uploads(place: str, folder: Path) -> Uploads:
    """Open the store in a subfolder of the server's folder, or at ``s3://bucket/prefix``."""
    address = urlsplit(place)
    if address.scheme == "s3":
        return S3Uploads(address.netloc, address.path.strip("/"))
    return FolderUploads(folder / place)


class FolderUploads:
    """Uploads in a folder, in subfolders by the first two characters of their digest."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._making = Lock()

    def put(self, sha256: str, content: bytes) -> None:
        """Write the file atomically, and flush it to the disk."""
        path = self._path(sha256)
        with self._making:
            _make_folder(path.parent)
        if not path.exists():
            _write_whole(path, content)
        _sync_folder(path.parent)  # another request may have written it just now

    def get(self, sha256: str) -> bytes:
        """Read the file."""
        return self._path(sha256).read_bytes()

    def pieces(self, sha256: str) -> Iterator[bytes]:
        """Read the file, opened for each piece."""
        path = self._path(sha256)
        return (_piece(path, start) for start in range(0, path.stat().st_size, PIECE))

    def names(self) -> Iterator[str]:
        """List the files, including incomplete ones after a crash."""
        return (path.name for path in self.folder.rglob("*") if path.is_file())

    def try_out(self) -> None:
        """Look for a missing upload, and write an unnamed file to the folder or its parent."""
        with suppress(FileNotFoundError):
            self.get(_NO_UPLOAD)
        there = next(place for place in (self.folder, *self.folder.parents) if place.exists())
        with TemporaryFile(dir=there) as file:
            file.write(_NO_UPLOAD.encode())

    def _path(self, sha256: str) -> Path:
        return self.folder / sha256[:2] / f"{sha256}.json"


def _piece(path: Path, start: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        return file.read(PIECE)


def _write_whole(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, flush it to the disk, then rename it."""
    with NamedTemporaryFile(dir=path.parent, prefix=".", delete=False) as file:
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
            Path(file.name).replace(path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


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

    def put(self, sha256: str, content: bytes) -> None:
        """Write the object, which is atomic."""
        with self._asking():
            self._client.put_object(Bucket=self._bucket, Key=self._key(sha256), Body=content)

    def get(self, sha256: str) -> bytes:
        """Read the object."""
        return self._read(sha256)

    def pieces(self, sha256: str) -> Iterator[bytes]:
        """Read the object by ranges of bytes."""
        with self._asking():
            known = self._client.head_object(Bucket=self._bucket, Key=self._key(sha256))
        starts = range(0, known["ContentLength"], PIECE)
        return (self._read(sha256, Range=f"bytes={start}-{start + PIECE - 1}") for start in starts)

    def names(self) -> Iterator[str]:
        """List the objects."""
        pages = self._client.get_paginator("list_objects_v2")
        with self._asking():
            for page in pages.paginate(Bucket=self._bucket, Prefix=self._prefix):
                yield from (found["Key"].rpartition("/")[2] for found in page.get("Contents", ()))

    def try_out(self) -> None:
        """Look for a missing upload."""
        with suppress(FileNotFoundError):
            self.get(_NO_UPLOAD)

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
        remedy = "see that it can be reached, and the bucket with these credentials"
        return UploadsError(f"s3://{self._bucket}: {error}; {remedy}")

    def _key(self, sha256: str) -> str:
        return f"{self._prefix}{sha256[:2]}/{sha256}.json"
