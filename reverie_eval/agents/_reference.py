"""The reference agents of REVERIE's paper that need no training: Stop, Shortest and Random.

They are baselines of Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in Real
Indoor Environments", CVPR 2020, section 5.
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from reverie_eval.agents._episode import Agent, Episode
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
