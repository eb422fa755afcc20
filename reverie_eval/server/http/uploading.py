"""Receiving an upload, within limits of size and time.

The body is the result file itself (plain, gzipped or in a zip archive, which is detected from its
content) or a form with a field ``file``.
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
"""Bytes of a form besides the file."""
_PIECE = 64 << 10
"""Bytes of a form that are parsed before the event loop handles other requests."""


class Upload(NamedTuple):
    """A received upload."""

    packed: bytes
    fields: Mapping[str, Any]
    """The form's other fields."""
    filename: str = ""
    """Empty for a form in which no file was chosen."""


async def receive(request: Request, limits: Limits) -> Upload:
    """Read an upload.

    Raises
    ------
    TooLargeError
        If it is larger than the limit, whatever its headers say.
    TooSlowError
        If it did not arrive in time.
    MalformedError
        If it is a form without a file.
    HTTPException
        If the form cannot be parsed.
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
        raise MalformedError("the form has no file; send the result file in the field `file`")
    content = await file.read()
    fields = {name: value for name, value in form.items() if isinstance(value, str)}
    return Upload(content, fields, file.filename or "")


def _replay(body: bytes) -> Any:
    """Return an ASGI ``receive`` that delivers a body that was already read, in pieces."""
    starts = iter(range(0, len(body), _PIECE))

    async def receive() -> Mapping[str, Any]:
        await asyncio.sleep(0)  # parsing is done on the event loop
        start = next(starts, 0)
        end = start + _PIECE
        return {"type": "http.request", "body": body[start:end], "more_body": end < len(body)}

    return receive
