"""Attempts at episodes: the agent's actions, until it ends, a limit is reached or it fails."""

import hashlib
import random
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from os import PathLike
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

from reverie_eval.agents import AgentSource, Episode
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.logs import Attempt, State, Step, total_usage
from reverie_eval.runner._folder import Limits, encode
from reverie_eval.simulator import Action, Environment, Stop
from reverie_eval.simulator.conformance import ConformanceError
from reverie_eval.text import count_text

Treatment = Literal["retry", "cut_off", "stop"]
"""What is done about an error: it is worth another attempt, it cuts the episode off, or it stops
the run."""

TREATMENTS: Mapping[str, Treatment] = MappingProxyType(
    {
        # What the agent did cannot be done where it is: it ends there, without an answer.
        "reverie_eval.errors.ActionError": "cut_off",
        # A language model: it refused, its reply was cut off or has no action also after it was
        # asked again, or it was sent more than it can read. All other errors of its endpoint stop
        # the run, as a wrong key and an unknown model do.
        "reverie_eval.agents.chat.errors.RefusalError": "cut_off",
        "reverie_eval.agents.chat.errors.CutReplyError": "cut_off",
        "reverie_eval.agents.chat.errors.WrongActionError": "cut_off",
        "reverie_eval.agents.chat.errors.LongPromptError": "cut_off",
        "reverie_eval.agents.chat.errors.BusyError": "retry",
        # An agent says so itself.
        "reverie_eval.runner.TransientError": "retry",
        # The network, or the other end.
        "builtins.ConnectionError": "retry",
        "builtins.TimeoutError": "retry",
        "asyncio.exceptions.TimeoutError": "retry",
        "concurrent.futures._base.TimeoutError": "retry",
        "http.client.IncompleteRead": "retry",
        "http.client.RemoteDisconnected": "retry",
        "urllib.error.HTTPError": "stop",  # a kind of URLError: a wrong key will stay wrong
        "urllib.error.URLError": "retry",
        "requests.exceptions.ConnectionError": "retry",
        "requests.exceptions.Timeout": "retry",
        "httpx.TransportError": "retry",
        "aiohttp.client_exceptions.ClientConnectionError": "retry",
        "openai.APIConnectionError": "retry",
        "openai.InternalServerError": "retry",
        "openai.RateLimitError": "retry",
        "anthropic.APIConnectionError": "retry",
        "anthropic.InternalServerError": "retry",
        "anthropic.RateLimitError": "retry",
    }
)
"""What is done about errors, by class: the first of an error's bases that is named here decides. An
error that is not named stops the run, because nobody knows whether it is the agent's, the
endpoint's or ours."""

WAITS = (1.0, 4.0, 16.0, 64.0)
"""Seconds before the second attempt, the third and so on; after the last, the episode failed."""

FAILED_IN_A_ROW = 3
"""So many failed episodes without another in between stop the run: an endpoint is gone."""

_ACTIONS = get_args(Action)
# What ends a run from outside. All else is an error of the agent, its `sys.exit` and what asyncio
# cancelled included.
_ENDS = (KeyboardInterrupt, GeneratorExit)


class TransientError(Exception):
    """For agents to raise: something outside failed, and the episode is worth another attempt."""


TransientError.__module__ = "reverie_eval.runner"


def treatment_of(error: BaseException) -> Treatment:
    """Return what is done about an error."""
    for base in type(error).__mro__:
        name = f"{base.__module__}.{base.__qualname__}"
        if name in TREATMENTS:
            return TREATMENTS[name]
    return "stop"


class Job(NamedTuple):
    """An attempt that is to be made."""

    episode: str
    attempt: int
    """Counted from 1."""
    due: float = 0.0
    """When it may begin, in seconds since 1970."""


Take: TypeAlias = Callable[[], Job | None]
"""Returns the next attempt to make; None if there is none now."""
Rows: TypeAlias = Generator[Step | Attempt]


