"""The episodes of a split as training walks them: observations, routes, and who is held back."""

import hashlib
from collections.abc import Collection, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from reverie_eval.agents.trained._coding import Coder, Vocabulary
from reverie_eval.agents.trained.navigators import Decision
from reverie_eval.agents.trained.pointers import Pointer, Question, best_names, point
from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import SUCCESS_DISTANCE
from reverie_eval.simulator import Environment

# One of so many scans is held back.
_SHARE_OF_SCANS = 8
# One of so many pairs of start and goal of the other scans is held back.
_SHARE_OF_ROUTES = 20


class Parts(NamedTuple):
    """The episodes of a split for training, int (n,) each."""

    trained: IntArray
    """Episodes that models are trained on."""
    seen: IntArray
    """Held back, in buildings that models are trained on, between a start and a goal that they are
    not."""
    unseen: IntArray
    """Held back with their buildings."""


def hold_back(truth: GroundTruth, elsewhere: Collection[str]) -> Parts:
    """Choose the episodes by which training is stopped.

    Whole buildings are held back, and of the others pairs of a start and a goal: to hold back
    single items or paths leaks, because other items have the same route. The choice depends on
    names alone, so it is the same for all seeds and models.

    Parameters
    ----------
    truth : GroundTruth
        With the solution.
    elsewhere : collection of str
        Scans in which models are evaluated later, val_seen's, and so should be trained; they are
        held back only if there are not enough others.
    """
    solution = truth.require_solution()
    scans, goals = truth.scans, solution.goal.tolist()
    by_digest = sorted({*scans}, key=lambda scan: (scan in {*elsewhere}, _digest(scan)))
    unseen = {*by_digest[: max(1, len(by_digest) // _SHARE_OF_SCANS)]}
    names = truth.graph.viewpoint_ids
    part = np.array(
        [
            "unseen"
            if scan in unseen
            else "seen"
            if int(_digest(f"{names[start]} {names[goal]}"), 16) % _SHARE_OF_ROUTES == 0
            else "trained"
            for scan, start, goal in zip(scans, truth.episodes.start, goals, strict=True)
        ]
    )
    return Parts(*(np.flatnonzero(part == name) for name in Parts._fields))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


class World:
    """The episodes of a split, with what is observed at each viewpoint and where to go from it.

    Parameters
    ----------
    truth : GroundTruth
        With the solution.
    coder : Coder
    """

    def __init__(self, truth: GroundTruth, coder: Coder) -> None:
        self.solution = truth.require_solution()
        self._has_targets = truth.task.has_targets
        self.graph, self.coder = truth.graph, coder
        self.start, self.heading = truth.episodes.start.tolist(), truth.episodes.heading.tolist()
        self.item = truth.episodes.item
        self.goal = self.solution.goal.tolist()
        environment = Environment(truth)
        self.words = list(map(coder.vocabulary.encode, environment.surroundings.instructions))
        scans = {truth.graph.viewpoint_scan[start] for start in self.start}
        # All at once, so that every name is known before the first match is looked up.
        self.panoramas = {
            viewpoint: coder.panorama(environment.observe(environment.episodes[0], name))
            for viewpoint, (name, scan) in enumerate(
                zip(self.graph.viewpoint_ids, self.graph.viewpoint_scan, strict=True)
            )
            if scan in scans
        }
        self.neighbours = {
            viewpoint: [truth.graph.index[each] for each in panorama.viewpoint_ids]
            for viewpoint, panorama in self.panoramas.items()
        }
        self.matches = cache(lambda row: coder.matches(self.words[row]))
        self.slot_towards = cache(self._slot_towards)

    def decisions(
        self, rows: IntArray, viewpoints: IntArray, headings: FloatArray
    ) -> Sequence[Decision]:
        """Return what agents in some episodes decide about, who are at these viewpoints."""
        where = zip(rows.tolist(), viewpoints.tolist(), headings.tolist(), strict=True)
        return [
            Decision(self.panoramas[at], heading, self.matches(row), top)
            for (row, at, heading), top in zip(where, self.tops(rows, viewpoints), strict=True)
        ]

    def tops(self, rows: IntArray, viewpoints: IntArray) -> Sequence[IntArray | None]:  # noqa: ARG002
        """Return the names that a pointer chooses in each slot; None, because there is none."""
        return [None] * len(rows)

    def path(self, row: int) -> Sequence[int]:
        """Return the annotated path of an episode."""
        begin, end = self.solution.path_offsets[self.item[row] :][:2]
        path: list[int] = self.solution.path[begin:end].tolist()
        return path

    def distance(self, rows: IntArray, viewpoints: IntArray) -> FloatArray:
        """Metres from viewpoints to the goals of episodes."""
        return self.graph.distance_between(viewpoints, self.solution.goal[rows])

    def _slot_towards(self, viewpoint: int, goal: int) -> int:
        """Return the slot of the next viewpoint on the shortest route; 0 at the goal."""
        if viewpoint == goal:
            return 0
        near = np.array(self.neighbours[viewpoint][1:])
        metres = self.panoramas[viewpoint].ways[:, 2]
        rest = self.graph.distance_between(near, np.full(len(near), goal))
        return 1 + int(np.argmin(metres + rest))

    def is_success(self, rows: IntArray, viewpoints: IntArray) -> BoolArray:
        """Whether stops count: the target is visible, or a goal is nearer than 3 m."""
        if self._has_targets:
            return self.solution.is_visible(self.solution.target_object[rows], viewpoints)
        return self.distance(rows, viewpoints) < SUCCESS_DISTANCE


class AdvisedWorld(World):
    """A world in which a pointer, which is not trained any more, looks at every viewpoint first.

    The interaction of navigator and pointer of Qi et al., "REVERIE", CVPR 2020, section 4: the
    labels of the three objects that the pointer scores best in each view that the agent can go to
    are a part of what the navigator sees.
    """

    def __init__(self, truth: GroundTruth, coder: Coder, pointer: Pointer, its: Coder) -> None:
        super().__init__(truth, coder)
        self._pointer, self._its = pointer, World(truth, its)
        self._tops: dict[tuple[int, int], IntArray] = {}

    def tops(self, rows: IntArray, viewpoints: IntArray) -> Sequence[IntArray | None]:
        """Return the names that the pointer chooses in each slot, (n_slots, N_TOP)."""
        asked = list(zip(rows.tolist(), viewpoints.tolist(), strict=True))
        new = [each for each in asked if each not in self._tops]
        if new:
            questions = [
                Question(self._its.panoramas[at], self._its.matches(row)) for row, at in new
            ]
            words = np.stack([self._its.words[row] for row, _ in new])
            scores = point(self._pointer, self._its.coder, words, questions)
            for (row, at), its in zip(new, scores, strict=True):
                panorama = self.panoramas[at]
                top = best_names(its[: len(panorama.name)], panorama.name, panorama.in_slot)
                self._tops[row, at] = top
        return [self._tops[each] for each in asked]


def make_coder(truth: GroundTruth, rows: IntArray, *, reads_objects: bool = True) -> Coder:
    """Return a coder that knows some episodes: their words, and the viewpoints around them."""
    environment, episodes = Environment(truth), truth.episodes
    scans = {*truth.graph.viewpoint_scan[episodes.start[rows]].tolist()}
    remembered = [
        name
        for name, scan in zip(truth.graph.viewpoint_ids, truth.graph.viewpoint_scan, strict=True)
        if scan in scans
    ]
    seen = (environment.observe(episodes.instr_ids[0], each) for each in remembered)
    names = {candidate.name for each in seen for candidate in each.candidates}
    instructions = [environment.surroundings.instructions[row] for row in rows]
    vocabulary = Vocabulary.build(instructions, names)
    return Coder(vocabulary, remembered, reads_objects=reads_objects)
