"""How much a request may send, how long it may take, and in which letters a form may come.

Bytes are counted while they come, whatever the headers say. A route that takes more than a few
lines of JSON says so once it knows who is sending: :func:`expect`.
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
"""Bytes: the longest JSON that any route takes besides a submission, several times over."""

_KEY = "reverie_eval.allowance"
_MULTIPART = b"multipart/form-data"
_FORMS = frozenset({_MULTIPART, b"application/x-www-form-urlencoded"})
_UTF_8 = b"utf-8"
_NAMES_OF_UTF_8 = frozenset({_UTF_8, b"utf8", b"us-ascii"})
"""The last is a part of it."""


@dataclass(slots=True)
class Allowance:
    """What a request's body may be."""

    size: int
    """Bytes."""
    seconds: float
    until: float
    """On the monotonic clock."""


class BodyLimits:
    """Lets a body come as far, and as long, as it may."""

    def __init__(self, app: ASGIApp, seconds: float) -> None:
        self._app = app
        self._seconds = seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, whose body comes through here.

        Raises
        ------
        TooLargeError, TooSlowError
            From ``receive``, as soon as it is certain.
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
            if is_whole or exchange.status is not None:  # then nobody reads it any more
                return await receive()
            message = await _in_time(receive, allowance)
            exchange.received += len(message.get("body", b""))
            if exchange.received > allowance.size:
                raise TooLargeError(_too_large(allowance.size))
            is_whole = not message.get("more_body", False)
            return message

        await self._app(scope, counting, send)


class FormCharsets:
    """Refuses forms that are not in UTF-8, as browsers send them, before anybody reads them.

    The framework decodes a form's fields by whatever codec the content type names, while everybody
    else waits. Of Python's codecs some take minutes for a megabyte, and some are none of text.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that is no form, or one in UTF-8.

        Raises
        ------
        MalformedError
            If its content type names another charset.
        """
        if scope["type"] == "http":
            _demand_utf_8(Headers(scope=scope))
        await self._app(scope, receive, send)


def expect(scope: Scope, size: int) -> None:
    """Let a request send so many bytes, for which its time begins now."""
    allowance: Allowance = scope[_KEY]
    allowance.size = size
    allowance.until = time.monotonic() + allowance.seconds


def is_multipart(headers: Headers) -> bool:
    """Whether a request is a form that may hold files."""
    return _content_type(headers)[0] == _MULTIPART


async def _in_time(receive: Receive, allowance: Allowance) -> Message:
    try:
        async with asyncio.timeout(allowance.until - time.monotonic()):
            return await receive()
    except TimeoutError:
        raise TooSlowError(
            f"the upload did not arrive within {allowance.seconds:g} seconds; gzip it, or try "
            "again: nothing was spent"
        ) from None


def _too_large(size: int) -> str:
    if size == SMALL:
        return f"the request is larger than {size >> 10} KiB"
    return (
        f"the upload is larger than {size >> 20} MiB; gzip it, and send instr_id, trajectory and "
        "the answer only"
    )


def _demand_utf_8(headers: Headers) -> None:
    media_type, options = _content_type(headers)
    if media_type in _FORMS and options.get(b"charset", _UTF_8).lower() not in _NAMES_OF_UTF_8:
        raise MalformedError(
            "the form's content type names another charset than UTF-8; leave `charset` out, and "
            "send the fields in UTF-8"
        )


def _content_type(headers: Headers) -> tuple[bytes, dict[bytes, bytes]]:
    """Return media type and parameters as the framework takes them apart; another may differ."""
    return parse_options_header(headers.get("content-type"))
