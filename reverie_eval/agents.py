"""The reference agents: Stop, Shortest and Random.

They are the baselines of Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in Real
Indoor Environments", CVPR 2020, section 5, that need no training.
"""

import random
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

from reverie_eval.ground_truth import GroundTruth
from reverie_eval.simulator import Action, Answer, Environment, Go, Observation, Stop, run_episode

MAX_RANDOM_STEPS = 10

Record: TypeAlias = dict[str, Any]

Agent: TypeAlias = Callable[[Observation], Action]
"""Chooses the next action in an episode; each episode has its own."""


def stop(truth: GroundTruth, row: int, rng: random.Random) -> Agent:  # noqa: ARG001
    """Stay at the start and predict no object."""
    return lambda _: Stop()


def shortest(truth: GroundTruth, row: int, rng: random.Random) -> Agent:  # noqa: ARG001
    """Follow the shortest route to the goal and predict the target object."""
    solution, graph = truth.require_solution(), truth.graph
    route = graph.routes_from(int(truth.episodes.start[row]))[int(solution.goal[row])]
    ahead = [graph.viewpoint_ids[viewpoint] for viewpoint in reversed(route[1:])]
    last = Answer(int(solution.target_object[row])) if truth.task.has_targets else Stop()
    return lambda _: Go(ahead.pop()) if ahead else last


def random_walk(truth: GroundTruth, row: int, rng: random.Random) -> Agent:  # noqa: ARG001
    """Walk up to ten random steps and predict a random object visible at the end."""
    steps = iter(range(rng.randint(0, MAX_RANDOM_STEPS)))

    def act(seen: Observation) -> Action:
        if seen.neighbours and next(steps, None) is not None:
            return Go(rng.choice(seen.neighbours).viewpoint_id)
        return Answer(rng.choice(seen.candidates).object_id) if seen.candidates else Stop()

    return act


AGENTS: Mapping[str, Callable[[GroundTruth, int, random.Random], Agent]] = MappingProxyType(
    {"shortest": shortest, "random": random_walk, "stop": stop}
)
"""The reference agents by name: each is made for an episode, which is given by its row."""


def run_agent(name: str, ground_truth: GroundTruth, seed: int = 0) -> list[Record]:
    """Run an agent on every episode of a split and return its submission.

    Parameters
    ----------
    name : str
        A name in ``AGENTS``.
    ground_truth : GroundTruth
        A bundle with the solution.
    seed : int
        Seed for the agent's random choices; the same seed gives the same submission.

    Raises
    ------
    GroundTruthError
        If the bundle is public.
    """
    ground_truth.require_solution()
    environment, rng = Environment(ground_truth), random.Random(seed)  # noqa: S311
    for row, instr_id in enumerate(environment.episodes):
        run_episode(environment, AGENTS[name](ground_truth, row, rng), instr_id)
    return environment.submission()
