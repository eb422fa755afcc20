"""Servers and databases that end by SIGKILL, at a chosen step of an upload or at any moment.

Each server is a process of its own, and so is what scores for it.
"""

import inspect
import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import count
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Event, Thread
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from sqlalchemy.engine.default import DefaultDialect

from reverie_eval.server.audit.log import AuditLog
from reverie_eval.server.audit.transactions import Transactions
from reverie_eval.server.http import middleware
from reverie_eval.server.intake import uploads as reception
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.run import run_server
from reverie_eval.server.scoring.processes import ScoringProcesses, _Process
from reverie_eval.server.settings import load_settings
from reverie_eval.server.store import uploads as store
from reverie_eval.server.store.uploads import FolderUploads
from tests.support.forking import PROCESSES, Forked, Surroundings, command
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
        "it is unpacked": Step(Intake, "find_earlier"),
        "it is about to be scored": Step(Intake, "find_earlier", "after"),
        "it is scored": Step(FolderUploads, "staged"),
        "its file is written": Step(Transactions, "begin"),
        "its rows are written": Step(AuditLog, "append", "after"),
        "its file is named": Step(store, "_rename", "after"),
        "it is about to be committed": Step(DefaultDialect, "do_commit"),
        "it is committed": Step(DefaultDialect, "do_commit", "after"),
    }
)
"""The steps of an upload, in their order."""


PAUSES: Mapping[str, Step] = MappingProxyType(
    {
        "it is stored": Step(Intake, "store", "after"),
        "its reply is worded": Step(Intake, "submit", "after"),
    }
)
"""Steps between commit and reply, at which an upload waits for its server to be killed."""


class ScoringStep(NamedTuple):
    """A step at which a process that scores is killed."""

    work: str
    """The name of the function that it is asked to call."""
    when: Literal["before", "within", "after"]
    """Whether it is killed before it calls the function, before it sends the result, or later."""


STEPS_OF_SCORING: Mapping[str, ScoringStep] = MappingProxyType(
    {
        "it is about to unpack a file": ScoringStep("open_file", "before"),
        "it has unpacked the file": ScoringStep("open_file", "within"),
        "it waits to be asked for scores": ScoringStep("open_file", "after"),
        "it is about to score the file": ScoringStep("score_file", "before"),
        "it has scored the file": ScoringStep("score_file", "within"),
        "it waits for another file": ScoringStep("score_file", "after"),
    }
)
"""The steps of a process that scores, in their order."""


class Running(NamedTuple):
    """A server that runs."""

    process: Forked
    url: str
    log: Path
    connection: Connection

    def plant(self, step: str, times: int) -> None:
        """Let something be killed, or wait, when uploads come to a step for the nth time."""
        self.connection.send((step, times))
        self.told()

    def told(self) -> int:
        """Wait until a step has come, unless the server ends there; return the process killed."""
        assert self.connection.poll(PATIENCE), "it does not come to the step"
        process: int = self.connection.recv()
        return process

    def scorers(self) -> set[int]:
        """Return the processes that score and have not been killed."""
        return {process for process in scorers(self.log) if is_running(process)}


@contextmanager
def serving(folder: Path) -> Iterator[Running]:
    """Run a server that is killed at the end. What it logs is in the folder's ``log``."""
    log = folder / "log"
    log.unlink(missing_ok=True)
    here, there = PROCESSES.Pipe()
    surroundings = Surroundings(Path.cwd(), dict(os.environ), log, log)
    with Forked(_serve, surroundings, folder, there) as process:
        there.close()
        try:
            assert here.poll(PATIENCE), "the server does not start"
            yield Running(process, here.recv(), log, here)
        finally:
            process.kill()
            here.close()


def _serve(folder: Path, connection: Connection) -> None:
    def obey() -> None:
        with suppress(EOFError):
            while True:
                step, times = connection.recv()
                _plant(step, times, connection)
                connection.send(os.getpid())

    def announce(url: str) -> None:
        connection.send(url)
        Thread(target=obey, daemon=True).start()

    run_server(load_settings(folder), "127.0.0.1", 0, announce)


def _plant(step: str, times: int, connection: Connection) -> None:
    def pause(_: object) -> None:
        connection.send(os.getpid())
        Event().wait()

    if step in STEPS:
        die_at(STEPS[step], times)
    elif step in PAUSES:
        act_at(PAUSES[step], times, pause, lambda accepted: not accepted.is_repeat)
    else:
        kill_scoring_at(STEPS_OF_SCORING[step], times, connection)


def die_at(step: Step, times: int) -> None:
    """Replace a step by one that kills this process at the nth time."""
    act_at(step, times, lambda _: os.kill(os.getpid(), signal.SIGKILL))


def run_until(step: Step, *words: str | Path) -> None:
    """Run a command that is killed when it comes to a step."""
    die_at(step, 1)
    command(*words)


def act_at(
    step: Step,
    times: int,
    act: Callable[[Any], None],
    counts: Callable[[Any], bool] = lambda _: True,
) -> None:
    """Replace a step by one that does something more at the nth time that counts.

    Both functions are given the result of the step, or None before it.
    """
    real: Callable[..., Any] = getattr(step.owner, step.name)
    passed = count(1)

    def come(result: Any) -> None:
        if counts(result) and next(passed) == times:
            act(result)

    def acting(*given: Any, **named: Any) -> Any:
        if step.when == "before":
            come(None)
        result = real(*given, **named)
        if step.when == "after":
            assert not inspect.isawaitable(result), "it has only begun"
            come(result)
        return result

    setattr(step.owner, step.name, acting)


def kill_scoring_at(step: ScoringStep, times: int, connection: Connection) -> None:
    """Let the process that scores be killed that comes to a step for the nth time."""
    real = _Process.run
    passed = count(1)

    def run(process: Any, work: Callable[..., Any], *given: Any, **named: Any) -> Any:
        if work.__name__ != step.work or next(passed) != times:
            return real(process, work, *given, **named)
        setattr(_Process, real.__name__, real)
        victim = process._running.process  # noqa: SLF001
        connection.send(victim.pid)
        if step.when != "after":
            dying = {"before": _die_before, "within": _die_after}[step.when]
            return real(process, partial(dying, work), *given, **named)
        result = real(process, work, *given, **named)
        victim.kill()
        victim.join()
        return result

    setattr(_Process, real.__name__, run)


def _die_before(*_: object, **__: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _die_after(work: Callable[..., Any], *given: Any, **named: Any) -> None:
    work(*given, **named)
    os.kill(os.getpid(), signal.SIGKILL)


def logged(log: Path, event: str) -> Sequence[Mapping[str, Any]]:
    """Return the lines of a server's log about an event."""
    whole, _, _ = log.read_text().rpartition("\n")
    return [line for line in map(json.loads, whole.splitlines()) if line["event"] == event]


def scorers(log: Path) -> set[int]:
    """Return the processes that score for the server that writes a log."""
    started = {line["pid"] for line in logged(log, "scoring process started")}
    return started - {line["dead"] for line in logged(log, "scoring process replaced")}


def is_running(process: int) -> bool:
    """Whether there is such a process."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def kill_process(process: int) -> None:
    """Kill a process, and wait until it has ended."""
    os.kill(process, signal.SIGKILL)
    wait_until(lambda: not is_running(process))


Part = Literal["a backend", "the postmaster", "all of PostgreSQL"]
"""The processes of PostgreSQL that are killed."""


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
