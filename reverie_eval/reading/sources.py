"""Where a submission's bytes come from: a path, an open file, standard input, plain or packed."""

import errno
import sys
from os import PathLike
from pathlib import Path
from typing import BinaryIO, TextIO, TypeAlias

from reverie_eval.reading.unpacking import unpack

Source: TypeAlias = str | PathLike[str] | bytes | BinaryIO | TextIO
"""A path, ``-`` for standard input, the content itself, or an open file."""

STANDARD_INPUT = "-"
MAX_BYTES = 128 << 20
"""Room for 3,521 trajectories of a thousand poses; also what a packed file may unpack to."""

_JSON_BRACKETS = (("[", "]"), ("{", "}"))


def read_bytes(source: Source) -> bytes:
    """Read a submission, unpacking gzip or zip wherever it comes from.

    Raises
    ------
    SubmissionError
        If it is larger than any submission, or does not unpack to one file.
    OSError
        If the file cannot be read.
    TypeError
        If it is nothing that bytes could come from.
    """
    return unpack(source if isinstance(source, bytes) else _read(source), MAX_BYTES)


def called(path: str | PathLike[str]) -> str:
    """Return what to call whatever is read from a path: the path, or ``standard input``."""
    return "standard input" if path == STANDARD_INPUT else str(path)


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
            raise TypeError("to score JSON text, give it as bytes: text.encode()") from error
        raise


def _read_standard_input() -> bytes:
    if sys.stdin is None:  # closed by the shell: `<&-`
        raise OSError(errno.EBADF, "is closed", "standard input")
    return sys.stdin.buffer.read(MAX_BYTES + 1)
