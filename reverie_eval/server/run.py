"""Running the server until it is stopped: its connections, and its log.

The log is one JSON object per line on standard error. It never contains bodies, tokens or answers.
A fault is logged with all its frames, but exception messages only if they come from the operating
system, the database or the store of uploads: others may quote an answer.
"""

import asyncio
import json
import logging
import os
import signal
import socket
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from typing import Any

import uvicorn
from sqlalchemy.exc import SQLAlchemyError
from starlette.types import ASGIApp
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from reverie_eval.errors import ReverieEvalError
from reverie_eval.server.app import create_app
from reverie_eval.server.opening import database_errors, open_server
from reverie_eval.server.scoring.boards import rules_of
from reverie_eval.server.scoring.processes import settle_memory
from reverie_eval.server.scoring.rules import record_rules
from reverie_eval.server.settings import Settings
from reverie_eval.server.store.damage import damage_in
from reverie_eval.server.store.uploads import UploadsError

WORKERS = max(2, os.cpu_count() or 1)
"""Processes that read and score files, unless another number is wanted. With two, a file that takes
as long as any file may delays nobody but its own team."""
SECONDS_TO_FINISH = 90
"""Seconds that requests that have begun may take to finish when the server is stopped."""
SECONDS_FOR_HEADERS = 10
SECONDS_FOR_REPLY = 60
"""Time for a reply, or a piece of a file, to leave the server."""
BYTES_OF_HEADERS = 16 << 10
"""The most bytes of a request's first line and headers together."""
_WAITING = 2048
"""Connections that may wait to be accepted."""
_SAID_BY_OTHERS = (OSError, SQLAlchemyError, UploadsError)
"""Errors whose messages are logged."""


def run_server(
    settings: Settings,
    host: str,
    port: int,
    announce: Callable[[str], None] = lambda _: None,
    *,
    workers: int = WORKERS,
) -> None:
    """Serve until SIGTERM or SIGINT; requests that have begun are finished first.

    Parameters
    ----------
    settings : Settings
        Settings of the server.
    host : str
        The address to listen at; ``0.0.0.0`` for all.
    port : int
        0 for any free port.
    announce : callable
        Called with the URL as soon as the server accepts requests.
    workers : int
        Processes that read and score files; this one answers the requests.

    Raises
    ------
    SettingsError, ReceiptError
        If the server cannot be opened.
    ReverieEvalError
        If the address is in use or not this machine's.
    """
    with database_errors():
        state = open_server(settings, workers=workers)
    with closing(state.database):  # the application opens it again
        listening = listen(host, port)
        with database_errors():
            record_rules(state.transactions, rules_of(state.boards))
    url = url_of(listening)
    server = _Server(configuration(create_app(state, url)), lambda: announce(url))
    settle_memory()
    with state.scoring, _stopped_is_done():
        server.run(sockets=[listening])


def listen(host: str, port: int) -> socket.socket:
    """Listen at an address; port 0 means any free port.

    Raises
    ------
    ReverieEvalError
        If the address is in use or not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host, port), family=family, backlog=_WAITING)
        # Accepted connections inherit it. Without it, a reply's body waits 40 ms until the client
        # acknowledges the headers.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0].lower()
        raise ReverieEvalError(
            f"cannot listen at {host}, port {port}: {reason}; choose another address with --host "
            "or --port (0 for any free port)"
        ) from None
    return listening


def url_of(listening: socket.socket) -> str:
    """Return the address as a URL."""
    host, port = listening.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def configuration(app: ASGIApp) -> uvicorn.Config:
    """Return the configuration of uvicorn: our logs, no server header, limited shutdown time."""
    return uvicorn.Config(
        app,
        http=TimeoutProtocol,
        ws="none",
        log_config=LOGGING,
        access_log=False,
        server_header=False,
        proxy_headers=False,  # added by the application, for trusted proxies only
        timeout_graceful_shutdown=SECONDS_TO_FINISH,
    )


class _Server(uvicorn.Server):
    """Announces when it has started; from then on, signals stop it."""

    def __init__(self, config: uvicorn.Config, announce: Callable[[], None]) -> None:
        super().__init__(config)
        self._announce = announce

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, then announce it."""
        await super().startup(sockets)
        self._announce()


@contextmanager
def _stopped_is_done() -> Iterator[None]:
    """Exit with status 0 on SIGTERM, which uvicorn raises again after shutting down."""
    before = signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _exit(*_: object) -> None:
    sys.exit(0)


class TimeoutProtocol(HttpToolsProtocol):
    """HTTP/1.1 with timeouts, and with a limit of the headers; a body is read before the end.

    uvicorn waits without limit for the headers of a request, however many there are, for the rest
    of a body after the reply was sent, and for the client to read the reply, which stays in memory
    until then. Slow clients at many addresses could use up all connections, and large replies all
    memory. But it waits for no more of the body if the client wants the connection to end.

    It is parsed by httptools, in C: h11, in Python, takes two milliseconds for a megabyte.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self._headers_read: int | None = 0
        """Bytes of a request whose headers are not complete; None while there is no such."""
        self._ends_with_reply = False
        """Whether the client wants the connection to end, as those of HTTP/1.0 do."""
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
        # Closed with a body unread, the connection would be reset, and a proxy that still sends
        # would report a fault in place of the reply.
        self._ends_with_reply = not self.cycle.keep_alive
        self.cycle.keep_alive = True

    def on_message_complete(self) -> None:
        """Close the connection after the reply if that is asked for: the whole body is read."""
        super().on_message_complete()
        if not self._ends_with_reply:
            return
        if self.cycle.response_complete:
            self.transport.close()
        else:
            self.cycle.keep_alive = False

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


class JsonLines(logging.Formatter):
    """Formats a record as a line of JSON: time, level, logger, event, and the event's fields."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        at = datetime.fromtimestamp(record.created, UTC)
        line: dict[str, Any] = {
            "time": at.isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "event": record.getMessage().strip(),
            **getattr(record, "fields", {}),
        }
        if record.exc_info and record.exc_info[1]:
            line["fault"] = list(told(record.exc_info[1]))
        return json.dumps(line, ensure_ascii=False, default=str)


def told(error: BaseException) -> Iterator[dict[str, Any]]:
    """Yield an exception and those that caused it, the first cause first, with their frames."""
    cause = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    if cause is not None:
        yield from told(cause)
    yield {
        "kind": f"{type(error).__module__}.{type(error).__qualname__}",
        "said": damage_in(error) or str(error) if isinstance(error, _SAID_BY_OTHERS) else "",
        "frames": [
            f"{frame.filename}:{frame.lineno} in {frame.name}"
            for frame in traceback.extract_tb(error.__traceback__)
        ],
    }


LOGGING: dict[str, Any] = {
    "version": 1,
    "disable_existing_loggers": False,
    "formatters": {"json": {"()": JsonLines}},
    "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "json"}},
    "root": {"handlers": ["stderr"], "level": "WARNING"},
    "loggers": {
        "reverie_eval.server": {"level": "INFO"},
        "uvicorn": {"level": "INFO"},
        "python_multipart": {"level": "ERROR"},  # its warnings quote form fields
    },
}
"""Logging of the whole process: ours, uvicorn's, and warnings of all libraries."""
