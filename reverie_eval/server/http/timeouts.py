"""Limits of connections that are slow to send a request or to read the reply, or send no end.

uvicorn waits without limit for the headers of a request, however many there are, for the rest of a
body after the reply was sent, and for the client to read the reply, which stays in memory until
then. Slow clients at many addresses could use up all connections, and large replies all memory.
"""

import asyncio
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

SECONDS_FOR_HEADERS = 10
SECONDS_FOR_REPLY = 60
"""Time for a reply, or a piece of a file, to leave the server."""
BYTES_OF_HEADERS = 16 << 10
"""The most bytes of a request's first line and headers together."""


class TimeoutProtocol(HttpToolsProtocol):
    """HTTP/1.1 with timeouts, and with a limit of the headers.

    It is parsed by httptools, in C: h11, in Python, takes two milliseconds for a megabyte.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self._headers_read: int | None = 0
        """Bytes of a request whose headers are not complete; None while there is no such."""
        self._for_request = _Deadline(self.loop)
        self._for_reply = _Deadline(self.loop)

    def connection_made(self, transport: Any) -> None:
        """Wait for the first request."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)  # so that pause_writing is always called
        self._wait_for_request()

    def on_message_begin(self) -> None:
        """Count the bytes of the headers that begin."""
        super().on_message_begin()
        self._headers_read = 0

    def on_headers_complete(self) -> None:
        """Answer a request, unless its headers, which may have come at once, are too long."""
        self._headers_read = None
        size = len(self.url) + sum(len(name) + len(value) for name, value in self.headers)
        if size > BYTES_OF_HEADERS:
            raise ValueError("headers too long")  # the parser makes it the reply to what is no HTTP
        super().on_headers_complete()

    def data_received(self, data: bytes) -> None:
        """Read data; once the headers are complete, the application's own time limits apply."""
        super().data_received(data)
        if self._headers_read is not None:
            self._headers_read += len(data)
            if self._headers_read > BYTES_OF_HEADERS and not self.transport.is_closing():
                self.send_400_response("The headers of the request are too long.")
        if self._is_answering():
            self._for_request.call_off()
        else:
            self._wait_for_request()

    def pause_writing(self) -> None:
        """Start the timeout for the reply."""
        super().pause_writing()
        self._for_reply.set(SECONDS_FOR_REPLY, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop the timeout: all of the reply has left."""
        self._for_reply.call_off()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop both timeouts."""
        self._for_request.call_off()
        self._for_reply.call_off()
        super().connection_lost(exc)

    def _is_answering(self) -> bool:
        return not getattr(self.cycle, "response_complete", True)  # no cycle before a request

    def _wait_for_request(self) -> None:
        self._for_request.set(SECONDS_FOR_HEADERS, self._close_unless_answering)

    def _close_unless_answering(self) -> None:
        if not self._is_answering():
            self.transport.close()


class _Deadline:
    """A timer that can be cancelled; at most one runs at a time."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._timer: asyncio.TimerHandle | None = None

    def set(self, seconds: float, action: Callable[[], None]) -> None:
        """Start the timer, unless it is running already."""
        if self._timer is None:
            self._timer = self._loop.call_later(seconds, self._happen, action)

    def call_off(self) -> None:
        """Stop the timer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _happen(self, action: Callable[[], None]) -> None:
        self._timer = None
        action()
