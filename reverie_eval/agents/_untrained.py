"""Agents that need no training: the paper's Stop, Shortest and Random, and two that explore.

The first three are baselines of Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in
Real Indoor Environments", CVPR 2020, section 5.
"""

import re
from collections.abc import Callable, Mapping
from heapq import heappop, heappush
from pathlib import Path
from types import MappingProxyType

from reverie_eval.agents._episode import Agent, Episode
from reverie_eval.errors import ReverieEvalError
from reverie_eval.simulator import Action, Answer, Go, Observation, Stop

MAX_RANDOM_STEPS = 10
DEMO_AGENT = Path(__file__).parent / "trained" / "demo" / "fast-short"
"""The folder of a trained agent: FAST-Short on the names of the demo world, with the submission of
its run on each open split of REVERIE's. ``python -m fixtures.demo_model`` renews it."""


class StopAgent:
    """Stays at the start and predicts no object."""

    def start(self, episode: Episode) -> None:
        """Do nothing."""

    def act(self, seen: Observation) -> Action:  # noqa: ARG002
        """Stop."""
        return Stop()


class ShortestAgent:
    """Follows the shortest route to the goal and predicts the target object, if it is visible."""

    needs_solution = True

    def start(self, episode: Episode) -> None:
        """Read the solution. Raises GroundTruthError if the bundle is public."""
        route, answer = episode.solution()
        self._ahead = iter([*map(Go, route), answer])

    def act(self, seen: Observation) -> Action:
        """Go on along the route."""
        action = next(self._ahead)
        visible = {candidate.object_id for candidate in seen.candidates}
        # The compiler refuses a target that is not visible at the end, but others make bundles too.
        return Stop() if isinstance(action, Answer) and action.object_id not in visible else action


class RandomAgent:
    """Walks up to ten random steps and predicts a random object visible at the end."""

    def start(self, episode: Episode) -> None:
        """Draw the number of steps."""
        self._rng = episode.rng
        self._steps = self._rng.randint(0, MAX_RANDOM_STEPS)

    def act(self, seen: Observation) -> Action:
        """Go to any neighbour, or predict any object."""
        if seen.neighbours and self._steps:
            self._steps -= 1
            return Go(self._rng.choice(seen.neighbours).viewpoint_id)
        return Answer(self._rng.choice(seen.candidates).object_id) if seen.candidates else Stop()


AGENTS: Mapping[str, type[Agent]] = MappingProxyType(
    {"shortest": ShortestAgent, "random": RandomAgent, "stop": StopAgent}
)
"""The reference agents of the paper, by name."""


def _checked(viewpoints: object) -> int:
    """Return a number of viewpoints to visit, which a command may have been given as anything."""
    if isinstance(viewpoints, int) and viewpoints >= 1:
        return viewpoints
    raise ReverieEvalError(
        f"option viewpoints must be a whole number, at least 1, got {viewpoints!r}"
    )


class Explored:
    """The part of a building that was seen so far."""

    def __init__(self) -> None:
        self.visited: set[str] = set()
        self._distances: dict[str, dict[str, float]] = {}

    def add(self, seen: Observation) -> None:
        """Add a viewpoint and the ways from it, which lead back as well."""
        here = seen.viewpoint_id
        self.visited.add(here)
        for way in seen.neighbours:
            self._distances.setdefault(here, {})[way.viewpoint_id] = way.distance
            self._distances.setdefault(way.viewpoint_id, {})[here] = way.distance

    def route(self, here: str, is_end: Callable[[str], bool]) -> list[str]:
        """Return the route to the nearest viewpoint of a kind, without ``here``; or none."""
        queue, done = [(0.0, here, list[str]())], set[str]()
        while queue:
            length, at, route = heappop(queue)
            if is_end(at):
                return route
            if at in done:
                continue
            done.add(at)
            for then, distance in self._distances.get(at, {}).items():
                heappush(queue, (length + distance, then, [*route, then]))
        return []

    def route_on(self, here: str) -> list[str]:
        """Return the route to the nearest viewpoint that was not visited; or none."""
        return self.route(here, lambda each: each not in self.visited)


class NearestFirstAgent:
    """Goes to the nearest viewpoint that it has not visited, again and again, and then stops.

    It reads distances alone.

    Parameters
    ----------
    viewpoints : int
        Viewpoints that it visits.
    """

    def __init__(self, viewpoints: int = 10) -> None:
        self._most = _checked(viewpoints)

    def start(self, episode: Episode) -> None:  # noqa: ARG002
        """Forget the last episode."""
        self._explored = Explored()

    def act(self, seen: Observation) -> Action:
        """Go on, or stop."""
        self._explored.add(seen)
        is_left = len(self._explored.visited) < self._most
        ahead = self._explored.route_on(seen.viewpoint_id) if is_left else []
        return Go(ahead[0]) if ahead else Stop()


class WordMatchAgent:
    """Explores until all words of an object's name are in the instruction, and predicts it.

    If there is no such object, it returns to the one that comes closest. It reads the instruction,
    distances, and the names of objects, which are the annotators'.

    Parameters
    ----------
    viewpoints : int
        Viewpoints that it visits at most.
    """

    def __init__(self, viewpoints: int = 20) -> None:
        self._most = _checked(viewpoints)

    def start(self, episode: Episode) -> None:  # noqa: ARG002
        """Forget the last episode."""
        self._explored = Explored()
        self._best = 0.0
        self._best_at = ""
        self._answer: Action = Stop()

    def act(self, seen: Observation) -> Action:
        """Go on, return to the best object, or predict it."""
        here = seen.viewpoint_id
        self._explored.add(seen)
        asked = _words(seen.instruction)
        for candidate in seen.candidates:
            named = _words(candidate.name)
            share = len(named & asked) / len(named) if named else 0.0
            if share > self._best:
                self._best, self._best_at = share, here
                self._answer = Answer(candidate.object_id)
        is_left = self._best < 1 and len(self._explored.visited) < self._most
        ahead = self._explored.route_on(here) if is_left else []
        ahead = ahead or self._explored.route(here, lambda each: each == self._best_at)
        return Go(ahead[0]) if ahead else self._answer


def _words(text: str) -> frozenset[str]:
    """Return the words of a text in lower case, each without a final s: chairs are a chair."""
    return frozenset(word.removesuffix("s") for word in re.findall("[a-z]+", text.lower()))
