"""Processes of the package that are forked from one that has imported everything.

Importing takes longer than most of what a process does, and so does what a server works out for
its first requests. Nothing else is shared: each has an environment, a folder and files of its own.
"""

import io
import multiprocessing
import multiprocessing.forkserver
import os
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import chdir
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Self
from unittest.mock import patch

from reverie_eval.server.scoring import processes as scoring_processes
from tests.conftest import REPOSITORY
from tests.support.flat_world import Outcome

PRELOADED = [
    "PIL.Image",
    "reverie_eval.server.run",
    "reverie_eval_cli.main",
    "reverie_eval_cli.commands.score",
    "reverie_eval_cli.commands.serve",
    "reverie_eval_cli.commands.evaluation_server",
    "reverie_eval_cli.commands.server",
    "tests.support.codabench",
    "tests.support.killing",
    "tests.support.serving",
    "tests.support.warm",
]
"""What is imported once; all that is forked has it."""
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(PRELOADED)

Stream = Path | Connection
"""A file that is written at its end, or one that is open already."""


class Surroundings(NamedTuple):
    """What a process finds when it starts."""

    folder: Path
    environment: Mapping[str, str]
    output: Stream
    """Standard output."""
    errors: Stream
    """Standard error."""
    is_on_terminal: bool = False
    """Whether both are a terminal; what is typed there is standard input."""

    def enter(self) -> None:
        """Work here from now on."""
        os.chdir(self.folder)
        os.environ.clear()
        os.environ.update(self.environment)
        time.tzset()
        if self.is_on_terminal:
            os.setsid()  # or a password would be asked for on the developer's terminal
        _redirect(0, self.output if self.is_on_terminal else Path(os.devnull))
        _redirect(1, self.output)
        _redirect(2, self.errors)
        self._open_again()

    def _open_again(self) -> None:
        """Make the standard streams as Python does when it starts."""
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", 1, errors="backslashreplace", closefd=False)  # noqa: SIM115
        if "PYTHONUNBUFFERED" in self.environment:
            raw = open(1, "wb", buffering=0, closefd=False)  # noqa: SIM115
            sys.stdout = io.TextIOWrapper(raw, write_through=True)


def _redirect(number: int, stream: Stream) -> None:
    if isinstance(stream, Path):
        file = os.open(stream, os.O_RDWR | os.O_CREAT | os.O_APPEND)
        os.dup2(file, number)
        if file != number:
            os.close(file)
    else:
        os.dup2(stream.fileno(), number)


def start_forkserver() -> None:
    """Start the process that all are forked from, unless it runs."""
    with chdir(REPOSITORY):  # it looks for the tests there
        multiprocessing.forkserver.ensure_running()


class Forked:
    """A process, with what ``subprocess.Popen`` tells of one."""

    def __init__(self, work: Callable[..., Any], surroundings: Surroundings, *given: Any) -> None:
        self._process = PROCESSES.Process(target=_run, args=(work, surroundings, given))
        start_forkserver()
        self._process.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.wait()

    @property
    def pid(self) -> int:
        """Return the number of the process."""
        number = self._process.pid
        assert number is not None
        return number

    def poll(self) -> int | None:
        """Return how it ended, or ``None``: its status, or minus the signal that ended it."""
        status: int | None = self._process.exitcode
        return status

    def wait(self, timeout: float | None = None) -> int:
        """Wait until it has ended, and return how."""
        self._process.join(timeout)
        status = self.poll()
        assert status is not None, "it has not ended in time"
        return status

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()


def command(*words: str | Path) -> None:
    """Run the command that is installed as ``reverie-eval``."""
    from reverie_eval_cli.__main__ import run

    sys.argv = ["reverie-eval", *map(str, words)]
    run()


def run_command(*words: str | Path, folder: Path, environment: Mapping[str, str]) -> Outcome:
    """Run the installed command in a process of its own until it has ended."""
    with TemporaryDirectory() as name:
        output, errors = Path(name, "output"), Path(name, "errors")
        surroundings = Surroundings(folder, environment, output, errors)
        status = Forked(command, surroundings, *words).wait()
        return Outcome(status, output.read_text(), errors.read_text())


def _run(work: Callable[..., Any], surroundings: Surroundings, given: tuple[Any, ...]) -> None:
    surroundings.enter()
    if sys.version_info >= (3, 14):  # only who started the process may ask it to fork
        work(*given)
        return
    # Either would start another process to fork from, which would import everything once more: the
    # method when a process starts, and the function, which is bound to it, when the server does.
    with (
        patch.object(multiprocessing.forkserver.ForkServer, "ensure_running"),
        patch.object(multiprocessing.forkserver, "ensure_running"),
        patch.object(scoring_processes, "get_context", lambda _: Beside(surroundings)),
    ):
        work(*given)


class Beside:
    """Forks a server's processes from the one that the server was forked from."""

    Pipe = staticmethod(PROCESSES.Pipe)

    def __init__(self, surroundings: Surroundings) -> None:
        self._surroundings = surroundings

    def Process(  # noqa: N802
        self, *, target: Callable[..., Any], args: tuple[Any, ...], **kwargs: Any
    ) -> ForkServerProcess:
        """Return a process that finds what this one does."""
        here = self._surroundings._replace(folder=Path.cwd(), environment=dict(os.environ))
        return PROCESSES.Process(target=_run, args=(target, here, args), **kwargs)
