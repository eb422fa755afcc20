"""Jobs: work that a running server repeats, each in a thread and in transactions of its own.

So a job that fails or hangs delays no other, and no request. Each has a report: when it ran last,
why it failed, and what is still to do.
"""

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from threading import Event, Thread

from sqlalchemy.orm import Session

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.service import JobReport
from reverie_eval.server.store.database import Database

SECONDS_TO_RETRY = 60
"""The longest time until a job that has failed is tried again."""
SECONDS_TO_RUN = 10 * 60
"""A run that takes longer is overdue, unless the time between two runs is longer still."""
SECONDS_TO_STOP = 5
"""How long the server, when it is stopped, waits for runs to end."""

SECOND, SOON, MINUTE, DAY = 1, 10, 60, 24 * 60 * 60
"""Seconds between two runs."""

_LOGGER = logging.getLogger("reverie_eval.server")


@dataclass(frozen=True, slots=True)
class Job:
    """Something that is done at the start of the server, and then at intervals."""

    name: str
    """The name of the job in reports, metrics and the log."""
    work: Callable[[], object]
    """Does it; raises an exception if that failed."""
    seconds: float | None
    """The time between two runs; None if it is done once."""
    backlog: Callable[[Session, datetime], Mapping[str, int]] | None = None
    """Counts what is still to do, by kind."""


@dataclass(frozen=True, slots=True)
class _Runs:
    """What is known of the runs of a job."""

    ended: int = 0
    failed: int = 0
    last_at: datetime | None = None
    """When the last one ended."""
    last_success_at: datetime | None = None
    error: str = ""
    """Why the last one failed."""
    begun: float | None = None
    """When the current one began, by a clock that is never set; None between runs."""


@dataclass(frozen=True)
class Jobs:
    """The jobs of a server; they run within :meth:`running`."""

    jobs: Sequence[Job]
    database: Database
    clock: Callable[[], datetime]
    tell: Callable[[str], object] = lambda _: None
    """Notifies the organiser of a job that begins to fail."""
    _runs: dict[str, _Runs] = field(default_factory=dict, init=False)
    """By name, of the jobs that were started; each is replaced by the thread of its job."""

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run all jobs in threads until the context ends."""
        is_over = Event()
        self._runs.update({job.name: _Runs() for job in self.jobs})
        threads = [
            Thread(target=self._repeat, args=(job, is_over), name=f"job {job.name}", daemon=True)
            for job in self.jobs
        ]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            is_over.set()
            deadline = time.monotonic() + SECONDS_TO_STOP
            for thread in threads:
                thread.join(max(0, deadline - time.monotonic()))

    def failing(self) -> Sequence[str]:
        """Return the names of the jobs that failed the last time, or are overdue."""
        return [job.name for job, runs in self._started() if runs.error or _is_overdue(job, runs)]

    def reports(self) -> list[JobReport]:
        """Report all jobs that were started."""
        return [
            JobReport(
                name=job.name,
                runs=runs.ended,
                failures=runs.failed,
                last_run_at=runs.last_at,
                last_success_at=runs.last_success_at,
                error=runs.error,
                is_overdue=_is_overdue(job, runs),
                backlog=self._backlog(job),
            )
            for job, runs in self._started()
        ]

    def _started(self) -> Sequence[tuple[Job, _Runs]]:
        runs = self._runs.copy()
        return [(job, runs[job.name]) for job in self.jobs if job.name in runs]

    def _backlog(self, job: Job) -> dict[str, int]:
        """Count what is still to do; empty if nobody can tell, as while the database is away."""
        if job.backlog is None:
            return {}
        try:
            with self.database.reading() as session:
                return dict(job.backlog(session, self.clock()))
        except Exception as error:  # noqa: BLE001  # a report of what is wrong must not fail
            _LOGGER.warning("the backlog of job %s is unknown: %s", job.name, one_line(error))
            return {}

    def _repeat(self, job: Job, is_over: Event) -> None:
        while True:
            self._runs[job.name] = runs = self._run(job, self._runs[job.name], is_over)
            seconds = job.seconds
            if runs.error:
                seconds = min(SECONDS_TO_RETRY, seconds or SECONDS_TO_RETRY)
            if seconds is None or is_over.wait(seconds):
                return

    def _run(self, job: Job, earlier: _Runs, is_over: Event) -> _Runs:
        """Do a job once; return what is then known of its runs."""
        self._runs[job.name] = replace(earlier, begun=time.monotonic())
        error = ""
        try:
            job.work()
        except Exception as failure:
            error = one_line(failure)
            # The end of the server may end what a job works with, before the job itself.
            is_new = error != earlier.error and not is_over.is_set()
            if is_new:  # what fails again in the same way is logged once
                fields = {"job": job.name, "error": error}
                _LOGGER.exception("job failed", extra={"fields": fields})
            if is_new and not earlier.error:
                with suppress(Exception):  # the fault may prevent that too
                    self.tell(f"job {job.name} failed: {error}")
        now = self.clock()
        return _Runs(
            ended=earlier.ended + 1,
            failed=earlier.failed + bool(error),
            last_at=now,
            last_success_at=earlier.last_success_at if error else now,
            error=error,
        )


def one_line(error: Exception) -> str:
    """Return an error's type, and its message if that can be shown to everyone.

    Messages of other libraries may quote what they were given: rows, answers, passwords.
    """
    match error:
        case ReverieEvalError():
            message = str(error)
        case OSError(strerror=str(reason)):
            message = reason
        case _:
            message = ""
    return ": ".join(filter(None, [type(error).__name__, " ".join(message.split())]))


def _is_overdue(job: Job, runs: _Runs) -> bool:
    longest = max(job.seconds or 0, SECONDS_TO_RUN)
    return runs.begun is not None and time.monotonic() - runs.begun > longest
