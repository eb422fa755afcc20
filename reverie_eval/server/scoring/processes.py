"""The processes of a server that read, check and score what people send.

Each loads the ground truth once and works on one file after the other. A file that takes more
processor time or memory than any real one needs is refused, and the process that worked on it is
replaced, as is one that was killed. All end with the server, also if that is killed.
"""

import gc
import logging
import os
import resource
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from pickle import PicklingError
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Concatenate, Generic, NamedTuple, Self, TypeVar

from reverie_eval.errors import ReverieEvalError, SubmissionError
from reverie_eval.processes import keep_freed_memory, starting_processes
from reverie_eval.server.errors import BusyError
from reverie_eval.server.scoring import begin_importing
from reverie_eval.server.scoring.boards import Board, load_boards, rules_of
from reverie_eval.server.scoring.contexts import (
    SECONDS_TO_RETRY,
    STOPPED,
    Context,
    Given,
    Result,
    Runner,
    Scoring,
)
from reverie_eval.server.settings import Settings
from reverie_eval.server.store.uploads import open_uploads
from reverie_eval.submissions import TOO_MUCH_MEMORY, TOO_MUCH_TIME

SECONDS = 20
"""Processor time for one call; the largest real files take about one second."""
MEBIBYTES = 2048
"""Memory for one call, besides the ground truth."""
_MOST_SECONDS = 120
"""Time for one call that does not use the processor, but waits for a store of uploads."""
_NO_ROOM = "the system has no room for a process that reads the file"
_NICENESS = 5
"""The process that answers requests comes first."""
_PROCESS_SIZE = Path("/proc/self/statm")
"""On Linux: the first number is the size of the address space, in pages."""

Thing = TypeVar("Thing")

_LOGGER = logging.getLogger("reverie_eval.server.scoring")


class ScoringProcesses(Scoring):
    """A number of processes that score.

    Parameters
    ----------
    settings : Settings
        Settings of the server; each process loads the ground truth that they name.
    boards : mapping
        The ground truth of the server. A process that has another one loads it again.
    number : int
        Processes.
    """

    def __init__(self, settings: Settings, boards: Mapping[str, Board], number: int) -> None:
        # A copy of this process could hang, because it has threads; so processes are copies of one
        # that has only imported what they need.
        begin_importing()
        context = get_context("forkserver")
        self.number, self.turns = number, 2 * number
        self._all = [_Process(settings, boards, context) for _ in range(number)]
        self.line: Line[_Process] = Line()
        self._starting = Thread(target=self._start, name="scoring processes", daemon=True)

    def __enter__(self) -> Self:
        """Begin to start all processes; what has to be scored waits for the first."""
        self._starting.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End all processes, whatever they do."""
        self._starting.join()
        for each in self._all:
            each.stop()

    def _start(self) -> None:
        for each in self._all:
            try:
                each.start()
                each.run(_begin)
            except BusyError:  # it is logged
                pass
            except Exception:  # whatever it is, the first call that needs the process tries again
                _LOGGER.exception("scoring process not ready")
            self.line.give(each)

    @contextmanager
    def hold(self) -> Iterator[Runner]:
        """Wait for a process and hold it. Raises BusyError if none becomes free."""
        try:
            process = self.line.take(_MOST_SECONDS)
        except Empty:
            raise BusyError(SECONDS_TO_RETRY) from None
        try:
            process.revive()
            yield process
        finally:
            self.line.give(process)


class Line(Generic[Thing]):
    """Hands things out to those who wait, in the order in which they came.

    A queue of the standard library does not: what gives a thing back and asks for the next one at
    once, as a job does, takes it before a thread that waits has woken up, each time.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._free: deque[Thing] = deque()
        self._waiting: deque[SimpleQueue[Thing]] = deque()

    def give(self, thing: Thing) -> None:
        """Hand a thing to the one who has waited longest, or keep it for the next who comes."""
        with self._lock:
            if self._waiting:
                self._waiting.popleft().put(thing)
            else:
                self._free.append(thing)

    def take(self, seconds: float) -> Thing:
        """Wait for a thing. Raises queue.Empty if none is handed out in time."""
        with self._lock:
            if self._free:
                return self._free.popleft()
            self._waiting.append(own := SimpleQueue[Thing]())
        try:
            return own.get(timeout=seconds)
        except Empty:
            with self._lock:
                if own in self._waiting:
                    self._waiting.remove(own)
                    raise
            return own.get()  # it was handed out in the same moment


class _Call(NamedTuple):
    """What a scoring process has to do."""

    rules: Mapping[str, str]
    seconds: int
    mebibytes: int
    work: Callable[..., Any]
    given: tuple[Any, ...]
    named: Mapping[str, Any]


class _Running(NamedTuple):
    """A process that was started."""

    process: BaseProcess
    connection: Connection


