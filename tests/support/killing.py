"""Servers and databases that end by SIGKILL, at a chosen step of an upload or at any moment.

Each server is a process of its own.
"""

import inspect
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from sqlalchemy.engine.default import DefaultDialect

from reverie_eval.server.http import middleware
from reverie_eval.server.http import uploads as reception
from reverie_eval.server.operations.run import run_server
from reverie_eval.server.service.attempts import Attempts
from reverie_eval.server.service.audit import AuditLog
from reverie_eval.server.service.intake import Intake
from reverie_eval.server.service.scoring_processes import ScoringProcesses
from reverie_eval.server.service.transactions import Transactions
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store import uploads as store
from reverie_eval.server.store.uploads import FolderUploads
from tests.support.forking import PROCESSES
from tests.support.waiting import PATIENCE, wait_until


class Step(NamedTuple):
    """A step of the code at which a server is killed."""

    owner: Any
    name: str
    when: Literal["before", "after"] = "before"


STEPS: Mapping[str, Step] = MappingProxyType(
    {
        "the head of an upload is there": Step(reception, "receive"),
        "some of an upload is there": Step(middleware, "_in_time"),
        "all of an upload is there": Step(ScoringProcesses, "hold"),
        "it is unpacked": Step(Intake, "_known"),
        "it is about to be scored": Step(Intake, "_known", "after"),
        "it is scored": Step(FolderUploads, "staged"),
        "its file is written": Step(Transactions, "begin"),
        "its rows are written": Step(AuditLog, "append", "after"),
        "its file is named": Step(store, "_rename", "after"),
        "it is about to be committed": Step(DefaultDialect, "do_commit"),
        "it is committed": Step(DefaultDialect, "do_commit", "after"),
        "its reply is worded": Step(Attempts, "_write"),
    }
)
"""The steps of an upload, in their order."""


@contextmanager
def serving(
    folder: Path, step: str | None = None, times: int = 1
) -> Iterator[tuple[BaseProcess, str]]:
    """Run a server that is killed at its nth time at a step, or at the end.

    Gives the process and the URL. What it logs is in the folder's ``log``.
    """
    here, there = PROCESSES.Pipe()
    process = PROCESSES.Process(target=_serve, args=(folder, step, times, there))
    process.start()
    there.close()
    try:
        assert here.poll(PATIENCE), "the server does not start"
        yield process, here.recv()
    finally:
        process.kill()
        process.join()
        here.close()


def _serve(folder: Path, step: str | None, times: int, announced: Connection) -> None:
    log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 2)

    def announce(url: str) -> None:
        if step is not None:
            die_at(STEPS[step], times)
        announced.send(url)

    run_server(load_settings(folder), "127.0.0.1", 0, announce)


def die_at(step: Step, times: int) -> None:
    """Replace a step by one that kills this process at the nth time."""
    real: Callable[..., Any] = getattr(step.owner, step.name)
    passed = 0

    def count() -> None:
        nonlocal passed
        passed += 1
        if passed == times:
            os.kill(os.getpid(), signal.SIGKILL)

    def dying(*given: Any, **named: Any) -> Any:
        if step.when == "before":
            count()
        result = real(*given, **named)
        if step.when == "after":
            assert not inspect.isawaitable(result), "it has only begun"
            count()
        return result

    setattr(step.owner, step.name, dying)


Part = Literal["a backend", "the postmaster", "all of PostgreSQL"]
"""Of PostgreSQL's processes, those that are killed."""


def kill_postgresql(running: Any, part: Part) -> None:
    """Kill processes of PostgreSQL; others end by themselves, or it starts them anew."""
    postmaster = running.get_postmaster_info().process
    others = postmaster.children()
    backends = [each for each in others if "[local]" in " ".join(each.cmdline())]
    killed = {
        "a backend": backends[:1],
        "the postmaster": [postmaster],
        "all of PostgreSQL": [postmaster, *others],
    }[part]
    for each in killed[:1]:
        each.kill()
    for each in killed[1:]:
        with suppress(ProcessLookupError):  # without the postmaster, it may have ended already
            os.kill(each.pid, signal.SIGKILL)
    if postmaster in killed:
        for each in (postmaster, *others):
            each.wait(PATIENCE)


def restart_postgresql(running: Any) -> None:
    """Start PostgreSQL if it has ended, and wait until it has recovered."""
    from psycopg import OperationalError, connect

    def answers() -> bool:
        try:
            connect(running.get_uri()).close()
        except OperationalError:
            return False
        return True

    running.ensure_postgres_running()
    wait_until(answers)
