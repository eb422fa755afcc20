"""What routes ask for: a submission with what is said of its method, or one's turn to score."""

from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import Annotated, Any, NamedTuple

from fastapi import Depends, Header, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError

from reverie_eval.schemas.service import Method, QuotaReport
from reverie_eval.server.http.callers import Caller, Server
from reverie_eval.server.http.examples import FORM, SUBMISSION
from reverie_eval.server.http.exchange import Exchange, exchange_of
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.http.uploading import Upload, receive
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Person
from reverie_eval.submissions._sources import unpack

_SAID: dict[str, Any] = Method.model_json_schema()["properties"]
_PACKED = {"schema": {"type": "string", "format": "binary"}}

METHOD_PARAMETERS = [
    {
        "name": name,
        "in": "query",
        "description": f"{schema.get('description', 'Of the method.')} Or a field of the form.",
        "schema": schema,
    }
    for name, schema in _SAID.items()
]
"""What is said of a method in the query, for the API's description."""

FILE_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "The result file: JSON, gzipped JSON or a zip archive with one file, which "
        "its content tells; or a form with the field `file`.",
        "content": {
            "application/json": {"schema": {"title": "Submission"}, "example": SUBMISSION},
            "application/gzip": _PACKED,
            "application/zip": _PACKED,
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "properties": {"file": {"type": "string", "format": "binary"}, **_SAID},
                },
                "example": FORM,
            },
        },
    }
}
"""The body of an upload, for the API's description."""


async def counted(request: Request) -> Exchange:
    """Count an upload to be scored, whatever becomes of it."""
    exchange = exchange_of(request.scope)
    exchange.uploaded_to = request.path_params["split"]
    return exchange


Counted = Annotated[Exchange, Depends(counted)]


async def sender(caller: Caller) -> Person:
    """Return who sends an upload, before any of it is taken."""
    return await run_in_threadpool(caller.person)


Sender = Annotated[Person, Depends(sender)]


async def received(
    request: Request, server: Server, runtime: Runtime, person: Sender
) -> AsyncIterator[Upload]:
    """Take the upload off the wire, once it is known who sends it and there is room for it.

    Whatever is wrong with it, the reply says from now on what is left of the quota.
    """
    split = request.path_params["split"]
    if split in server.boards:
        exchange_of(request.scope).quota = partial(_quota_left, server, person, split)
    async with runtime.admission.hold(person.id):
        upload = await receive(request, server.settings.limits)
        async with runtime.admission.score():
            yield upload


def _quota_left(server: ServerState, person: Person, split: str) -> QuotaReport:
    with server.database.reading() as session:
        return server.intake.quotas(session, person, split)[split]


# Whoever reads the reply slowly keeps nobody waiting: what was taken is given back before it.
Received = Annotated[Upload, Depends(received, scope="function")]


async def turn(runtime: Runtime) -> AsyncIterator[None]:
    """Wait, as uploads do, until it is one's turn to score; no thread is kept meanwhile."""
    async with runtime.admission.score():
        yield


Turn = Annotated[None, Depends(turn, scope="function")]
"""Of what may score a kept submission again."""


def content_of(upload: Received, server: Server) -> bytes:
    """Return the submission's JSON text."""
    return unpack(upload.packed, server.settings.limits.unpacked_mebibytes << 20)


async def method_of(request: Request, upload: Received) -> Method:
    """Return what was said of the method, in the query or in the form, which wins."""
    said = {**request.query_params, **upload.fields}
    return method_from({name: value for name, value in said.items() if name != "file"})


def method_from(said: Mapping[str, Any]) -> Method:
    """Return what was said of a method, of which an empty text says nothing.

    Raises
    ------
    RequestValidationError
        Naming each field that is wrong.
    """
    try:
        return Method.model_validate({name: value for name, value in said.items() if value != ""})
    except ValidationError as error:
        raise RequestValidationError(error.errors()) from None


Content = Annotated[bytes, Depends(content_of)]


class Entry(NamedTuple):
    """A submission to be scored, with what was said of it."""

    packed: bytes
    method: Method
    key: str | None
    """The Idempotency-Key, if there was one."""


async def entry_of(
    upload: Received,
    method: Annotated[Method, Depends(method_of)],
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200)] = None,
) -> Entry:
    """Return what is to be scored."""
    return Entry(upload.packed, method, idempotency_key)


Entered = Annotated[Entry, Depends(entry_of)]
