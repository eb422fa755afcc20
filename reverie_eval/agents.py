"""The reference agents: Stop, Shortest and Random.

They are the baselines of Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in Real
Indoor Environments", CVPR 2020, section 5, that need no training.
"""

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions import NO_POINT, join_items, official_point


class Surroundings:
    """The navigation graphs and candidates of a split, viewpoint by viewpoint."""

    def __init__(self, ground_truth: GroundTruth) -> None:
        self._graph = ground_truth.graph
        self._answers = ground_truth.require_answers()

    def neighbours(self, viewpoint: int) -> list[int]:
        """Return the connected viewpoints, or the viewpoint itself if there are none."""
        return list(self._graph.neighbours(viewpoint)) or [viewpoint]

    def shortest_route(self, start: int, goal: int) -> Sequence[int]:
        """Return the viewpoints of a shortest route, including both ends."""
        return self._graph.routes_from(start)[goal]

    def visible_objects(self, viewpoint: int) -> list[int]:
        """Return the ids of the objects visible from a viewpoint."""
        begin, end = np.searchsorted(self._answers.candidate_viewpoint, [viewpoint, viewpoint + 1])
        objects: list[int] = self._answers.candidate_object[begin:end].tolist()
        return objects

    def poses(self, viewpoints: Sequence[int]) -> list[list[str | float]]:
        """Return poses that face the direction of travel; the first faces north and level."""
        poses: list[list[str | float]] = []
        previous = viewpoints[0]
        for viewpoint in viewpoints:
            position = self._graph.viewpoint_position
            x, y, z = (position[viewpoint] - position[previous]).tolist()
            heading, elevation = math.atan2(x, y) % math.tau, math.atan2(z, math.hypot(x, y))
            poses.append([self._graph.viewpoint_ids[viewpoint], heading, elevation])
            previous = viewpoint
        return poses


MAX_RANDOM_STEPS = 10

Record: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True)
class AgentEpisode:
    """An episode as an agent sees it; only the Shortest agent uses the goal and the target."""

    start: int
    goal: int
    target_object: int


Behaviour: TypeAlias = tuple[Sequence[int], int]
"""The viewpoints an agent visited, and the object that it predicts."""

Agent: TypeAlias = Callable[[AgentEpisode, Surroundings, random.Random], Behaviour]


def stop(episode: AgentEpisode, surroundings: Surroundings, rng: random.Random) -> Behaviour:  # noqa: ARG001
    """Stay at the start and predict no object."""
    return [episode.start], ABSTAINED


def shortest(episode: AgentEpisode, surroundings: Surroundings, rng: random.Random) -> Behaviour:  # noqa: ARG001
    """Follow the shortest route to the goal and predict the target object."""
    return surroundings.shortest_route(episode.start, episode.goal), episode.target_object


def random_walk(episode: AgentEpisode, surroundings: Surroundings, rng: random.Random) -> Behaviour:
    """Walk up to ten random steps and predict a random object visible at the end."""
    viewpoints = [episode.start]
    for _ in range(rng.randint(0, MAX_RANDOM_STEPS)):
        viewpoints.append(rng.choice(surroundings.neighbours(viewpoints[-1])))
    visible = surroundings.visible_objects(viewpoints[-1])
    return viewpoints, rng.choice(visible) if visible else ABSTAINED


AGENTS: Mapping[str, Agent] = MappingProxyType(
    {"shortest": shortest, "random": random_walk, "stop": stop}
)
"""The reference agents by name."""


def run_agent(name: str, ground_truth: GroundTruth, seed: int = 0) -> list[Record]:
    """Run an agent on every episode of a split and return its submission.

    Parameters
    ----------
    name : str
        A name in ``AGENTS``.
    ground_truth : GroundTruth
        A bundle with answers.
    seed : int
        Seed for the agent's random choices; the same seed gives the same submission.

    Raises
    ------
    GroundTruthError
        If the bundle is public.
    """
    answers, episodes = ground_truth.require_answers(), ground_truth.episodes
    surroundings, rng = Surroundings(ground_truth), random.Random(seed)  # noqa: S311
    columns = np.stack([episodes.start, answers.goal, answers.target_object], axis=1)
    behaviours = [AGENTS[name](AgentEpisode(*each), surroundings, rng) for each in columns.tolist()]
    task = ground_truth.task
    records: list[Record] = [
        {
            **task.id_field(instr_id),
            "trajectory": surroundings.poses(viewpoints),
            **({"predObjId": object_id} if task.has_targets else {}),
            **(official_point(NO_POINT) if task.has_items else {}),
        }
        for instr_id, (viewpoints, object_id) in zip(episodes.instr_ids, behaviours, strict=True)
    ]
    return join_items(records) if task.has_items else records
