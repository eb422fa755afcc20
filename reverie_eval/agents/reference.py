"""Stop, Shortest and Random.

References
----------
.. [1] Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in Real Indoor
   Environments", CVPR 2020, section 5: the baselines without learning.
"""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from reverie_eval.agents.surroundings import Surroundings
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import ABSTAINED

MAX_RANDOM_STEPS = 10

Record: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Task:
    """What an agent is told of an episode; the goal and the target are for those who cheat."""

    start: int
    goal: int
    target_object: int


@dataclass(frozen=True, slots=True)
class Behaviour:
    """Where an agent walked, and the object that it names at the end."""

    viewpoints: Sequence[int]
    object_id: int


Agent: TypeAlias = Callable[[Task, Surroundings, random.Random], Behaviour]


def stop(task: Task, surroundings: Surroundings, chance: random.Random) -> Behaviour:  # noqa: ARG001
    """Stay at the start and name no object."""
    return Behaviour([task.start], ABSTAINED)


def shortest(task: Task, surroundings: Surroundings, chance: random.Random) -> Behaviour:  # noqa: ARG001
    """Follow the shortest route to the goal and name the target."""
    return Behaviour(surroundings.shortest_route(task.start, task.goal), task.target_object)


def wander(task: Task, surroundings: Surroundings, chance: random.Random) -> Behaviour:
    """Walk up to ten random steps and name a random object that is visible at the end."""
    viewpoints = [task.start]
    for _ in range(chance.randint(0, MAX_RANDOM_STEPS)):
        viewpoints.append(chance.choice(surroundings.neighbours(viewpoints[-1])))
    visible = surroundings.visible_objects(viewpoints[-1])
    return Behaviour(viewpoints, chance.choice(visible) if visible else ABSTAINED)


AGENTS: Mapping[str, Agent] = MappingProxyType(
    {"shortest": shortest, "random": wander, "stop": stop}
)
"""Every reference agent by its name."""


def run_agent(name: str, ground_truth: GroundTruth, seed: int = 0) -> list[Record]:
    """Let an agent walk every episode of a split and return its submission.

    Parameters
    ----------
    name : str
        A name in ``AGENTS``.
    ground_truth : GroundTruth
        A bundle with answers.
    seed : int
        Of the agent's choices; the same seed gives the same submission.

    Raises
    ------
    GroundTruthError
        If the bundle is public.
    """
    answers, episodes = ground_truth.secret, ground_truth.episodes
    surroundings, chance = Surroundings(ground_truth), random.Random(seed)  # noqa: S311
    columns = np.stack([episodes.start, answers.goal, answers.target_object], axis=1)
    behaviours = [AGENTS[name](Task(*task), surroundings, chance) for task in columns.tolist()]
    return [
        {
            "instr_id": instr_id,
            "trajectory": surroundings.poses(behaviour.viewpoints),
            "predObjId": behaviour.object_id,
        }
        for instr_id, behaviour in zip(episodes.instr_ids, behaviours, strict=True)
    ]
