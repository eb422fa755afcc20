"""How much a request may send, and how long it may take.

Counted while it comes, whatever its headers say. A route that takes more than a few lines of JSON
says so once it knows who is sending: :func:`expect`.
"""

import asyncio
import time
from dataclasses import dataclass

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from reverie_eval.server.edge.exchange import exchange_of
from reverie_eval.server.errors import TooLargeError, TooSlowError

SMALL = 256 << 10
"""Bytes: the longest JSON that any route takes besides a submission, several times over."""

_KEY = "reverie_eval.allowance"


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


def expect(scope: Scope, size: int) -> None:
    """Let a request send so many bytes, for which its time begins now."""
    allowance: Allowance = scope[_KEY]
    allowance.size = size
    allowance.until = time.monotonic() + allowance.seconds


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
