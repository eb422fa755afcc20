"""What agents have in common: how they are called, and what they are given for an episode."""

import random
import typing
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from reverie_eval.ground_truth import GroundTruth
from reverie_eval.logs import Usage
from reverie_eval.simulator import Action, Answer, Observation, Stop


class Agent(typing.Protocol):
    """Walks the episodes of a split, one after the other."""

    def start(self, episode: "Episode", /) -> None:
        """Begin an episode."""

    def act(self, observation: Observation, /) -> Action:
        """Choose the next action."""


class BatchAgent(typing.Protocol):
    """Walks several episodes at a time, for models that choose many actions at once."""

    batch_size: int
    """How many episodes it takes at a time, at most."""

    def start(self, episode: "Episode", /) -> None:
        """Begin an episode, while others go on."""

    def act_batch(
        self, episodes: Sequence["Episode"], observations: Sequence[Observation], /
    ) -> Sequence[Action]:
        """Choose the next action in each of the episodes that were begun and are not over.

        An action must not depend on which other episodes there are: that is chance. What is
        remembered of an episode can be its :attr:`Episode.memory`.
        """


class Solved(NamedTuple):
    """The part of the solution that a perfect agent needs."""

    route: tuple[str, ...]
    """The viewpoints of the shortest route to the goal, without the start."""
    answer: Action


class Episode:
    """An episode as an agent is given it. The instruction is in the observations.

    Parameters
    ----------
    truth : GroundTruth
    row : int
        The episode's row.
    rng : random.Random
        Seeded for this episode, if it should not matter in which order episodes are run.
    """

    def __init__(self, truth: GroundTruth, row: int, rng: random.Random) -> None:
        self._truth = truth
        self._row = row
        self._notes: dict[str, Any] = {}
        self._usage: Counter[str] = Counter()
        self.task = truth.task.name
        """The benchmark, such as ``reverie``."""
        self.split = truth.split
        self.rng = rng
        """For all random choices; for another library's generator, ``rng.getrandbits(32)``."""
        self.memory: Any = None
        """For an agent that walks several episodes at a time: what it remembers of this one."""
        self.is_solution_read = False
        """Whether the agent asked for the solution."""

    def log(
        self,
        *,
        input_tokens: int | None = None,
        cached_tokens: int | None = None,
        output_tokens: int | None = None,
        reasoning_tokens: int | None = None,
        money: float | None = None,
        **notes: Any,
    ) -> None:
        """Log something about the action that is being chosen: anything that JSON can say.

        Tokens and US dollars of several calls are added up; those that are never given are unknown.

        Raises
        ------
        TypeError
            If tokens or money are not a number.
        """
        usage = {
            "input_tokens": input_tokens,
            "cached_tokens": cached_tokens,
            "output_tokens": output_tokens,
            "reasoning_tokens": reasoning_tokens,
            "money": money,
        }
        for name, number in usage.items():
            if number is not None:
                try:
                    self._usage[name] += number  # type: ignore[assignment]  # money is a float
                except TypeError:
                    message = f"{name} should be a number to add up, not {number!r}"
                    raise TypeError(message) from None
        self._notes |= notes

    @property
    def has_logged(self) -> bool:
        """Whether something was logged since :meth:`take_log`."""
        return bool(self._notes or self._usage)

    def take_log(self) -> tuple[Usage, Mapping[str, Any]]:
        """Return and forget what was logged."""
        taken: dict[str, Any] = dict(self._usage)
        notes, self._notes, self._usage = self._notes, {}, Counter()
        return Usage(**taken), notes

    def solution(self) -> Solved:
        """Return the shortest route and the right answer, for agents that show what is possible.

        A run's record says that its agent read the solution.

        Raises
        ------
        GroundTruthError
            If the bundle is public.
        """
        self.is_solution_read = True
        solution, graph = self._truth.require_solution(), self._truth.graph
        start = int(self._truth.episodes.start[self._row])
        route = graph.routes_from(start)[int(solution.goal[self._row])]
        answer: Action = Stop()
        if self._truth.task.has_targets:
            answer = Answer(int(solution.target_object[self._row]))
        return Solved(tuple(graph.viewpoint_ids[viewpoint] for viewpoint in route[1:]), answer)
