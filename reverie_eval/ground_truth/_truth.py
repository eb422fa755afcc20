"""The ground truth of a split as scoring uses it, and where it is found."""

import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Self

from reverie_eval.arrays import Array, IntArray
from reverie_eval.errors import GroundTruthError
from reverie_eval.ground_truth._answers import Answers
from reverie_eval.ground_truth._bundle import Bundle, BundleHeader, bundle_name, unpack_texts
from reverie_eval.ground_truth._graph import NavigationGraph
from reverie_eval.text import count_text, did_you_mean

GROUND_TRUTH_VARIABLE = "REVERIE_EVAL_GROUND_TRUTH"
"""The environment variable that names a bundle, or a folder of bundles."""

DEMO_DATASET = "demo"
"""Name of the synthetic dataset that ships with the package."""
DEMO_BUNDLES = Path(__file__).with_name("demo")
"""The bundles of that dataset."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """What is public about the episodes, one row each."""

    instr_ids: tuple[str, ...]
    task: IntArray
    """The task of each episode; episodes of one task share path and target."""
    start: IntArray
    """The viewpoint where each episode starts."""
    packed_instructions: Array | None = None

    @cached_property
    def instructions(self) -> tuple[str, ...]:
        """The instruction of each episode.

        Raises
        ------
        GroundTruthError
            If the bundle has none.
        """
        return unpack_texts(self.packed_instructions, "instructions", len(self.instr_ids))

    @cached_property
    def index(self) -> Mapping[str, int]:
        """The row of each instr_id."""
        return {instr_id: row for row, instr_id in enumerate(self.instr_ids)}


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
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a bundle, check that it is complete, and freeze it.

        Raises
        ------
        GroundTruthError
            If the file is not a bundle, is damaged, or has another format version.
        FileNotFoundError
            If there is no such file.
        """
        return cls.from_bundle(Bundle.load(Path(path)), origin=str(path))

    @classmethod
    def from_bundle(cls, bundle: Bundle, origin: str = "memory") -> Self:
        """Interpret a bundle's arrays."""
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
            answers=Answers.from_bundle(bundle),
            other_splits=bundle.other_splits,
            origin=origin,
        )

    def __repr__(self) -> str:
        kind = "public, " if self.answers is None else ""
        count = count_text(len(self.episodes.instr_ids), "episode")
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
        """Which ground truth this is, for the reader of a number."""
        if self.is_demo:
            return "the synthetic demo world that ships with reverie-eval, not REVERIE"
        return f"{self.origin} ({self.header.dataset})"

    def require_answers(self) -> Answers:
        """Return the answers.

        Raises
        ------
        GroundTruthError
            If this is a public bundle.
        """
        if self.answers is None:
            raise GroundTruthError(
                f"{self.origin} is a public bundle: it can check a {self.split} submission "
                "(`reverie-eval validate`), but has no answers, which scores and agents need"
            )
        return self.answers


def find_ground_truth(given: str | PathLike[str] | GroundTruth | None, split: str) -> GroundTruth:
    """Return the ground truth of a split.

    It is, in this order: what is given; what the environment variable
    ``REVERIE_EVAL_GROUND_TRUTH`` names; the demo world. A folder holds ``{split}.npz`` or
    ``{split}.public.npz``.

    Raises
    ------
    GroundTruthError
        If there is none for this split, or the file is not a valid bundle.
    """
    if isinstance(given, GroundTruth):
        truth = given
    else:
        named = os.environ.get(GROUND_TRUTH_VARIABLE) if given is None else given
        truth = _load(DEMO_BUNDLES if named is None else Path(named), split)
    if truth.split != split:
        raise GroundTruthError(
            f"{truth.origin} is the ground truth of {truth.split}, not of {split}"
        )
    return truth


def bundled_splits(place: Path | None = None) -> Sequence[str]:
    """Return the splits whose bundles are in a folder, or in the demo world."""
    return sorted({path.name.split(".")[0] for path in (place or DEMO_BUNDLES).glob("*.npz")})


def _load(place: Path, split: str) -> GroundTruth:
    if not place.exists():
        raise GroundTruthError(
            f"there is no ground truth at {place}; `reverie-eval compile` makes it"
        )
    if place.is_file():
        return GroundTruth.load(place)
    for public in (False, True):
        bundle = place / bundle_name(split, public=public)
        if bundle.is_file():
            return GroundTruth.load(bundle)
    raise GroundTruthError(_missing_bundle(place, split))


def _missing_bundle(place: Path, split: str) -> str:
    splits = bundled_splits(place)
    if not splits:
        name, dataset = bundle_name(split, public=False), shlex.quote(str(place))
        return (
            f"there are no bundles in {place}; if it is the dataset itself, run `reverie-eval "
            f"compile {dataset} --split {split} -o {name}` first"
        )
    where = "the demo world" if place == DEMO_BUNDLES else place
    return f"{where} has no split {split!r}{did_you_mean(split, splits)}"
