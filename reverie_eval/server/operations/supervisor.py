"""The worker processes of a server: started, replaced when they die, and stopped together."""

import ctypes
import gc
import logging
import os
import signal
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing import parent_process
from pathlib import Path
from socket import socket
from threading import Thread
from typing import NoReturn

import uvicorn
from fastapi import FastAPI
from prometheus_client.multiprocess import mark_process_dead
from uvicorn.supervisors import Multiprocess

from reverie_eval.errors import ReverieEvalError
from reverie_eval.server.app import create_app
from reverie_eval.server.http.workers import Workers
from reverie_eval.server.operations.checks import database_errors
from reverie_eval.server.service.rules import rules_of
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import ServerState

SECONDS_TO_START = 120
SECONDS_TO_ANSWER = 60
"""A worker that does not answer its supervisor for this long is replaced."""

_TOP_PAD = -2
"""glibc's ``M_TOP_PAD``: https://man7.org/linux/man-pages/man3/mallopt.3.html"""
_BYTES_KEPT = 16 << 20
"""Bytes of freed memory that each of glibc's arenas keeps."""

_LOGGER = logging.getLogger("reverie_eval.server")


class Supervisor(Multiprocess):
    """Runs workers that all accept connections at one address.

    Parameters
    ----------
    config : uvicorn.Config
        Its application is :func:`worker_app` with all arguments given.
    listening : socket
        Where the workers listen.
    folder : Path
        Where they store their metrics.
    announce : callable
        Called once all of them accept requests.
    """

    def __init__(
        self, config: uvicorn.Config, listening: socket, folder: Path, announce: Callable[[], None]
    ) -> None:
        super().__init__(config, [listening])
        self._folder = folder
        self._announce = announce

    def init_processes(self) -> None:
        """Start all workers. Raises ReverieEvalError if one of them cannot start."""
        super().init_processes()
        if not all(
            process.wait_until_ready(SECONDS_TO_START, self.should_exit)
            for process in self.processes
        ):
            self.terminate_all()
            self.join_all()
            raise ReverieEvalError("a worker process did not start; the log has the reason")
        self._announce()

    def keep_subprocess_alive(self) -> None:
        """Replace workers that have died."""
        before = list(self.processes)
        super().keep_subprocess_alive()
        for dead, new in zip(before, self.processes, strict=True):
            if dead is not new:
                mark_process_dead(dead.pid, str(self._folder))
                _LOGGER.warning(
                    "worker process replaced",
                    extra={"fields": {"dead": dead.pid, "status": dead.exitcode, "new": new.pid}},
                )

    def handle_ttin(self) -> None:
        """Ignore the signals to add or remove a worker: limits are divided by their number."""

    handle_ttou = handle_ttin

    def terminate_all(self) -> None:
        """Accept no more connections, and let the workers finish what they have begun."""
        for listening in self.sockets:
            listening.close()
        super().terminate_all()


def worker_app(
    settings: Settings, rules: Mapping[str, str], address: str, workers: Workers
) -> FastAPI:
    """Make the application of a worker process; exits if that is impossible.

    Settings and rules are the supervisor's: a worker that is started later behaves like the others,
    or exits if a bundle was replaced meanwhile.
    """
    Thread(target=_end_with_parent, daemon=True).start()
    try:
        with database_errors():
            state = ServerState.open(settings)
    except ReverieEvalError as error:
        _end(str(error))
    if rules_of(state.boards) != rules:
        _end("a bundle has changed since the server started; restart the server")
    app = create_app(state, address, workers)
    settle_memory()
    return app


def settle_memory() -> None:
    """Tell the garbage collector and glibc that this process has started, and that uploads follow.

    Collecting the ground truth, which stays in memory, would only cost time. And glibc, which would
    otherwise return the memory of each freed array to the system and ask for it again, keeps some
    of it for the next upload, which then takes a tenth less of the processor.
    """
    gc.freeze()
    with suppress(AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_TOP_PAD, _BYTES_KEPT)


def _end(reason: str) -> NoReturn:
    _LOGGER.error("a worker process cannot start: %s", reason)
    sys.exit(1)


def _end_with_parent() -> None:
    """Stop this process when its supervisor was killed; nobody else would."""
    supervisor = parent_process()
    if supervisor is not None:
        supervisor.join()
        os.kill(os.getpid(), signal.SIGTERM)
