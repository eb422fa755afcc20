"""Episodes that a person plays: where they can go, what they can point at, and what it scores.

A person sees what an agent sees: the instruction, the connected viewpoints, and the visible
objects, but not which of them is the target. The walk is in the address of the page, so nothing is
stored.
"""

import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from reverie_eval.agents import Surroundings
from reverie_eval.analysis import Episode, VisibleObject, episode
from reverie_eval.metrics import ABSTAINED
from reverie_eval.scoring import PreparedSubmission
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.episodes import Browsing, align_walks

MOST_STEPS = 200
"""Steps of a walk, at most; twenty times as many as annotated paths have."""


@dataclass(frozen=True, slots=True)
class Way:
    """A viewpoint that a person can move to from where they are."""

    number: int
    """The viewpoint's number in its scan."""
    heading: float
    """Radians."""
    elevation: float
    """Radians."""
    metres: float


@dataclass(frozen=True)
class HumanWalk:
    """The steps of a person through an episode so far."""

    board: Board
    annotated: Episode
    steps: Sequence[int]
    """The viewpoints after the start, by their numbers in the scan."""

    @classmethod
    def of(cls, browsing: Browsing, seed: int, number: int, steps: Sequence[int]) -> "HumanWalk":
        """Follow a person's steps through an episode, given by its number from 1 in a sample.

        Raises
        ------
        NotFoundError
            If the split has fewer episodes, or scores only answers.
        MalformedError
            If a step is not one of the ways on, or there are too many.
        """
        if browsing.board.split.track == "grounding":
            raise NotFoundError(f"{browsing.board.name} scores answers alone; there are no walks")
        drawn = sample(browsing.board, seed, number)
        if len(drawn) < number:
            raise NotFoundError(f"{browsing.board.name} has {len(drawn)} episodes")
        walk = cls(browsing.board, browsing.episode(drawn[-1]), steps)
        if len(steps) > MOST_STEPS:
            raise MalformedError(f"a walk has at most {MOST_STEPS} steps")
        for here, there in pairwise(walk.viewpoints):
            if there not in walk._surroundings.neighbours(here):
                raise MalformedError("the walk has a step to a viewpoint that is not connected")
        return walk

    @cached_property
    def viewpoints(self) -> Sequence[int]:
        """The viewpoints of the walk, from the start, as the graph numbers them."""
        graph = self.board.truth.graph
        start = graph.index[self.annotated.start]
        scan = np.flatnonzero(graph.viewpoint_scan == graph.viewpoint_scan[start])
        if not all(step < len(scan) for step in self.steps):
            raise MalformedError("the walk has a step to a viewpoint that does not exist")
        return [start, *scan[list(self.steps)].tolist()]

    @property
    def here(self) -> str:
        """The id of the viewpoint where the person is."""
        return self.board.truth.graph.viewpoint_ids[self.viewpoints[-1]]

    @property
    def heading(self) -> float:
        """The heading of the last move, radians; 0 at the start."""
        return float(self._surroundings.poses(self.viewpoints)[-1][1])

    @property
    def metres(self) -> float:
        """The length of the walk so far."""
        walked = np.array(self.viewpoints)
        return float(self.board.truth.graph.distance_between(walked[:-1], walked[1:]).sum())

    @property
    def ways(self) -> Sequence[Way]:
        """The viewpoints that the person can move to, by heading."""
        graph, here = self.board.truth.graph, self.viewpoints[-1]
        first = int(np.searchsorted(graph.viewpoint_scan, graph.viewpoint_scan[here]))
        found = []
        for there in self._surroundings.neighbours(here):
            if there != here:
                (_, heading, elevation) = self._surroundings.poses([here, there])[1]
                pair = np.array([here]), np.array([there])
                metres = float(graph.distance_between(*pair)[0])
                found.append(Way(there - first, float(heading), float(elevation), metres))
        return sorted(found, key=lambda way: way.heading)

    @property
    def objects(self) -> Sequence[VisibleObject]:
        """The objects that are visible, by object id."""
        return self.annotated.visible_objects(self.here)

    def answered(self, object_id: int | None) -> Episode:
        """Return the episode as the person ended it, scored under the rules of the split.

        Raises
        ------
        MalformedError
            If no such object is visible.
        """
        self._check_visible(object_id)
        truth, row = self.board.truth, self.board.truth.episodes.index[self.annotated.instr_id]
        answer = ABSTAINED if object_id is None else object_id
        walks = align_walks(truth, {row: (self.viewpoints, answer)})
        scores = self.board.score(PreparedSubmission(walks, truth))
        return episode(scores, self.annotated.instr_id)

    def record(self, object_id: int | None) -> Mapping[str, Any]:
        """Return the walk as a record of a submission."""
        self._check_visible(object_id)
        task, answer = self.board.task, ABSTAINED if object_id is None else object_id
        return {
            **task.id_field(self.annotated.instr_id),
            "trajectory": self._surroundings.poses(self.viewpoints),
            **({"predObjId": answer} if task.has_targets else {}),
        }

    @cached_property
    def _surroundings(self) -> Surroundings:
        return Surroundings(self.board.truth)

    def _check_visible(self, object_id: int | None) -> None:
        if object_id is not None and object_id not in {each.object_id for each in self.objects}:
            raise MalformedError(f"object {object_id} is not visible from where the walk ends")


def sample(board: Board, seed: int, size: int) -> Sequence[str]:
    """Draw distinct episodes at random; the same seed draws the same ones in the same order.

    Every item has one instruction before any has a second, because a target is known once seen.
    """
    ids, items = board.truth.episodes.instr_ids, board.truth.episodes.item.tolist()
    shuffled = random.Random(seed).sample(range(len(ids)), len(ids))  # noqa: S311
    earlier: Counter[int] = Counter()
    turns = {}
    for row in shuffled:
        turns[row] = earlier[items[row]]
        earlier[items[row]] += 1
    return [ids[row] for row in sorted(shuffled, key=turns.__getitem__)[:size]]
