"""Receiving uploads within limits of size and time, and their parts as dependencies of routes.

The body is the result file itself (plain, gzipped or in a zip archive, which is detected from its
content) or a form with a field ``file``. The method is described in the query or in the form.
"""

from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from io import BytesIO
from typing import Annotated, Any, NamedTuple

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from multipart import MultipartError, MultipartParser
from pydantic import BaseModel
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers

from reverie_eval.schemas.service import Method, QuotaReport
from reverie_eval.server.audit.transactions import Clock
from reverie_eval.server.errors import MalformedError
from reverie_eval.server.http.api import BINARY, SUBMISSION
from reverie_eval.server.http.callers import Caller, Exchange, Organiser, Server, exchange_of
from reverie_eval.server.http.middleware import allow_body, is_multipart
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.runtime import Runtime, RuntimeState
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.settings import Limits
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Person

_FORM_OVERHEAD = 64 << 10
"""Bytes that a form may have besides the file."""
_MOST_FIELDS = 27
"""The fields that a form may have, one of which is the file."""
_PACKED = {"schema": BINARY}


def parameters_of(model: type[BaseModel], otherwise: str) -> list[dict[str, Any]]:
    """Describe a model's fields as query parameters; a field may lack a description of its own."""
    return [
        {
            "name": name,
            "in": "query",
            "description": f"{schema.get('description', otherwise)} Or a field of the form.",
            "schema": schema,
        }
        for name, schema in model.model_json_schema()["properties"].items()
    ]


METHOD_PARAMETERS = parameters_of(Method, "Of the method.")
"""The query parameters that describe a method, for the API's description."""

FILE_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "The result file: JSON, gzipped JSON or a zip archive with one file, "
        "recognised by its content; or a form with the field `file`.",
        "content": {
            "application/json": {"schema": {"title": "Submission"}, "example": SUBMISSION},
            "application/gzip": _PACKED,
            "application/zip": _PACKED,
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["file"],
                    "properties": {
                        "file": BINARY,
                        **Method.model_json_schema()["properties"],
                    },
                },
                "example": {"file": "(the result file)", "name": "Walker", "extra_data": True},
            },
        },
    }
}
"""The body of an upload, for the API's description."""

OF_FILES = (
    "malformed-request",
    "not-signed-in",
    "not-found",
    "too-slow",
    "too-large",
    "submission-rejected",
    "busy",
)
OF_UPLOADS = (*OF_FILES, "not-open", "conflict", "quota-spent", "bytes-spent")
"""The problems of files that are checked, and of those that are scored."""


class ReceivedFile(NamedTuple):
    """A file that is being submitted, as it came in a request."""

    packed: bytes
    arrived: datetime
    """When its last byte arrived."""
    fields: Mapping[str, Any]
    """The form's other fields."""
    filename: str = ""
    """Empty for a form in which no file was chosen."""


async def receive(request: Request, limits: Limits, clock: Clock) -> ReceivedFile:
    """Read an upload, and record the time at which its last byte arrived.

    Raises
    ------
    TooLargeError
        If it is larger than the limit, whatever its headers say.
    TooSlowError
        If it did not arrive in time.
    MalformedError
        If it is a form without a file, or cannot be parsed.
    """
    is_form = is_multipart(request.headers)
    allow_body(request.scope, (limits.upload_mebibytes << 20) + _FORM_OVERHEAD * is_form)
    body = await request.body()
    arrived = clock()
    if not is_form:
        return ReceivedFile(body, arrived, {})
    texts, files = await run_in_threadpool(parse_form, request.headers, body)
    if "file" not in files:
        raise MalformedError("the form has no file; send the result file in the field `file`")
    content, filename = files["file"]
    return ReceivedFile(content, arrived, texts, filename)


