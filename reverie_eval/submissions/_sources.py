"""Where submissions come from, and what their bytes are."""

import errno
import io
import os
import re
import sys
import zlib
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import BinaryIO, TextIO, TypeAlias
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile, ZipInfo, is_zipfile

from reverie_eval.errors import ProtocolError, SubmissionError
from reverie_eval.logs import is_run, submission_in
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._problems import show
from reverie_eval.text import count_text, damage_text, first_few

Source: TypeAlias = str | PathLike[str] | bytes | BinaryIO | TextIO
"""A path, also of a run's folder, ``-`` for standard input, the content itself, or an open file."""

STANDARD_INPUT = "-"
MAX_MEBIBYTES_VARIABLE = "REVERIE_EVAL_MAX_MEBIBYTES"
"""The environment variable that allows larger files, or smaller ones only."""
MAX_MEBIBYTES = 128
"""Enough for 3,521 trajectories of a thousand poses. It limits the unpacked size too."""

# Bytes to unpack at a time: Python reserves memory for as many, and since 3.12 twice for gzip.
_PIECE = 1 << 20
_JSON_BRACKETS = (("[", "]"), ("{", "}"))
_GZIP_MAGIC = b"\x1f\x8b"
# The first bytes of each member; in compressed bytes, one position in 16 million has the same.
_GZIP_MEMBER = _GZIP_MAGIC + b"\x08"
# Writers that compress by blocks make a few thousand. Empty ones have 20 bytes, and each takes as
# long as a kilobyte of text.
_MAX_GZIP_MEMBERS = 10_000
# The first bytes of an archive with files, and of an empty one.
_ZIP_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
# The first bytes of a file's entry in the directory of an archive.
_ZIP_ENTRY = b"PK\x01\x02"
# Opening an archive takes a hundred times the 46 bytes of each entry in memory.
_MAX_ZIP_ENTRIES = 1000
# The most digits of a limit in mebibytes, which is a terabyte then.
_MOST_DIGITS = 6
_ENCRYPTED = 0x1
# What zip programs use by default. Python unpacks the other methods in one step, ignoring the
# limit, so a small archive could fill the memory.
_METHODS = (ZIP_STORED, ZIP_DEFLATED)
# What `zipfile` raises on archives whose bytes were damaged, or crafted.
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
        If it is larger than any submission needs and no larger ones are allowed, or does not
        unpack to one file.
    ProtocolError
        If the environment variable with the largest size is not a whole number from 1.
    OSError
        If the file cannot be read.
    TypeError
        If it is not a source.
    """
    # Read for each submission, so that a notebook can change the variable.
    limit = _max_mebibytes() << 20
    content = source if isinstance(source, bytes) else _read(source, limit)
    return unpack(content, limit, MAX_MEBIBYTES_VARIABLE)


def _max_mebibytes() -> int:
    value = os.environ.get(MAX_MEBIBYTES_VARIABLE, str(MAX_MEBIBYTES))
    is_number = value.isascii() and value.isdigit() and len(value) <= _MOST_DIGITS
    if not is_number or int(value) == 0:
        raise ProtocolError(
            f"{MAX_MEBIBYTES_VARIABLE} is the largest size of a submission, a whole number of MiB "
            f"from 1, such as {MAX_MEBIBYTES}; got {value!r}"
        )
    return int(value)


def _read(source: str | PathLike[str] | BinaryIO | TextIO, limit: int) -> bytes:
    if isinstance(source, str) and source == STANDARD_INPUT:
        if sys.stdin is None:  # closed by the shell: `<&-`
            raise OSError(errno.EBADF, "is closed", "standard input")
        # One byte more than the limit, so that a file of just the limit is not too large.
        return sys.stdin.buffer.read(limit + 1)
    if isinstance(source, str | PathLike):
        return _read_file(source, limit)
    if not hasattr(source, "read"):
        kind = type(source).__name__
        raise TypeError(f"a submission is a path, bytes, an open file or records, got {kind}")
    content = source.read(limit + 1)
    # A lone surrogate must not fail here: the reader reports it with its location.
    return content.encode(errors="surrogatepass") if isinstance(content, str) else content


def _read_file(file: str | PathLike[str], limit: int) -> bytes:
    try:
        with Path(file).open("rb") as opened:
            # Python allocates all bytes that are asked for: asking for the limit would double the
            # time to read a small file. A pipe has no size.
            size = os.fstat(opened.fileno()).st_size or limit
            return opened.read(min(size, limit) + 1)
    except IsADirectoryError:
        if is_run(file):
            return _read_file(submission_in(file), limit)
        told = "is a folder, and not that of a run; name a result file in it"
        raise IsADirectoryError(errno.EISDIR, told, str(Path(file))) from None
    except (OSError, ValueError) as error:
        # Most libraries take JSON as text; here text is a path, and the system's error for one of
        # a hundred thousand letters would not help.
        text = str(file).strip()
        if (text[:1], text[-1:]) in _JSON_BRACKETS:
            raise TypeError("to score JSON text, pass it as bytes: text.encode()") from error
        raise


def unpack(content: bytes, limit: int, variable: str | None = None) -> bytes:
    """Unpack gzip, or a zip archive with one file; return any other content unchanged.

    The first bytes tell what it is, not the file's name. No more than the limit is unpacked,
    whatever the archive claims. With an environment variable that allows more, the error names it.

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
        too_large = problems.TOO_LARGE_FOR_NOW if variable else problems.TOO_LARGE
        raise SubmissionError([too_large.of_file(mebibytes=limit >> 20, variable=variable)])
    return content