@dataclass(frozen=True)
class RunPlan:
    """What is to be run: which agent, on which episodes, with what to observe, and how long."""

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
    """Runs episodes with an agent, as many at a time as it takes.

    Parameters
    ----------
    plan : RunPlan
    environment : Environment, optional
        One of the plan, if there is one already.
    most : int, optional
        Episodes at a time, at most, also if the agent takes more.
    """

    def __init__(
        self, plan: RunPlan, environment: Environment | None = None, most: int | None = None
    ) -> None:
        self._plan = plan
        agent: Any = plan.agent.make()
        self._agent = agent
        self._is_batch = hasattr(self._agent, "act_batch")
        size: int = self._agent.batch_size if self._is_batch else 1
        environment = environment or plan.environment()
        self._free = [environment.copy() for _ in range(min(size, most or size))]

    def work(self, take: Take) -> Rows:
        """Yield each step, and each attempt when it ends, whatever the agent does."""
        walks: list[_Walk] = []
        while True:
            while self._free and (job := take()) is not None:
                time.sleep(max(0.0, job.due - time.time()))
                walks.append(walk := _Walk(job, self._plan, self._free.pop()))
                walk.start(self._agent)
            if not walks:
                return
            going = [walk for walk in walks if walk.goes_on()]
            for walk, action in zip(going, self._choose(going), strict=False):
                with walk.catching():
                    yield walk.note(action)
                    walk.do(action)
            for walk in [walk for walk in walks if walk.is_done]:
                walks.remove(walk)
                self._free.append(walk.environment)
                yield from walk.end()

    def _choose(self, walks: Sequence["_Walk"]) -> Sequence[Action]:
        """Return an action for each walk; none if the agent fails, because all of them do then."""
        if not walks:
            return []
        began = time.perf_counter()
        try:
            return self._act(walks)
        except _ENDS:
            raise
        except BaseException as error:  # noqa: BLE001
            for walk in walks:
                walk.error = error
            return []
        finally:
            share = (time.perf_counter() - began) / len(walks)
            for walk in walks:
                walk.seconds = share
                walk.all_seconds += share

    def _act(self, walks: Sequence["_Walk"]) -> Sequence[Action]:
        if not self._is_batch:
            return [self._agent.act(walks[0].seen)]
        actions = self._agent.act_batch(
            [walk.episode for walk in walks], [walk.seen for walk in walks]
        )
        if not isinstance(actions, Sequence) or len(actions) != len(walks):
            raise TypeError(
                f"act_batch returned {actions!r}; expected a list of {len(walks)} actions, one for "
                "each episode"
            )
        return actions