def parse_form(
    headers: Headers, body: bytes
) -> tuple[Mapping[str, str], Mapping[str, tuple[bytes, str]]]:
    """Parse a form as browsers send it, in a thread.

    The framework's parser runs on the event loop, and calls a function wherever the content begins
    like a boundary: 32 MiB of that take many seconds. This one searches for the boundary with
    ``bytes.find``, piece by piece, so that other threads can run.

    Returns
    -------
    The texts of fields by name, of those with the same name the last one; content and name of at
    most one file, by the name of its field. The name is empty if no file was chosen.

    Raises
    ------
    MalformedError
        If it is not a form, or has more fields than any form here.
    """
    boundary = parse_options_header(headers.get("content-type"))[1].get(b"boundary", b"")
    size = len(body)  # all in memory
    texts: dict[str, str] = {}
    files: dict[str, tuple[bytes, str]] = {}
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
                files[part.name] = content, part.filename
    except MultipartError as error:
        raise _malformed(error.args[0]) from None
    except UnicodeDecodeError:
        raise _malformed("a field is not UTF-8") from None
    return texts, files


def _malformed(why: str) -> MalformedError:
    return MalformedError(
        f"the form cannot be read: {why}; send one file and at most {_MOST_FIELDS - 1} fields, as "
        "browsers and `curl -F file=@submit.json` do, or the file alone, which is not a form"
    )


async def counted(request: Request) -> Exchange:
    """Note that this is an upload to be scored, whatever its outcome."""
    exchange = exchange_of(request.scope)
    exchange.uploaded_to = request.path_params["split"]
    return exchange


Counted = Annotated[Exchange, Depends(counted)]


@dataclass(frozen=True, slots=True)
class Incoming:
    """An upload that is not read yet."""

    request: Request
    server: ServerState
    runtime: RuntimeState
    began: datetime
    """When the request began, before it waited for anything."""

    @asynccontextmanager
    async def take(
        self, person: Person, check: Callable[[ReceivedFile], None] = lambda _: None
    ) -> AsyncIterator[ReceivedFile]:
        """Read a person's upload as soon as there is room for it, and wait for a process.

        Holds a place and the process until the end. An upload is not read while it waits for a
        place, so its arrival is dated back by that time: a queue makes nobody late. What ``check``
        refuses waits for no process.
        """
        server, exchange = self.server, exchange_of(self.request.scope)
        exchange.team = person.team_id
        async with self.runtime.uploads.hold(person.team_id):
            waited = max(server.clock() - self.began, timedelta())
            file = await receive(self.request, server.settings.limits, server.clock)
            exchange.split = fields_of(self.request, file).get("split", "")
            check(file)
            async with self.runtime.scoring.hold(person.team_id):
                yield file._replace(arrived=file.arrived - waited)


async def incoming(request: Request, server: Server, runtime: Runtime) -> Incoming:
    """Return an upload before anything is read or looked up."""
    return Incoming(request, server, runtime, server.clock())


Arriving = Annotated[Incoming, Depends(incoming)]


async def received(upload: Arriving, caller: Caller) -> AsyncIterator[ReceivedFile]:
    """Read the upload when the sender is known and a place is free, and wait for a process.

    As soon as the sender is known, every problem document includes the submissions left.
    """
    person = await run_in_threadpool(caller.person)
    server, split = upload.server, upload.request.path_params["split"]

    def quota_left() -> QuotaReport:
        with server.database.reading() as session:
            return server.get(Intake).quotas(session, person, split)[split]

    if split in server.boards:
        exchange_of(upload.request.scope).quota = quota_left
    async with upload.take(person) as file:
        yield file


# Place and process are released before the reply is sent, so slow readers do not hold them.
Received = Annotated[ReceivedFile, Depends(received, scope="function")]


async def received_by_organiser(
    upload: Arriving, organiser: Organiser
) -> AsyncIterator[ReceivedFile]:
    """Read a file that an organiser submits for a person."""
    async with upload.take(await run_in_threadpool(organiser.person)) as file:
        yield file


ReceivedByOrganiser = Annotated[ReceivedFile, Depends(received_by_organiser, scope="function")]


async def method_of(request: Request, file: Received) -> Method:
    """Return the description of the method."""
    return method_from(fields_of(request, file))


SentMethod = Annotated[Method, Depends(method_of)]


def fields_of(request: Request, file: ReceivedFile) -> dict[str, Any]:
    """Return what describes an upload; the form takes precedence over the query."""
    given = {**request.query_params, **file.fields}
    return {name: value for name, value in given.items() if name != "file"}


def method_from(given: Mapping[str, Any]) -> Method:
    """Return the description of a method; empty fields count as missing.

    Raises RequestValidationError, which names each field that is wrong.
    """
    return read_model(Method, {name: value for name, value in given.items() if value != ""})
