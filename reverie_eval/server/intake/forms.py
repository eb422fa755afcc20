"""Parsing a form that contains a file, in a thread.

The framework's parser runs on the event loop, and calls a function wherever the content begins like
a boundary: 32 MiB of that take many seconds. This one searches for the boundary with
``bytes.find``, piece by piece, so that other threads can run.
"""

from collections.abc import Mapping
from io import BytesIO
from typing import NamedTuple

from multipart import MultipartError, MultipartParser
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers

from reverie_eval.server.errors import MalformedError

_MOST_FIELDS = 27


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
    """
    boundary = parse_options_header(headers.get("content-type"))[1].get(b"boundary", b"")
    size = len(body)  # all in memory
    texts: dict[str, str] = {}
    files: dict[str, File] = {}
    try:
        for part in MultipartParser(
            BytesIO(body),
            boundary,
            strict=True,
            part_limit=_MOST_FIELDS,
            spool_limit=size,
            memory_limit=size,
        ):
            content = part.file.getvalue()
            if part.filename is None:
                texts[part.name] = content.decode()  # never by a codec that the sender names
            elif files:
                raise _malformed("it has more than one file")
            else:
                files[part.name] = File(content, part.filename)
    except MultipartError as error:
        raise _malformed(str(error)) from None
    except UnicodeDecodeError:
        raise _malformed("a field is not UTF-8") from None
    return Form(texts, files)


def _malformed(why: str) -> MalformedError:
    return MalformedError(f"the form cannot be read: {why}")
