"""One attempt at an episode: the agent's actions, until it ends, a limit is reached or it fails."""

import hashlib
import random
import time
import traceback
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, get_args

from reverie_eval.agents import AgentSource, Episode
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.logs import Attempt, State, Step, total_usage
from reverie_eval.runner._failures import treatment_of
from reverie_eval.runner._records import Limits, encode
from reverie_eval.simulator import Action, Environment, Stop

_ACTIONS = get_args(Action)


class Job(NamedTuple):
    """An attempt that is to be made."""

    episode: str
    attempt: int
    """Counted from 1."""
    wait: float = 0.0
    """Seconds to wait before it."""


@dataclass(frozen=True)
class Plan:
    """The task of a run: which agent, on which episodes, with what to observe, and how long."""

    agent: AgentSource
    ground_truth: GroundTruth
    boxes: str | PathLike[str] | None = None
    pictures: str | PathLike[str] | None = None
    seed: int = 0
    limits: Limits = field(default_factory=Limits)

    def environment(self) -> Environment:
        """Return a new environment."""
        return Environment(self.ground_truth, boxes=self.boxes, pictures=self.pictures)


class Walker:
    """Runs episodes, one after the other, with one agent."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._environment = plan.environment()
        self._agent = plan.agent.make()

    def walk(self, job: Job) -> Iterator[Step | Attempt]:
        """Yield each step, and at last the attempt, whatever the agent does."""
        time.sleep(job.wait)
        walk = _Walk(job, self._plan, self._environment)
        try:
            self._agent.start(walk.episode)
            while walk.goes_on():
                action = self._agent.act(walk.seen)
                yield walk.note(action)
                walk.do(action)
            state: State = "stopped" if walk.reason else "answered"
        # The table says what is done about which; an agent's `sys.exit` must not pass for an end.
        except (Exception, SystemExit) as error:  # noqa: BLE001
            if unfinished := walk.note_failed():
                yield unfinished
            treatment = treatment_of(error)
            walk.reason = _shown(error)
            state = "stopped" if treatment == "answer" else "failed"
            if state == "failed":
                yield walk.attempt(state, treatment == "retry", traceback.format_exc())
                return
        yield walk.attempt(state)


class _Walk:
    """An attempt so far."""

    def __init__(self, job: Job, plan: Plan, environment: Environment) -> None:
        truth = plan.ground_truth
        self._job = job
        self._limits = plan.limits
        self._environment = environment
        self._steps: list[Step] = []
        self.reason = ""
        """Why it was stopped; empty if it was not."""
        rng = random.Random(_seed(plan.seed, job.episode))  # noqa: S311
        self.episode = Episode(truth, truth.row_of(job.episode), rng)
        environment.forget_parts_read()
        self._began = self._chosen = time.perf_counter()
        self.seen = environment.reset(job.episode)

    def goes_on(self) -> bool:
        """Whether the agent is to choose an action: it ended nothing, and no limit is reached."""
        if self.seen.is_over:
            return False
        self._chosen = time.perf_counter()
        self.reason = self._limit()
        return not self.reason

    def _limit(self) -> str:
        """Return the limit that is reached, or an empty text."""
        most = self._limits
        if len(self._steps) >= most.steps:
            return f"{most.steps} steps"
        if most.seconds is not None and self._chosen - self._began >= most.seconds:
            return f"{most.seconds:g} seconds"
        return ""

    def note(self, action: Action) -> Step:
        """Return the step that an action is; raise TypeError if it cannot be logged."""
        if not isinstance(action, _ACTIONS):
            raise TypeError(f"the agent returned {action!r}, which is not an action")
        arguments = {each.name: getattr(action, each.name) for each in fields(action)}
        return self._note(type(action).__name__, arguments)

    def note_failed(self) -> Step | None:
        """Return a step without an action, if the agent logged anything before it failed."""
        return self._note("", {}) if self.episode.has_logged else None

    def _note(self, action: str, arguments: dict[str, Any]) -> Step:
        seconds = time.perf_counter() - self._chosen
        usage, notes = self.episode.take_log()
        step = Step(
            episode=self._job.episode,
            attempt=self._job.attempt,
            step=len(self._steps) + 1,
            viewpoint_id=self.seen.viewpoint_id,
            heading=self.seen.heading,
            elevation=self.seen.elevation,
            action=action,
            arguments=arguments,
            seconds=seconds,
            notes=notes,
            **asdict(usage),
        )
        encode(step)
        self._steps.append(step)
        return step

    def do(self, action: Action) -> None:
        """Do an action."""
        self.seen = self._environment.step(action)

    def attempt(self, state: State, is_retried: bool = False, error: str = "") -> Attempt:  # noqa: FBT001, FBT002
        """Return the attempt that it was."""
        if state == "stopped":
            self._environment.step(Stop())
        read = {*self._environment.parts_read, *["solution"] * self.episode.is_solution_read}
        return Attempt(
            episode=self._job.episode,
            attempt=self._job.attempt,
            state=state,
            reason=self.reason,
            steps=len(self._steps),
            seconds=time.perf_counter() - self._began,
            read=tuple(sorted(read)),
            is_retried=is_retried,
            traceback=error,
            record=None if state == "failed" else self._environment.record(self._job.episode),
            **asdict(total_usage(self._steps)),
        )


def _shown(error: BaseException) -> str:
    """Return an error in a line, with where it was raised."""
    *_, last = traceback.extract_tb(error.__traceback__)
    return f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"


def _seed(seed: int, episode: str) -> int:
    """Return the seed of an episode, which does not depend on what was run before it."""
    return int.from_bytes(hashlib.sha256(f"{seed}:{episode}".encode()).digest()[:8], "big")