class _Walk:
    """An attempt so far."""

    def __init__(self, job: Job, plan: RunPlan, environment: Environment) -> None:
        truth = plan.ground_truth
        self._job = job
        self._plan = plan
        self._steps: list[Step] = []
        self._reason = ""
        self.environment = environment
        self.error: BaseException | None = None
        self.seconds = 0.0
        """How long the agent took for its last choice."""
        self.all_seconds = 0.0
        """How long it took to start, and for all choices, also for one that failed."""
        rng = random.Random(_seed(plan.seed, job.episode))  # noqa: S311
        self.episode = Episode(truth, truth.row_of(job.episode), rng)
        environment.forget_parts_read()
        self._began = time.perf_counter()
        self.seen = environment.reset(job.episode)

    @contextmanager
    def catching(self) -> Iterator[None]:
        """Let an error of the agent end the attempt."""
        try:
            yield
        except _ENDS:
            raise
        except BaseException as error:  # noqa: BLE001
            self.error = error

    def start(self, agent: Any) -> None:
        """Tell the agent that the episode begins."""
        with self.catching():
            agent.start(self.episode)
        self.all_seconds = time.perf_counter() - self._began

    @property
    def is_done(self) -> bool:
        """Whether the attempt is to end."""
        return self.seen.is_over or bool(self._reason) or self.error is not None

    def goes_on(self) -> bool:
        """Whether the agent is to choose an action: it ended nothing, and no limit is reached."""
        if not self.is_done:
            self._reason = self._limit()
        return not self.is_done

    def _limit(self) -> str:
        """Return the limit that is reached, or an empty text."""
        most = self._plan.limits
        if len(self._steps) >= most.steps:
            return count_text(most.steps, "step")
        if most.seconds is not None and time.perf_counter() - self._began >= most.seconds:
            return f"{most.seconds:g} seconds"
        return ""

    def note(self, action: Action) -> Step:
        """Return the step that an action is; raise TypeError if it cannot be logged."""
        if not isinstance(action, _ACTIONS):
            raise TypeError(f"the agent returned {action!r}, which is not an action")
        arguments = {each.name: getattr(action, each.name) for each in fields(action)}
        return self._note(type(action).__name__, arguments)

    def _note(self, action: str, arguments: dict[str, Any]) -> Step:
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
            seconds=self.seconds,
            notes=notes,
            **asdict(usage),
        )
        encode(step)
        self._steps.append(step)
        return step

    def do(self, action: Action) -> None:
        """Do an action."""
        self.seen = self.environment.step(action)

    def end(self) -> Iterator[Step | Attempt]:
        """Yield what the agent logged before it failed, as a step, and the end."""
        if self.error and self.episode.has_logged:
            with self.catching():
                yield self._note("", {})
        state: State = "cut_off" if self._reason else "ended"
        treatment = None
        if self.error:
            self._reason = self._plan.agent.describe(self.error)
            treatment = treatment_of(self.error)
            state = "cut_off" if treatment == "cut_off" else "failed"
        if state == "cut_off":
            self.environment.step(Stop())
        is_failed = state == "failed"
        read = {*self.environment.parts_read, *["solution"] * self.episode.is_solution_read}
        yield Attempt(
            episode=self._job.episode,
            attempt=self._job.attempt,
            state=state,
            reason=self._reason,
            steps=len(self._steps),
            seconds=self.all_seconds,
            read=tuple(sorted(read)),
            is_retried=treatment == "retry",
            traceback="".join(traceback.format_exception(self.error)) if is_failed else "",
            record=None if is_failed else self.environment.record(self._job.episode),
            **asdict(total_usage(self._steps)),
        )


def _seed(seed: int, episode: str) -> int:
    """Return the seed of an episode, which does not depend on what was run before it."""
    return int.from_bytes(hashlib.sha256(f"{seed}:{episode}".encode()).digest()[:8], "big")


# A check for agents of your own, for a test of yours to call.


def check_agent(plan: RunPlan, *, number: int = 5) -> frozenset[str]:
    """Let an agent walk some episodes twice, and return what it read, as a run's record says it.

    The second time is in reverse order, and one episode at a time: an agent that remembers what it
    should not, or whose batches are not independent, does something else then.

    Parameters
    ----------
    plan : RunPlan
        The agent, and the episodes of which it walks the first.
    number : int
        Episodes that are walked.

    Raises
    ------
    ConformanceError
        If the agent does something else the second time, fails, does not end an episode, or does
        what cannot be done.
    """
    episodes = plan.ground_truth.episodes.instr_ids[:number]
    first, read = _walk_all(Walker(plan), episodes)
    second, _ = _walk_all(Walker(plan, most=1), episodes[::-1])
    for episode, actions in first.items():
        if actions != second[episode]:
            raise ConformanceError(f"{episode}: the agent does something else the second time")
    return read


def _walk_all(
    walker: Walker, episodes: Iterable[str]
) -> tuple[Mapping[str, list[object]], frozenset[str]]:
    """Return the actions in each episode, and all that was read."""
    jobs = iter([Job(episode, 1) for episode in episodes])
    actions: dict[str, list[object]] = {}
    read: set[str] = set()
    for row in walker.work(lambda: next(jobs, None)):
        if isinstance(row, Step):
            actions.setdefault(row.episode, []).append((row.action, row.arguments))
        elif row.state != "ended":
            raise ConformanceError(f"{row.episode}: {row.reason}")
        else:
            read.update(row.read)
    return actions, frozenset(read)
