"""Taking an upload off the wire: counted while it comes, in limited time, unpacked to a limit.

The body is the result file itself, plain, gzipped or in a zip archive, or a form with a field
``file``. What it is, its content says.
"""

import asyncio
from collections.abc import Mapping
from typing import Any, NamedTuple

from fastapi import Request
from starlette.datastructures import FormData, UploadFile

from reverie_eval.server.errors import MalformedError
from reverie_eval.server.http.bodies import expect, is_multipart
from reverie_eval.server.settings import Limits

_FORM_OVERHEAD = 64 << 10
"""Bytes of a form that are not the file."""
_PIECE = 64 << 10
"""Bytes of a form that are parsed before other requests have their turn."""


class Upload(NamedTuple):
    """What came in."""

    packed: bytes
    fields: Mapping[str, Any]
    """The form's other fields."""
    filename: str = ""
    """What its sender calls it; a form in which no file was chosen has none."""


async def receive(request: Request, limits: Limits) -> Upload:
    """Read an upload.

    Raises
    ------
    TooLargeError
        If it is more than the limit, whatever its headers said.
    TooSlowError
        If it did not come in time.
    MalformedError
        If it is a form without a file.
    HTTPException
        If it is no form that can be read.
    """
    is_form = is_multipart(request.headers)
    expect(request.scope, (limits.upload_mebibytes << 20) + _FORM_OVERHEAD * is_form)
    body = await request.body()
    return await _of_form(request, body) if is_form else Upload(body, {})


async def _of_form(request: Request, body: bytes) -> Upload:
    async with Request(request.scope, _replay(body)).form(max_files=1, max_fields=20) as form:
        return await _upload(form)


async def _upload(form: FormData) -> Upload:
    file = form.get("file")
    if not isinstance(file, UploadFile):
        raise MalformedError("the form has no file; name the field of the result file `file`")
    content = await file.read()
    fields = {name: value for name, value in form.items() if isinstance(value, str)}
    return Upload(content, fields, file.filename or "")


def _replay(body: bytes) -> Any:
    """Return what gives a body that has been read once more, piece by piece."""
    starts = iter(range(0, len(body), _PIECE))

    async def receive() -> Mapping[str, Any]:
        await asyncio.sleep(0)  # parsing is done on the event loop
        start = next(starts, 0)
        end = start + _PIECE
        return {"type": "http.request", "body": body[start:end], "more_body": end < len(body)}

    return receive
