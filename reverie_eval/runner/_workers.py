"""Who runs the episodes: this process, threads of it, processes, or whatever has ``submit``."""

import os
import pickle
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import Any

from reverie_eval.errors import ReverieEvalError, RunError
from reverie_eval.logs import Attempt, Step
from reverie_eval.processes import starting_processes
from reverie_eval.runner._walking import Job, Rows, RunPlan, Take, Walker
from reverie_eval.scoring import Executor
from reverie_eval.simulator import Environment
from reverie_eval.text import first_few

# What a worker sends beside rows and errors: it asks for an attempt to make, or has none left.
_TAKE, _END = "take", "end"
# Attempts that an executor is given at a time: a call may be a job of a cluster.
_AT_A_TIME = 20
# Seconds between two looks at what an executor has done.
_POLL = 0.05
# The agent that a thread of an executor made last, and the plan that it made it for.
_LOCAL = threading.local()


def walk_in_workers(
    plan: RunPlan, environment: Environment, take: Take, jobs: int, *, threads: bool
) -> Rows:
    """Yield what happens as several workers run episodes, each with an agent of its own.

    Closing it ends processes at once, and threads when they have chosen an action.

    Raises
    ------
    RunError
        If a worker was killed, or the agent ended it.
    """
    # Not the pool of `reverie_eval.processes`: that gives back results, in order and at the end,
    # where each step has to be on disk when it is made.
    context = get_context("spawn")
    pipes = [context.Pipe() for _ in range(jobs)]
    processes = []
    try:
        with starting_processes():
            for _, there in pipes:
                if threads:
                    work = partial(_work, plan, there, environment)
                    threading.Thread(target=work, daemon=True).start()
                    continue
                process = context.Process(target=_work_alone, args=(plan, there))
                process.start()
                processes.append(process)
                there.close()  # so that reading fails once its process has ended
        yield from _serve([here for here, _ in pipes], take)
    finally:
        for here, _ in pipes:
            here.close()
        for process in processes:
            process.terminate()
            process.join()


def _serve(workers: Sequence[Connection], take: Take) -> Rows:
    """Give workers what they ask for, until they have ended."""
    # The episodes that each of them has begun.
    working = {worker: list[str]() for worker in workers}
    while working:
        ready = wait(list(working))
        for worker, begun in [each for each in working.items() if each[0] in ready]:
            try:
                message: Step | Attempt | ReverieEvalError | str = worker.recv()
                if isinstance(message, ReverieEvalError):
                    raise message
                if message == _END:
                    del working[worker]
                elif isinstance(message, str):
                    job = take()
                    if job:
                        begun.append(job.episode)
                    worker.send(job)
                else:
                    if isinstance(message, Attempt):
                        begun.remove(message.episode)
                    yield message
                    worker.send(None)  # nothing more is paid for until this is on disk
            except (EOFError, ConnectionError):
                raise RunError(_why_ended(begun)) from None


def _why_ended(begun: Sequence[str]) -> str:
    during = f" while it ran {first_few(begun)}" if begun else ""
    return (
        f"a worker ended{during}: it was killed, perhaps for lack of memory (then try fewer "
        "--jobs), or the agent ended the process"
    )


def _work(plan: RunPlan, connection: Connection, environment: Environment | None = None) -> None:
    """Run the episodes that the other end gives, until it has none or is closed."""

    def take() -> Job | None:
        connection.send(_TAKE)
        job: Job | None = connection.recv()
        return job

    try:
        for row in Walker(plan, environment).work(take):
            connection.send(row)
            connection.recv()
        connection.send(_END)
    except ReverieEvalError as error:
        connection.send(error)
    except (EOFError, ConnectionError):  # the run has ended
        pass
    finally:
        connection.close()  # whatever it was, the other end must not wait


def _work_alone(plan: RunPlan, connection: Connection) -> None:
    os.dup2(2, 1)  # what an agent prints is not a result
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _work(plan, connection)


def _end_with_parent() -> None:
    """Wait until the parent is gone, perhaps killed, and end: an action may take for ever."""
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)


def walk_with_executor(
    plan: RunPlan, take: Take, executor: Executor, is_stopped: Callable[[], bool]
) -> Rows:
    """Yield what happened when an executor has run some episodes; closing it cancels the others.

    Raises
    ------
    RunError
        If it could not run them.
    """
    packed = pickle.dumps(plan)
    futures = []
    try:
        while True:
            while jobs := list(islice(iter(take, None), _AT_A_TIME)):
                futures.append(executor.submit(_walk_elsewhere, (packed, jobs)))
            if not futures:
                return
            done = [each for each in futures if each.done()]
            futures = [each for each in futures if each not in done]
            for future in done:
                yield from _rows_of(future)
            if is_stopped():  # only `concurrent.futures` says that something cannot be cancelled
                futures = [each for each in futures if each.cancel() is False]
            if not done:
                time.sleep(_POLL)
    finally:
        for future in futures:
            future.cancel()


def _rows_of(future: Any) -> Sequence[Step | Attempt]:
    try:
        rows: Sequence[Step | Attempt] = future.result()
    except ReverieEvalError:
        raise
    except Exception as error:
        raise RunError(
            f"the executor could not run some episodes: {type(error).__name__}: {error}; run again "
            "to go on"
        ) from error
    return rows


def _walk_elsewhere(given: tuple[bytes, Sequence[Job]]) -> list[Step | Attempt]:
    """Make attempts in a process of an executor, until one says that the run is to stop."""
    packed, jobs = given
    if getattr(_LOCAL, "packed", None) != packed:
        _LOCAL.walker, _LOCAL.packed = Walker(pickle.loads(packed)), packed  # noqa: S301
    waiting, rows = list(jobs), list[Step | Attempt]()
    for row in _LOCAL.walker.work(lambda: waiting.pop(0) if waiting else None):
        rows.append(row)
        if isinstance(row, Attempt) and row.state == "failed" and not row.is_retried:
            waiting.clear()
    return rows
