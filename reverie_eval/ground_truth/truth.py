"""The ground truth as scoring reads it: a bundle's arrays with their meaning."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray, find_sorted, last_of
from reverie_eval.errors import GroundTruthError
from reverie_eval.ground_truth.boxes import CandidateBoxes
from reverie_eval.ground_truth.bundle import Bundle, BundleHeader, unpack
from reverie_eval.ground_truth.graph import NavigationGraph
from reverie_eval.protocol import SUCCESS_DISTANCE, Protocol
from reverie_eval.wording import counted

DEMO_DATASET = "demo"
"""Name of the synthetic dataset that ships with the package."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """What everybody may know of the episodes, one row each."""

    instr_ids: tuple[str, ...]
    task: IntArray
    """The task of each episode; episodes of one task share path and target."""
    start: IntArray
    """The viewpoint where each episode starts."""
    packed_instructions: Array | None = None

    @cached_property
    def instructions(self) -> tuple[str, ...]:
        """What the agent was told in each episode.

        Raises
        ------
        GroundTruthError
            If the bundle has none.
        """
        return _unpacked(self.packed_instructions, "instructions", len(self.instr_ids))

    @cached_property
    def index(self) -> Mapping[str, int]:
        """The row of each instr_id."""
        return {instr_id: row for row, instr_id in enumerate(self.instr_ids)}


@dataclass(frozen=True, eq=False)
class Answers:
    """What a public bundle leaves out."""

    target_object: IntArray
    """Shape (n_episodes,): object id within the episode's scan."""
    goal: IntArray
    """Shape (n_episodes,): last viewpoint of the annotated path."""
    candidate_viewpoint: IntArray
    """Shape (n_candidates,): every visible object at every viewpoint, by viewpoint and id."""
    candidate_object: IntArray
    """Shape (n_candidates,): object id within the viewpoint's scan."""
    candidate_distance: FloatArray | None
    """Shape (n_candidates,): metres from camera to object centre, inf where the centre is not
    known; None if the bundle was compiled without object positions."""
    boxes: CandidateBoxes
    """Where in which views the candidates are."""
    path: IntArray
    """Annotated paths of the tasks, end to end."""
    path_offsets: IntArray
    """Shape (n_tasks + 1,): where each task's path begins in ``path``."""
    packed_categories: Array | None = None

    @cached_property
    def target_categories(self) -> tuple[str, ...]:
        """What the annotators call each task's target, as they wrote it; empty where they do not.

        Raises
        ------
        GroundTruthError
            If the bundle has none.
        """
        return _unpacked(self.packed_categories, "categories", len(self.path_offsets) - 1)

    def is_visible(self, target_object: IntArray, viewpoint: IntArray) -> BoolArray:
        """Whether each object is visible from each viewpoint, a viewpoint of its own scan."""
        return self.find(target_object, viewpoint)[1]

    def is_visible_near(self, target_object: IntArray, viewpoint: IntArray) -> BoolArray:
        """Whether it is visible and its centre at most 3 m from the camera, in a straight line.

        Only for bundles with object positions.

        References
        ----------
        .. [1] ``r2r_src/eval.py`` lines 182-185 of YanyuanQiao/HOP-REVERIE-Challenge.
        """
        slot, found = self.find(target_object, viewpoint)
        distance = np.asarray(self.candidate_distance)
        return np.logical_and(found, distance[slot] <= SUCCESS_DISTANCE)

    def serves(self, protocol: Protocol) -> bool:
        """Whether everything that the protocol looks at is there."""
        is_measured = self.candidate_distance is not None
        return is_measured or protocol.goal != "visible and near the object"

    def find(self, target_object: IntArray, viewpoint: IntArray) -> tuple[IntArray, BoolArray]:
        """Return the row of each object at each viewpoint among the candidates, if it is one."""
        return find_sorted(self._candidates, _candidate_key(viewpoint, target_object))

    @cached_property
    def _candidates(self) -> IntArray:
        return _candidate_key(self.candidate_viewpoint, self.candidate_object)


