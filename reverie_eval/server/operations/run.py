"""Run the server until it is told to stop."""

import gc
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import uvicorn
from starlette.types import ASGIApp

from reverie_eval.server.app import create_app
from reverie_eval.server.http.patience import PatientProtocol
from reverie_eval.server.operations.listening import listen, url_of
from reverie_eval.server.operations.logs import LOGGING
from reverie_eval.server.state import ServerState

SECONDS_TO_FINISH = 90
"""What an upload that is on its way when the server is stopped has left to be answered in."""


def run_server(
    state: ServerState, host: str, port: int, announce: Callable[[str], None] = lambda _: None
) -> None:
    """Serve until SIGTERM or SIGINT; what has begun is finished first.

    Parameters
    ----------
    state : ServerState
        An opened server; its database is closed at the end.
    host : str
        An address to listen at; ``0.0.0.0`` for every one.
    port : int
        0 for any that is free.
    announce : callable
        Told the URL as soon as somebody listens there.

    Raises
    ------
    ReverieEvalError
        If the address is taken or not this machine's.
    """
    listening = listen(host, port)
    server = _Server(configuration(create_app(state)), lambda: announce(url_of(listening)))
    gc.freeze()  # ground truth stays; looking through it for garbage is time lost
    with _stopped_is_done():
        server.run(sockets=[listening])


def configuration(app: ASGIApp) -> uvicorn.Config:
    """Return how an application is served: without a banner, with our logs, not for ever."""
    return uvicorn.Config(
        app,
        http=PatientProtocol,
        ws="none",
        log_config=LOGGING,
        access_log=False,
        server_header=False,
        proxy_headers=False,  # whom to believe, a setting says
        timeout_graceful_shutdown=SECONDS_TO_FINISH,
    )


class _Server(uvicorn.Server):
    """Says so as soon as it serves, and may be told to stop from then on."""

    def __init__(self, config: uvicorn.Config, announce: Callable[[], None]) -> None:
        super().__init__(config)
        self._announce = announce

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve."""
        await super().startup(sockets)
        self._announce()


@contextmanager
def _stopped_is_done() -> Iterator[None]:
    """End in status 0 on SIGTERM, which uvicorn raises once more when it has finished."""
    before = signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _exit(*_: object) -> None:
    sys.exit(0)
