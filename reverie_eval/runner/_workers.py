"""Who runs the episodes: this process, or several of their own."""

from collections.abc import Callable, Generator
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from signal import SIG_IGN, SIGINT, signal
from typing import TypeAlias

from reverie_eval.errors import ReverieEvalError, RunError
from reverie_eval.logs import Attempt, Step
from reverie_eval.runner._walking import Job, Plan, Walker

Take: TypeAlias = Callable[[], Job | None]
"""Returns the next attempt to make; None if there is none now."""
Rows: TypeAlias = Generator[Step | Attempt]


def walk_here(plan: Plan, take: Take) -> Rows:
    """Yield what happens as this process runs one episode after the other."""
    walker = None
    while (job := take()) is not None:
        walker = walker or Walker(plan)
        yield from walker.walk(job)


def walk_in_processes(plan: Plan, take: Take, jobs: int) -> Rows:
    """Yield what happens as several processes run episodes; closing it ends them.

    Raises
    ------
    RunError
        If a process was killed.
    """
    # Not the pool of `reverie_eval.processes`: that gives back results, in order and at the end,
    # where each step has to be on disk when it is made.
    context = get_context("spawn")
    pipes = [context.Pipe() for _ in range(jobs)]
    workers = [context.Process(target=_work, args=(plan, there)) for _, there in pipes]
    try:
        for worker in workers:
            worker.start()
        for _, there in pipes:
            there.close()  # so that reading fails once its process has ended
        yield from _share_out([here for here, _ in pipes], take)
    except (EOFError, ConnectionError):
        raise RunError(
            "a process was killed while it ran an episode, perhaps for lack of memory; try fewer "
            "--jobs"
        ) from None
    finally:
        for here, _ in pipes:
            here.close()
        for worker in workers:
            if worker.pid is not None:
                worker.terminate()
                worker.join()


def _share_out(idle: list[Connection], take: Take) -> Rows:
    busy: list[Connection] = []
    while True:
        while idle and (job := take()) is not None:
            busy.append(idle.pop())
            busy[-1].send(job)
        if not busy:
            return
        ready = wait(busy)
        for connection in [each for each in busy if each in ready]:
            row: Step | Attempt | ReverieEvalError = connection.recv()
            if isinstance(row, ReverieEvalError):
                raise row
            if isinstance(row, Attempt):
                busy.remove(connection)
                idle.append(connection)
            yield row
            if isinstance(row, Step):
                connection.send(None)


def _work(plan: Plan, connection: Connection) -> None:
    """Run the episodes that are sent, until the other end is closed."""
    signal(SIGINT, SIG_IGN)  # Ctrl-C reaches the whole group; the other end decides
    walker = None
    try:
        while True:
            job = connection.recv()
            walker = walker or Walker(plan)
            for row in walker.walk(job):
                connection.send(row)
                if isinstance(row, Step):  # nothing more is paid for until this is on disk
                    connection.recv()
    except ReverieEvalError as error:
        connection.send(error)
    except (EOFError, ConnectionError):  # the run has ended
        pass
