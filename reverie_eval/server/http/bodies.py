"""Limits on request bodies: size, time, and the charset of forms.

Bytes are counted as they arrive, whatever the headers say. A route that accepts more than a few
lines of JSON raises the limit once it knows who is sending: :func:`expect`.
"""

import asyncio
import time
from dataclasses import dataclass

from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from reverie_eval.server.errors import MalformedError, TooLargeError, TooSlowError
from reverie_eval.server.http.exchange import exchange_of

SMALL = 256 << 10
"""Bytes; several times the longest JSON, other than a submission, that any route accepts."""

_KEY = "reverie_eval.allowance"
_MULTIPART = b"multipart/form-data"
_FORMS = frozenset({_MULTIPART, b"application/x-www-form-urlencoded"})
_UTF_8 = b"utf-8"
_NAMES_OF_UTF_8 = frozenset({_UTF_8, b"utf8", b"us-ascii"})
"""ASCII is a subset of UTF-8."""


@dataclass(slots=True)
class Allowance:
    """The limits of a request's body."""

    size: int
    """Bytes."""
    seconds: float
    until: float
    """Deadline on the monotonic clock."""


class BodyLimits:
    """Enforces the size and the deadline of each request's body."""

    def __init__(self, app: ASGIApp, seconds: float) -> None:
        self._app = app
        self._seconds = seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request while counting its body.

        Raises
        ------
        TooLargeError, TooSlowError
            From ``receive``, as soon as a limit is exceeded.
        """
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        exchange = exchange_of(scope)
        allowance = Allowance(SMALL, self._seconds, time.monotonic() + self._seconds)
        scope[_KEY] = allowance
        is_whole = False

        async def counting() -> Message:
            nonlocal is_whole
            if is_whole or exchange.status is not None:  # the body is no longer read
                return await receive()
            message = await _in_time(receive, allowance)
            exchange.received += len(message.get("body", b""))
            if exchange.received > allowance.size:
                raise TooLargeError(_too_large(allowance.size))
            is_whole = not message.get("more_body", False)
            return message

        await self._app(scope, counting, send)


class FormCharsets:
    """Refuses forms that are not UTF-8 before they are parsed; browsers always send UTF-8.

    The framework decodes fields on the event loop with whatever codec the content type names. Some
    of Python's codecs take minutes for a megabyte, and some do not decode text at all.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request.

        Raises
        ------
        MalformedError
            If it is a form whose content type names another charset than UTF-8.
        """
        if scope["type"] == "http":
            _demand_utf_8(Headers(scope=scope))
        await self._app(scope, receive, send)


def expect(scope: Scope, size: int) -> None:
    """Set a request's size limit and restart its deadline."""
    allowance: Allowance = scope[_KEY]
    allowance.size = size
    allowance.until = time.monotonic() + allowance.seconds


def is_multipart(headers: Headers) -> bool:
    """Whether a request is a form that can contain files."""
    return _content_type(headers)[0] == _MULTIPART


async def _in_time(receive: Receive, allowance: Allowance) -> Message:
    try:
        async with asyncio.timeout(allowance.until - time.monotonic()):
            return await receive()
    except TimeoutError:
        raise TooSlowError(
            f"the upload did not arrive within {allowance.seconds:g} seconds; gzip it, or try "
            "again. No submission was used"
        ) from None


def _too_large(size: int) -> str:
    if size == SMALL:
        return f"the request is larger than {size >> 10} KiB"
    return (
        f"the upload is larger than {size >> 20} MiB; gzip it, and leave out fields other than "
        "instr_id, trajectory and the answer"
    )


def _demand_utf_8(headers: Headers) -> None:
    media_type, options = _content_type(headers)
    if media_type in _FORMS and options.get(b"charset", _UTF_8).lower() not in _NAMES_OF_UTF_8:
        raise MalformedError(
            "the form's content type names a charset other than UTF-8; send the fields as UTF-8 "
            "and leave `charset` out"
        )


def _content_type(headers: Headers) -> tuple[bytes, dict[bytes, bytes]]:
    """Return media type and parameters, parsed as the framework does: parsers differ."""
    return parse_options_header(headers.get("content-type"))
