"""Running the server until it is stopped."""

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
"""How long requests that have begun may take to finish when the server is stopped."""


def run_server(
    state: ServerState, host: str, port: int, announce: Callable[[str], None] = lambda _: None
) -> None:
    """Serve until SIGTERM or SIGINT; requests that have begun are finished first.

    Parameters
    ----------
    state : ServerState
        An opened server; its database is closed at the end.
    host : str
        The address to listen at; ``0.0.0.0`` for all.
    port : int
        0 for any free port.
    announce : callable
        Called with the URL as soon as the server accepts requests.

    Raises
    ------
    ReverieEvalError
        If the address is in use or not this machine's.
    """
    listening = listen(host, port)
    url = url_of(listening)
    server = _Server(configuration(create_app(state, url)), lambda: announce(url))
    gc.freeze()  # the ground truth stays in memory; collecting it would only cost time
    with _stopped_is_done():
        server.run(sockets=[listening])


def configuration(app: ASGIApp) -> uvicorn.Config:
    """Return the configuration of uvicorn: our logs, no server header, limited shutdown time."""
    return uvicorn.Config(
        app,
        http=PatientProtocol,
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
