"""A run: from an agent to a submission, in a folder that survives whatever ends it."""

import hashlib
import os
import platform
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import datetime, timezone
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from reverie_eval.agents import AgentSource
from reverie_eval.errors import RunError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.logs import EPISODES, SUBMISSION, Attempt, read_attempts
from reverie_eval.runner._folder import KEPT, Circumstance, Identity, RunFolder, Totals
from reverie_eval.runner._walking import FAILED_IN_A_ROW, WAITS, Job, Rows, RunPlan, Walker
from reverie_eval.runner._workers import walk_in_workers, walk_with_executor
from reverie_eval.scoring import Executor
from reverie_eval.simulator import Environment, Stop
from reverie_eval.submissions import join_items, submission_text
from reverie_eval.text import count_text, first_few
from reverie_eval.version import __version__

Record: TypeAlias = dict[str, Any]
"""An episode's record in a submission, in the official form."""


class AttemptEnd(NamedTuple):
    """The end of an attempt at an episode."""

    attempt: Attempt
    wait: float | None
    """Seconds until the episode is tried again; None if it is not."""


@contextmanager
def _returning() -> Iterator[None]:
    """Go back to the working directory, wherever an agent went."""
    here = Path.cwd()
    try:
        yield
    finally:
        os.chdir(here)


@_returning()
def run(
    plan: RunPlan,
    folder: str | PathLike[str],
    *,
    jobs: int = 1,
    threads: bool = False,
    executor: Executor | None = None,
    fill_missing: bool = False,
    on_attempt: Callable[[AttemptEnd], None] = lambda _: None,
) -> Totals:
    """Run the episodes that are left, and write the submission.

    An agent may change the working directory; afterwards it is what it was.

    Parameters
    ----------
    plan : RunPlan
    folder : path
        A new folder, or one of a run that was ended before its time: that goes on.
    jobs : int
        Number of processes, each with an agent of its own; with one, it is this one.
    threads : bool
        Whether they are threads of this process, for agents that wait for an endpoint.
    executor : optional
        Runs episodes instead: anything with ``submit(function, argument)`` whose futures have
        ``done``, ``result`` and ``cancel``, such as an executor of ``concurrent.futures`` or
        submitit, or Dask's client. It gets twenty episodes at a time, and what these did is on disk
        when all twenty have ended.
    fill_missing : bool
        Run nothing, and write a submission with a stop at the start, without an answer, for each
        episode that has no answer yet.
    on_attempt : callable
        Called when an attempt has ended.

    Raises
    ------
    RunError
        If the folder has another run in it, or none that could be filled, an error stopped the run,
        or episodes are left without an answer.
    ReverieEvalError
        If there is no such agent, or there are no such boxes or pictures.
    GroundTruthError
        If the agent needs the solution, and the bundle is public.
    """
    folder, episodes = Path(folder).absolute(), plan.ground_truth.episodes.instr_ids
    if fill_missing and not _has_attempts(folder):
        raise RunError(f"{folder} has no run to fill; run it first, without --fill-missing")
    plan = replace(plan, boxes=_absolute(plan.boxes), pictures=_absolute(plan.pictures))
    _check_solution(plan)
    environment = plan.environment()  # says what is wrong before there is a folder
    identity = _identity(plan, environment)
    with RunFolder(folder, episodes, identity, _circumstance(plan, jobs)) as files:
        queue = _Queue([] if fill_missing else episodes, files)
        if queue.waiting:  # an earlier one may have been filled
            files.remove(SUBMISSION)

        def rows() -> Rows:
            if executor is not None:
                return walk_with_executor(plan, queue.take, executor, queue.is_stopped)
            workers = min(jobs, len(queue.waiting))
            if workers <= 1:
                return Walker(plan, environment).work(queue.take)
            return walk_in_workers(plan, environment, queue.take, workers, threads=threads)

        try:
            if queue.waiting:
                queue.work_off(rows(), on_attempt)
        finally:
            kept = files.kept
            left = [each for each in episodes if each not in kept]
            filled = len(left) if fill_missing else 0
            totals = Totals.of(files.attempts, episodes, filled)
            files.write_card(totals)
        if left and not fill_missing:
            raise RunError(
                f"{count_text(len(left), 'episode')} of {len(episodes):,} failed, such as "
                f"{first_few(left)} ({folder / EPISODES}); the same command tries them again, and "
                "--fill-missing writes the submission with a stop at the start for each"
            )
        files.write(SUBMISSION, submission_text(_records(plan, environment, kept)).encode())
    return totals


def run_agent(name: str, ground_truth: GroundTruth, seed: int = 0) -> list[Record]:
    """Run an agent on a split, and return its submission without keeping anything else.

    Parameters
    ----------
    name : str
        As in :class:`AgentSource`.
    ground_truth : GroundTruth
    seed : int
        Seed of the agent's random choices.

    Raises
    ------
    RunError
        If an error ended an episode.
    GroundTruthError
        If the agent needs the solution, and the bundle is public.
    """
    plan = RunPlan(AgentSource(name), ground_truth, seed=seed)
    _check_solution(plan)
    jobs = iter([Job(each, 1) for each in ground_truth.episodes.instr_ids])
    kept = {}
    for row in Walker(plan).work(lambda: next(jobs, None)):
        if isinstance(row, Attempt):
            if row.record is None:
                raise RunError(f"{row.episode}: {row.reason}")
            kept[row.episode] = row
    return _records(plan, plan.environment(), kept)


