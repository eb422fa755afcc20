"""Where submissions come from: a path, an open file, standard input; and what they are called."""

import errno
import io
import os
import re
import sys
import zlib
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import BinaryIO, TextIO, TypeAlias
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo

from reverie_eval.errors import ProtocolError, SubmissionError
from reverie_eval.submissions import _problems as problems

Source: TypeAlias = str | PathLike[str] | bytes | BinaryIO | TextIO
"""A path, ``-`` for standard input, the content itself, or an open file."""

STANDARD_INPUT = "-"
MAX_BYTES = 128 << 20
"""Room for 3,521 trajectories of a thousand poses; also the limit of what is unpacked."""

_JSON_BRACKETS = (("[", "]"), ("{", "}"))
_JSON_SUFFIX = re.compile(r"(?<=.)(\.json)?(\.gz|\.zip)?$")

_GZIP_MAGIC = b"\x1f\x8b"
_ZIP_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
"""Of an archive with files in it, and of an empty one."""
_ZIP_MEMBER = b"PK\x01\x02"
_MAX_MEMBERS = 1000
"""Each file of an archive takes a hundred times the 46 bytes of its entry in memory."""
_ENCRYPTED = 0x1
_METHODS = (ZIP_STORED, ZIP_DEFLATED)
"""What zip programs use by default. The other methods Python unpacks in one step, whatever the
limit."""
_DAMAGED_ZIP = (
    BadZipFile,
    EOFError,
    NotImplementedError,
    OSError,
    OverflowError,
    ValueError,
    zlib.error,
)


def read_bytes(source: Source) -> bytes:
    """Read a submission, and unpack it if it is gzip or zip.

    Raises
    ------
    SubmissionError
        If it is larger than any submission, or does not unpack to one file.
    OSError
        If the file cannot be read.
    TypeError
        If it is not a source.
    """
    return unpack(source if isinstance(source, bytes) else _read(source), MAX_BYTES)


def _read(source: str | PathLike[str] | BinaryIO | TextIO) -> bytes:
    if isinstance(source, str) and source == STANDARD_INPUT:
        return _read_standard_input()
    if isinstance(source, str | PathLike):
        return _read_file(source)
    if not hasattr(source, "read"):
        kind = type(source).__name__
        raise TypeError(f"a submission is a path, bytes, an open file or records, got {kind}")
    content = source.read(MAX_BYTES + 1)
    return content.encode(errors="surrogatepass") if isinstance(content, str) else content


def _read_file(path: str | PathLike[str]) -> bytes:
    try:
        with Path(path).open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        text = str(path).strip()
        if (text[:1], text[-1:]) in _JSON_BRACKETS:
            raise TypeError("to score JSON text, pass it as bytes: text.encode()") from error
        raise


def _read_standard_input() -> bytes:
    if sys.stdin is None:  # closed by the shell: `<&-`
        raise OSError(errno.EBADF, "is closed", "standard input")
    return sys.stdin.buffer.read(MAX_BYTES + 1)


def unpack(content: bytes, limit: int) -> bytes:
    """Unpack gzip, or a zip archive with one file; return any other content as it is.

    The first bytes say what it is, not the name. No more than the limit is unpacked, whatever the
    archive claims.

    Raises
    ------
    SubmissionError
        If it does not unpack, is larger than the limit (bytes), or is a zip archive of several
        files.
    """
    if content.startswith(_GZIP_MAGIC):
        content = _unpack_gzip(content, limit)
    elif content.startswith(_ZIP_MAGICS):
        content = _unpack_zip(content, limit)
    if len(content) > limit:
        raise SubmissionError([problems.too_large(limit)])
    return content


def _unpack_gzip(content: bytes, limit: int) -> bytes:
    import gzip

    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            return file.read(limit + 1)
    except (EOFError, OSError, zlib.error) as error:
        raise SubmissionError([problems.damaged_gzip(str(error))]) from error


def _unpack_zip(content: bytes, limit: int) -> bytes:
    if content.count(_ZIP_MEMBER) > _MAX_MEMBERS:
        raise SubmissionError([problems.damaged_zip(f"it holds more than {_MAX_MEMBERS:,} files")])
    try:
        with (
            ZipFile(io.BytesIO(content)) as archive,
            archive.open(_only_file(archive)) as file,
        ):
            return file.read(limit + 1)
    except _DAMAGED_ZIP as error:
        raise SubmissionError([problems.damaged_zip(str(error))]) from error


def _only_file(archive: ZipFile) -> ZipInfo:
    files = [member for member in archive.infolist() if not _is_debris(member)]
    if len(files) != 1:
        names = [member.filename for member in files]
        raise SubmissionError([problems.not_one_file(names)])
    (file,) = files
    if file.flag_bits & _ENCRYPTED:
        raise SubmissionError([problems.damaged_zip("it is encrypted")])
    if file.compress_type not in _METHODS:
        raise SubmissionError([problems.damaged_zip("it is compressed in an unusual way")])
    return file


def _is_debris(member: ZipInfo) -> bool:
    """Whether this is a folder, or a file that the operating system put there."""
    *folders, name = member.filename.split("/")
    return not name or name.startswith(".") or "__MACOSX" in folders


def source_name(path: str | PathLike[str]) -> str:
    """Return a path for people: itself, or ``standard input``."""
    return "standard input" if path == STANDARD_INPUT else str(path)


def submission_names(submissions: Sequence[object]) -> Sequence[str]:
    """Name submissions after their files, as briefly as tells them apart.

    The names of the files without their endings, if they differ, or else the parts of the paths
    that differ; numbers if not all are files, or one is given twice.

    >>> submission_names(["runs/a.json", "b.json.gz"])
    ['a', 'b']
    >>> submission_names(["runs/a/test/submit.json", "runs/b/test/submit.json"])
    ['a', 'b']
    >>> submission_names([b"[]", "a.json"])
    ['submission 1', 'submission 2']
    """
    paths = [each for each in submissions if isinstance(each, (str, os.PathLike))]
    files = [Path(source_name(path)) for path in paths]
    bare = [file.with_name(_JSON_SUFFIX.sub("", file.name)) for file in files]
    for names in ([file.name for file in bare], _differing_parts(bare), _differing_parts(files)):
        if len(set(names)) == len(submissions):
            return names
    return [f"submission {number}" for number in range(1, len(submissions) + 1)]


def _differing_parts(files: Sequence[Path]) -> Sequence[str]:
    """Return paths without the parts that all of them begin and end with."""
    paths = [list(file.parts) for file in files]
    for end in (0, -1):
        while len({path[end] for path in paths}) == 1 and min(map(len, paths)) > 1:
            for path in paths:
                path.pop(end)
    return [str(Path(*path)) for path in paths]


def check_names(names: Iterable[object]) -> None:
    """Refuse names of submissions that are not text.

    Raises
    ------
    ProtocolError
        Showing the first of them.
    """
    for name in names:
        if not isinstance(name, str):
            raise ProtocolError(f"names of submissions are text; got {name!r}")