class _Process:
    """One process; when it has ended, another takes its place."""

    _running: _Running | None = None
    """None before the start, and while the system has no room for it."""

    def __init__(
        self, settings: Settings, boards: Mapping[str, Board], context: BaseContext
    ) -> None:
        self._settings, self._boards, self._context = settings, boards, context

    def start(self) -> None:
        """Start the process. Raises BusyError if the system has no room for it."""
        try:
            connection, theirs = self._context.Pipe()
            with theirs, starting_processes():
                process: BaseProcess = self._context.Process(  # type: ignore[attr-defined]
                    target=_serve, args=(theirs, self._settings), name="scoring", daemon=True
                )
                process.start()
        except (EOFError, OSError) as error:  # the former if the fork server could not fork
            _LOGGER.warning("scoring process not started", exc_info=error)
            raise BusyError(SECONDS_TO_RETRY, _NO_ROOM) from None
        self._running = _Running(process, connection)
        _LOGGER.info("scoring process started", extra={"fields": {"pid": process.pid}})

    def revive(self) -> None:
        """Start another process if this one was killed while it had nothing to do, or never ran.

        Raises BusyError if the system has no room for it.
        """
        # A process sends nothing unasked, and closes its end when it dies. The fork server, from
        # which `is_alive` knows, notices later.
        if self._running is not None and self._running.connection.poll():
            self._replace(self._running)
        if self._running is None:
            self.start()

    def stop(self) -> None:
        """End the process, whatever it does."""
        if self._running is not None:
            process, connection = self._running
            self._running = None
            connection.close()
            process.kill()
            process.join()

    def run(
        self,
        work: Callable[Concatenate[Context, Given], Result],
        *given: Given.args,
        **named: Given.kwargs,
    ) -> Result:
        """Let the process call a function."""
        running = self._running
        if running is None:
            raise BusyError(SECONDS_TO_RETRY, STOPPED)
        call = _Call(rules_of(self._boards), SECONDS, MEBIBYTES, work, given, named)
        try:
            running.connection.send(call)
            has_answer = running.connection.poll(_MOST_SECONDS)
            answer = running.connection.recv() if has_answer else None
        except (EOFError, OSError):
            answer = None
        if answer is None:
            raise self._replace(running)
        is_result, returned = answer
        if is_result:
            result: Result = returned
            return result
        raise returned

    def _replace(self, dead: _Running) -> ReverieEvalError:
        """Start another process; return why: the file took too long, or something killed it."""
        self.stop()
        status = dead.process.exitcode
        fields = {"dead": dead.process.pid, "status": status}
        _LOGGER.warning("scoring process replaced", extra={"fields": fields})
        with suppress(BusyError):  # then the next call that needs it tries again
            self.start()
        if status == -signal.SIGXCPU:
            return SubmissionError([TOO_MUCH_TIME.of_file(seconds=SECONDS)])
        return BusyError(SECONDS_TO_RETRY, STOPPED)


def _begin(_: Context) -> None:
    """Do nothing, but after the ground truth was loaded."""


def _serve(connection: Connection, settings: Settings) -> None:
    """Answer calls until the server has ended."""
    # The system would write a core file, with the solution, when a file takes too long.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.nice(_NICENESS)
    context, rules = None, None
    # The server closes its end, or has been killed.
    with suppress(EOFError, ConnectionError):
        while True:
            call: _Call = connection.recv()
            try:
                if context is None or call.rules != rules:
                    context, rules = _load(settings, call.rules), call.rules
                answer = True, _within_limits(context, call)
            except Exception as error:  # noqa: BLE001  # the server handles it
                if not isinstance(error, ReverieEvalError):
                    error.add_note(traceback.format_exc())
                answer = False, error
            try:
                connection.send(answer)
            except (PicklingError, AttributeError, TypeError) as error:
                kind = type(answer[1]).__name__  # what it says may be an answer
                connection.send((False, RuntimeError(f"a {kind} cannot be sent: {error}")))


def _load(settings: Settings, rules: Mapping[str, str]) -> Context:
    boards = load_boards(settings, rules)
    if rules_of(boards) != rules:
        raise BusyError(SECONDS_TO_RETRY, "the ground truth is being replaced")
    settle_memory()
    return Context(boards, open_uploads(settings.uploads, settings.folder))


def _within_limits(context: Context, call: _Call) -> Any:
    """Do the work of a call.

    Raises SubmissionError if it needs too much memory. The system ends a process that takes too
    much time.
    """
    _limit_time(call.seconds)
    try:
        with _limited_memory(call.mebibytes << 20):
            return call.work(context, *call.given, **call.named)
    except MemoryError:
        raise SubmissionError([TOO_MUCH_MEMORY.of_file(mebibytes=call.mebibytes)]) from None
    finally:
        _limit_time(None)


def _limit_time(seconds: int | None) -> None:
    used = resource.getrusage(resource.RUSAGE_SELF)
    until = int(used.ru_utime + used.ru_stime) + 1
    _limit(resource.RLIMIT_CPU, resource.RLIM_INFINITY if seconds is None else until + seconds)


def _limit(kind: int, value: int) -> None:
    """Set a limit of the process, as far as the system allows."""
    hard = resource.getrlimit(kind)[1]
    # Infinity may be -1.
    finite = [each for each in (value, hard) if each != resource.RLIM_INFINITY]
    resource.setrlimit(kind, (min(finite, default=resource.RLIM_INFINITY), hard))


@contextmanager
def _limited_memory(size: int) -> Iterator[None]:
    """Let the process grow by so many bytes only, where the system can tell how large it is."""
    if not sys.platform.startswith("linux"):
        yield
        return
    pages = int(_PROCESS_SIZE.read_text().split()[0])
    _limit(resource.RLIMIT_AS, pages * resource.getpagesize() + size)
    try:
        yield
    finally:
        _limit(resource.RLIMIT_AS, resource.RLIM_INFINITY)


def settle_memory() -> None:
    """Tell the garbage collector and glibc that this process has started, and that uploads follow.

    Collecting the ground truth, which stays in memory, would only cost time. Commands turn the
    collector off, which pays off until here.
    """
    gc.freeze()
    gc.enable()
    keep_freed_memory()