def _unpack_gzip(content: bytes, limit: int) -> bytes:
    import gzip

    # Counted in the raw bytes, as the files of an archive are.
    if content.count(_GZIP_MEMBER) > _MAX_GZIP_MEMBERS:
        reason = f"it has more than {_MAX_GZIP_MEMBERS:,} gzip members"
        raise SubmissionError([problems.DAMAGED_GZIP.of_file(reason=reason)])
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
            return _read_pieces(file.read, limit)
    except (EOFError, OSError, zlib.error) as error:
        reason = damage_text(error)
        raise SubmissionError([problems.DAMAGED_GZIP.of_file(reason=reason)]) from error


def _unpack_zip(content: bytes, limit: int) -> bytes:
    # Counted in the raw bytes, because `ZipFile` reads the whole directory when it is opened.
    if content.count(_ZIP_ENTRY) > _MAX_ZIP_ENTRIES:
        reason = f"it holds more than {_MAX_ZIP_ENTRIES:,} files"
        raise SubmissionError([problems.DAMAGED_ZIP.of_file(reason=reason)])
    try:
        with (
            ZipFile(io.BytesIO(content)) as archive,
            archive.open(_only_file(archive)) as file,
        ):
            return _read_pieces(file.read, limit)
    except _DAMAGED_ZIP as error:
        # An archive is recognised by its end.
        reason = damage_text(error if is_zipfile(io.BytesIO(content)) else EOFError())
        raise SubmissionError([problems.DAMAGED_ZIP.of_file(reason=reason)]) from error


def _read_pieces(read: Callable[[int], bytes], limit: int) -> bytes:
    """Return a file's content; one byte more than the limit tells that it is too large."""
    unpacked = io.BytesIO()
    # Piece by piece: an archive may claim any size, and a bomb is unpacked no farther than the
    # limit.
    while piece := read(min(_PIECE, limit + 1 - unpacked.tell())):
        unpacked.write(piece)
    return unpacked.getvalue()


def _only_file(archive: ZipFile) -> ZipInfo:
    files = [member for member in archive.infolist() if not _is_system_file(member)]
    if len(files) != 1:
        names = first_few(show(member.filename) for member in files)
        found = f"{count_text(len(files), 'file')}: {names}" if files else "no file"
        raise SubmissionError([problems.NOT_ONE_FILE.of_file(found=found)])
    (file,) = files
    if file.flag_bits & _ENCRYPTED:
        raise SubmissionError([problems.DAMAGED_ZIP.of_file(reason="it is encrypted")])
    # The others need modules that a Python may lack.
    if file.compress_type not in _METHODS:
        reason = "it is compressed in an unusual way"
        raise SubmissionError([problems.DAMAGED_ZIP.of_file(reason=reason)])
    return file


def _is_system_file(member: ZipInfo) -> bool:
    """Whether this is a folder, or a file that the operating system added."""
    *folders, name = member.filename.split("/")
    # macOS puts a hidden file beside each file of an archive.
    return not name or name.startswith(".") or "__MACOSX" in folders


# What people send instead of a result file, by its first bytes.
_NOT_JSON = {
    b"PK\x03\x04": "a zip archive within another",
    b"\xfd7zXZ": "an xz archive",
    b"BZh": "a bzip2 archive",
    b"7z\xbc\xaf": "a 7z archive",
    b"Rar!": "a rar archive",
    b"(\xb5/\xfd": "a Zstandard archive",
    b"\x1f\x8b": "packed twice",
    b"\x80": "a Python pickle",
    b"\x93NUMPY": "a numpy array",
    b"\x89HDF": "an HDF5 file",
    b"version https://git-lfs": "a git-lfs pointer, not the file itself",
    b"\0\0\0\0": "a file of zero bytes, as a full disk leaves it",
    b"<<<<<<<": "two versions with the marks of a merge conflict",
    b"<": "a web page",
}
_TAR_MARK = b"ustar"
# The offset of that mark.
_TAR_MARK_AT = 257
_PYTHON_LITERAL = re.compile(rb"[\s\[{(]+'")


def check_kind(content: bytes) -> None:
    """Refuse what is not JSON at all, and say what it is."""
    for beginning, kind in _NOT_JSON.items():
        if content.startswith(beginning):
            raise SubmissionError([problems.ANOTHER_KIND.of_file(kind=kind)])
    if content.startswith(_TAR_MARK, _TAR_MARK_AT):
        raise SubmissionError([problems.ANOTHER_KIND.of_file(kind="a tar archive")])
    if not content.strip():
        raise SubmissionError([problems.ANOTHER_KIND.of_file(kind="empty")])
    if is_python_literal(content):
        fault = faults.PYTHON_LITERAL
        raise SubmissionError([fault.problem(1, problems.WHOLE_FILE, (), None)])


def is_python_literal(content: bytes) -> bool:
    """Whether this is what Python prints for a list or a dictionary, which is not JSON."""
    return _PYTHON_LITERAL.match(content) is not None


def check_value_count(content: bytes, limit: int) -> None:
    """Refuse JSON text that would take gigabytes once it is parsed."""
    if len(content) <= limit:
        return  # nearly always: counting takes as long as a third of parsing
    # Every value but the first follows a comma or the beginning of a list or an object. Counting
    # these bytes is an upper bound that takes milliseconds and no memory.
    count = sum(map(content.count, (b"[", b"{", b",")))
    if count > limit:
        raise SubmissionError([problems.TOO_MANY_VALUES.of_file(found=count, limit=limit)])