def _absolute(given: str | PathLike[str] | None) -> Path | None:
    return None if given is None else Path(given).absolute()


def _check_solution(plan: RunPlan) -> None:
    if plan.agent.needs_solution:
        plan.ground_truth.require_solution()


def _has_attempts(folder: Path) -> bool:
    try:
        return next(read_attempts(folder), None) is not None
    except (FileNotFoundError, NotADirectoryError):
        return False


class _Queue:
    """The attempts that are to be made."""

    def __init__(self, episodes: Sequence[str], files: RunFolder) -> None:
        self._files = files
        begun = Counter(each.episode for each in files.attempts)
        done = files.kept
        self.waiting = deque(Job(each, begun[each] + 1) for each in episodes if each not in done)
        self._retried: Counter[str] = Counter()
        self._in_a_row = 0
        self._stopped = ""

    def work_off(self, rows: Rows, on_attempt: Callable[[AttemptEnd], None]) -> None:
        """Keep what happens as the attempts are made; raise RunError if an error stops the run."""
        with closing(rows):
            for row in rows:
                self._files.add(row)
                if isinstance(row, Attempt):
                    on_attempt(AttemptEnd(row, self._decide(row)))
        if self._stopped:
            raise RunError(f"the run stopped: {self._stopped}")

    def take(self) -> Job | None:
        """Return the next attempt to make; None if there is none now."""
        return self.waiting.popleft() if self.waiting else None

    def is_stopped(self) -> bool:
        """Whether an error ends the run."""
        return bool(self._stopped)

    def _decide(self, attempt: Attempt) -> float | None:
        """Return the seconds after which an episode is tried again; None if it is not."""
        if attempt.state in KEPT:
            self._in_a_row = 0
            return None
        if not attempt.is_retried:
            self._stop(f"{attempt.episode}: {attempt.reason}")
            return None
        waits = WAITS[self._retried[attempt.episode] :]
        if waits and not self._stopped:
            self._retried[attempt.episode] += 1
            due = time.time() + waits[0]
            self.waiting.appendleft(Job(attempt.episode, attempt.attempt + 1, due))
            return waits[0]
        self._in_a_row += 1
        if self._in_a_row == FAILED_IN_A_ROW:
            self._stop(f"{FAILED_IN_A_ROW} episodes in a row failed, the last by {attempt.reason}")
        return None

    def _stop(self, reason: str) -> None:
        """Let the episodes that are being run end, and begin no other."""
        self._stopped = self._stopped or reason
        self.waiting.clear()


def _records(plan: RunPlan, environment: Environment, kept: Mapping[str, Attempt]) -> list[Record]:
    """Return the submission's records in the order of the split, missing ones filled."""
    records = [
        dict(kept[each].record or {}) if each in kept else _stop_at(environment, each)
        for each in environment.episodes
    ]
    return join_items(records) if plan.ground_truth.task.has_items else records


def _stop_at(environment: Environment, episode: str) -> Record:
    environment.reset(episode)
    environment.step(Stop())
    return environment.record(episode)


def _identity(plan: RunPlan, environment: Environment) -> Identity:
    truth = plan.ground_truth
    return Identity(
        task=truth.task.name,
        split=truth.split,
        fingerprint=truth.fingerprint,
        shown=environment.surroundings.unscored_digest,
        episodes=truth.subset_digest or "all",
        agent=plan.agent.title,
        agent_version=plan.agent.version,
        agent_digest=plan.agent.digest,
        options=plan.agent.identity,
        seed=plan.seed,
        limits=plan.limits,
        boxes=_source_of_boxes(plan),
        pictures=_source_of_pictures(plan),
        reverie_eval=__version__,
    )


def _source_of_boxes(plan: RunPlan) -> str:
    if plan.boxes is None:
        return "none" if plan.ground_truth.solution is None else "solution"
    path = Path(plan.boxes)
    return _sizes([path]) if path.is_dir() else hashlib.sha256(path.read_bytes()).hexdigest()


def _source_of_pictures(plan: RunPlan) -> str:
    if plan.pictures is None:
        return "none"
    scans = sorted(set(plan.ground_truth.graph.scan_ids))
    return _sizes(Path(plan.pictures, scan, "matterport_skybox_images") for scan in scans)


def _sizes(folders: Iterable[Path]) -> str:
    """Return a digest of names and sizes, which tell releases of thousands of files apart."""
    digest = hashlib.sha256()
    for folder in filter(Path.is_dir, folders):
        for each in sorted(os.scandir(folder), key=lambda entry: entry.name):
            digest.update(f"{each.name} {each.stat().st_size}\n".encode())
    return digest.hexdigest()


def _circumstance(plan: RunPlan, jobs: int) -> Circumstance:
    return Circumstance(
        started=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        jobs=jobs,
        options=plan.agent.options,
        ground_truth=plan.ground_truth.origin,
        boxes=None if plan.boxes is None else str(plan.boxes),
        pictures=None if plan.pictures is None else str(plan.pictures),
        python=platform.python_version(),
        platform=platform.platform(),
    )
