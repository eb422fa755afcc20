"""Not waiting for ever: for a connection to send a whole request, or to take its reply.

uvicorn waits as long as a client likes for the headers of a request, for what a client still sends
of a body after it has had its reply, and for the reply to be read, which it holds until then. A few
of those from many addresses would take all connections there are, and a few large replies all
memory.
"""

import asyncio
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

SECONDS_FOR_HEADERS = 10
SECONDS_FOR_REPLY = 60
"""In which the network takes what was written of a reply: all of it, or a piece of a file."""


class PatientProtocol(H11Protocol):
    """HTTP/1.1 that is patient, but not for ever."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self._for_request = _Deadline(self.loop)
        self._for_reply = _Deadline(self.loop)

    def connection_made(self, transport: Any) -> None:
        """Wait for the first request."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=0)  # so that we hear of all that is not taken
        self._wait_for_request()

    def data_received(self, data: bytes) -> None:
        """Take what came; whoever has sent all headers has the time that the application gives."""
        super().data_received(data)
        if self._is_answering():
            self._for_request.call_off()
        else:
            self._wait_for_request()

    def pause_writing(self) -> None:
        """Wait for what was written to be taken."""
        super().pause_writing()
        self._for_reply.set(SECONDS_FOR_REPLY, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on, as all of it was."""
        self._for_reply.call_off()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._for_request.call_off()
        self._for_reply.call_off()
        super().connection_lost(exc)

    def _is_answering(self) -> bool:
        return not getattr(self.cycle, "response_complete", True)  # there may be none yet

    def _wait_for_request(self) -> None:
        self._for_request.set(SECONDS_FOR_HEADERS, self._close_unless_answering)

    def _close_unless_answering(self) -> None:
        if not self._is_answering():
            self.transport.close()


class _Deadline:
    """When something happens that is not called off; one at a time."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._timer: asyncio.TimerHandle | None = None

    def set(self, seconds: float, action: Callable[[], None]) -> None:
        """Let something happen so many seconds from now, unless it is to happen anyway."""
        if self._timer is None:
            self._timer = self._loop.call_later(seconds, self._happen, action)

    def call_off(self) -> None:
        """Let it not happen."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _happen(self, action: Callable[[], None]) -> None:
        self._timer = None
        action()
