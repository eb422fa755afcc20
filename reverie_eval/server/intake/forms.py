"""Parsing a form that contains a file: one search for the boundary, whatever the file contains.

The framework's parser runs on the event loop and calls a function wherever the content begins like
a boundary: 32 MiB of that took seconds, during which nobody was answered. Here, the work is one
pass of ``bytes.find`` in a thread, in pieces between which other threads can run.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers

from reverie_eval.server.errors import MalformedError

_PIECE = 1 << 20
"""Bytes that are searched before another thread may run."""
_MOST_FIELDS = 27
_LONGEST_HEAD = 8 << 10
"""Bytes of the lines before the content of a field, at most."""
_LONGEST_PADDING = 256
"""Spaces that may follow a boundary, at most."""


class File(NamedTuple):
    """A file in a form."""

    content: bytes
    filename: str
    """Empty if no file was chosen."""


class Form(NamedTuple):
    """The fields of a form by name; of those with the same name, the last one."""

    texts: Mapping[str, str]
    files: Mapping[str, File]
    """At most one."""


def parse_form(headers: Headers, body: bytes) -> Form:
    """Parse a form as browsers send it.

    Raises
    ------
    MalformedError
        If it is not a form, or has more fields than any form here.

    References
    ----------
    RFC 2046, section 5.1.1: every line that begins with the boundary is one, so a file that
    contains such a line needs another boundary. RFC 7578: names and file names.
    """
    boundary = parse_options_header(headers.get("content-type"))[1].get(b"boundary", b"")
    if not boundary:
        raise _malformed("Missing boundary in multipart.")
    texts: dict[str, str] = {}
    files: dict[str, File] = {}
    for count, (head, content) in enumerate(_parts(body, b"--" + boundary)):
        if count == _MOST_FIELDS:
            raise _malformed(f"it has more than {_MOST_FIELDS} fields")
        name, filename = _names(head)
        if filename is None:
            texts[name] = _text(content)
        elif files:
            raise _malformed("it has more than one file")
        else:
            files[name] = File(content, filename)
    return Form(texts, files)


def _parts(body: bytes, mark: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Return the lines before each field's content, and the content."""
    at = 2 if body.startswith(b"\r\n") else 0
    if not body.startswith(mark, at):
        raise _malformed("it does not begin with its boundary")
    at += len(mark)
    while not body.startswith(b"--", at):
        line = body.find(b"\r\n", at, at + _LONGEST_PADDING)
        if line < 0 or body[at:line].strip(b" \t"):
            raise _malformed("a line inside a field begins with the form's boundary")
        blank = body.find(b"\r\n\r\n", line, line + _LONGEST_HEAD)
        if blank < 0:
            raise _malformed("a field has no blank line before its content")
        begin = blank + 4
        end = _find(body, b"\r\n" + mark, begin)
        if end < 0:
            raise _malformed("the closing boundary is missing")
        yield body[line + 2 : blank], body[begin:end]
        at = end + 2 + len(mark)


def _find(body: bytes, what: bytes, begin: int) -> int:
    """Find bytes, and let other threads run between pieces; -1 if they are not there."""
    for start in range(begin, len(body), _PIECE):
        found = body.find(what, start, start + _PIECE + len(what) - 1)
        if found >= 0:
            return found
    return -1


def _names(head: bytes) -> tuple[str, str | None]:
    """Return the name of a field and of the file in it, None if it is not a file."""
    lines: Mapping[bytes, bytes] = {
        name.strip().lower(): value
        for name, _, value in (line.partition(b":") for line in head.split(b"\r\n"))
    }
    options = parse_options_header(lines.get(b"content-disposition"))[1]
    if b"name" not in options:
        raise _malformed("a field has no name")
    filename = options.get(b"filename")
    return _text(options[b"name"]), None if filename is None else _text(filename)


def _text(content: bytes) -> str:
    try:
        return content.decode()
    except UnicodeDecodeError:
        raise _malformed("a field is not UTF-8") from None


def _malformed(why: str) -> MalformedError:
    return MalformedError(f"the form cannot be read: {why}")