def _unpacked(packed: Array | None, what: str, count: int) -> tuple[str, ...]:
    if packed is None:
        raise GroundTruthError(
            f"this ground truth was compiled without {what}; compile it again with this version"
        )
    return unpack(packed, count)


def _candidate_key(viewpoint: IntArray, object_id: IntArray) -> IntArray:
    """One number for a viewpoint and an object, in the order of candidates."""
    return (viewpoint.astype(np.int64) << 32) | object_id


@dataclass(frozen=True, eq=False, repr=False)
class GroundTruth:
    """One split's ground truth; read with :meth:`load`, made by ``reverie-eval compile``."""

    header: BundleHeader
    graph: NavigationGraph
    episodes: Episodes
    answers: Answers | None
    """None for a public bundle, which can check a submission but not score it."""
    other_splits: Mapping[str, Array]
    """The instr_ids of the dataset's other splits, to recognise a submission for one of them."""
    origin: str
    """Where this ground truth was read from, for the reader of a score table."""

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a bundle, check that it is whole, and freeze it.

        Raises
        ------
        GroundTruthError
            If the file is no bundle, is damaged, or is of another format version.
        FileNotFoundError
            If there is no such file.
        """
        return cls.from_bundle(Bundle.load(Path(path)), origin=str(path))

    @classmethod
    def from_bundle(cls, bundle: Bundle, origin: str = "memory") -> Self:
        """Give a bundle's arrays their meaning."""
        arrays = bundle.arrays
        task = arrays["episode_task"]
        return cls(
            header=bundle.header,
            graph=NavigationGraph.from_arrays(arrays),
            episodes=Episodes(
                instr_ids=tuple(arrays["instr_id"].tolist()),
                task=task,
                start=arrays["task_start"][task],
                packed_instructions=bundle.texts.get("instruction"),
            ),
            answers=None if bundle.is_public else _answers(bundle),
            other_splits=bundle.other_splits,
            origin=origin,
        )

    def __repr__(self) -> str:
        kind = "public, " if self.answers is None else ""
        count = counted(len(self.episodes.instr_ids), "episode")
        return f"<GroundTruth of {self.split}, {kind}{count}, from {self.origin}>"

    @property
    def split(self) -> str:
        """The split that this is the ground truth of."""
        return self.header.split

    @property
    def fingerprint(self) -> str:
        """SHA-256 of everything that scores depend on."""
        return self.header.fingerprint

    @property
    def is_demo(self) -> bool:
        """Whether this is the synthetic world that ships with the package."""
        return self.header.dataset == DEMO_DATASET

    @property
    def provenance(self) -> str:
        """Which ground truth this is, in a few words for the reader of a number."""
        if self.is_demo:
            return "the synthetic demo world that ships with reverie-eval, not REVERIE"
        return f"{self.origin} ({self.header.dataset})"

    @property
    def secret(self) -> Answers:
        """The answers, which must be there.

        Raises
        ------
        GroundTruthError
            If this is a public bundle.
        """
        if self.answers is None:
            raise GroundTruthError(
                f"{self.origin} is a public bundle: it checks a {self.split} submission "
                "(`reverie-eval validate`) but holds no answers, which this needs"
            )
        return self.answers


def _answers(bundle: Bundle) -> Answers:
    arrays = bundle.arrays
    task = arrays["episode_task"]
    boxes = CandidateBoxes(
        candidate=arrays["box_candidate"],
        candidate_viewpoint=arrays["candidate_viewpoint"],
        view=arrays["box_view"],
        xywh=arrays["box_xywh"],
    )
    task_goal = arrays["path"][last_of(arrays["path_offsets"])]
    return Answers(
        target_object=arrays["task_target"][task],
        goal=task_goal[task],
        candidate_viewpoint=arrays["candidate_viewpoint"],
        candidate_object=arrays["candidate_object"],
        candidate_distance=arrays.get("candidate_distance"),
        boxes=boxes,
        path=arrays["path"],
        path_offsets=arrays["path_offsets"],
        packed_categories=bundle.texts.get("target_category"),
    )
