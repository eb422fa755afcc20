"""Episodes that a person walks in the environment of agents, and what they score.

A person sees what an agent sees: the instruction, the connected viewpoints, and the visible
objects, but not which of them is the target. The walk is in the address of the page, so nothing is
stored.
"""

import math
import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reverie_eval.analysis import Episode, episode
from reverie_eval.arrays import FloatArray
from reverie_eval.errors import ActionError
from reverie_eval.metrics import ABSTAINED
from reverie_eval.scoring import PreparedSubmission
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.explore.episodes import Browsing, align_walks
from reverie_eval.server.scoring.boards import Board
from reverie_eval.simulator import Answer, Environment, Go, Observation, Stop

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
    instr_id: str
    steps: Sequence[int]
    """The viewpoints after the start, by their numbers in the scan."""
    visited: Sequence[str]
    """The viewpoints from the start on."""
    metres: float
    """The length of the walk so far."""
    seen: Observation
    """What the person sees from where they are."""
    _environment: Environment

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
        board = browsing.board
        if board.settings.track == "grounding":
            raise NotFoundError(f"{board.split} scores answers alone; there are no walks")
        drawn = sample(board, seed, number)
        if len(drawn) < number:
            raise NotFoundError(f"{board.split} has {len(drawn)} episodes")
        if len(steps) > MOST_STEPS:
            raise MalformedError(f"a walk has at most {MOST_STEPS} steps")
        environment = Environment(board.truth)
        seen = environment.reset(drawn[-1])
        visited, metres = [seen.viewpoint_id], 0.0
        scan = _viewpoints_of_scan(board, seen.viewpoint_id)
        for step in steps:
            if step >= len(scan):
                raise MalformedError("the walk has a step to a viewpoint that does not exist")
            distance = {each.viewpoint_id: each.distance for each in seen.neighbours}
            if scan[step] not in distance:
                raise MalformedError("the walk has a step to a viewpoint that is not connected")
            seen = environment.step(Go(scan[step]))
            visited.append(scan[step])
            metres += distance[scan[step]]
        return cls(board, drawn[-1], steps, visited, metres, seen, environment)

    @property
    def been(self) -> FloatArray:
        """Where the person has been, the start first: shape (n, 3), metres."""
        graph = self.board.truth.graph
        rows = [graph.index[viewpoint_id] for viewpoint_id in self.visited]
        return graph.viewpoint_position[rows]

    @property
    def ways(self) -> Sequence[Way]:
        """The viewpoints that the person can move to, by heading."""
        scan = _viewpoints_of_scan(self.board, self.seen.viewpoint_id)
        number = {viewpoint_id: index for index, viewpoint_id in enumerate(scan)}
        ways = [
            Way(
                number=number[each.viewpoint_id],
                heading=(self.seen.heading + each.relative_heading) % math.tau,
                elevation=self.seen.elevation + each.relative_elevation,
                metres=each.distance,
            )
            for each in self.seen.neighbours
        ]
        return sorted(ways, key=lambda way: way.heading)

    def end(self, object_id: int | None) -> tuple[Episode, Mapping[str, Any]]:
        """End the walk with an object, or none.

        Returns the episode, scored under the rules of the split, and its record in a submission.

        Raises
        ------
        MalformedError
            If no such object is visible.
        """
        try:
            self._environment.step(Stop() if object_id is None else Answer(object_id))
        except ActionError:
            message = f"object {object_id} is not visible from where the walk ends"
            raise MalformedError(message) from None
        (record,) = self._environment.submission()
        truth = self.board.truth
        viewpoints = [truth.graph.index[viewpoint_id] for viewpoint_id in self.visited]
        answer = ABSTAINED if object_id is None else object_id
        walks = align_walks(truth, {truth.row_of(self.instr_id): (viewpoints, answer)})
        scores = self.board.score(PreparedSubmission(walks, truth))
        return episode(scores, self.instr_id), record


@dataclass(frozen=True, slots=True)
class Rivals:
    """How methods did in an episode that a person has walked."""

    methods: int
    solved: int
    """How many of them solve it."""
    median: float | None
    """Metres that those walk, in the middle; None if there are none."""
    longer: int
    """How many of those walk farther than the person."""

    @classmethod
    def of(cls, browsing: Browsing, walked: Episode) -> "Rivals | None":
        """Compare a walk with those of methods that everyone may look at; None without any."""
        if browsing.methods is None:
            return None
        lengths = browsing.methods.lengths(browsing.row(walked.instr_id))
        own = walked.values["path_length"]
        return cls(
            methods=len(browsing.methods.methods),
            solved=len(lengths),
            median=float(np.median(lengths)) if lengths else None,
            longer=sum(each > own for each in lengths),
        )


def _viewpoints_of_scan(board: Board, viewpoint_id: str) -> Sequence[str]:
    """Return the viewpoints of a scan, in the order of their numbers."""
    graph = board.truth.graph
    scan = graph.viewpoint_scan[graph.index[viewpoint_id]]
    begin, end = np.searchsorted(graph.viewpoint_scan, [scan, scan + 1])
    return graph.viewpoint_ids[begin:end]


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
