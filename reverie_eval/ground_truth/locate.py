"""Find the ground truth that a split is to be scored by."""

import os
import shlex
from os import PathLike
from pathlib import Path

from reverie_eval import variables
from reverie_eval.errors import GroundTruthError
from reverie_eval.ground_truth.truth import GroundTruth

DEMO_BUNDLES = Path(__file__).with_name("demo")
"""The bundles of the synthetic world that ships with the package."""


def find_ground_truth(given: str | PathLike[str] | GroundTruth | None, split: str) -> GroundTruth:
    """Return the ground truth of a split.

    Looked for in this order: what is given; what the environment variable
    ``REVERIE_EVAL_GROUND_TRUTH`` names; the embedded demo world. A folder holds
    ``{split}.npz`` or ``{split}.public.npz``.

    Raises
    ------
    GroundTruthError
        If there is none for this split, or the file is no sound bundle.
    """
    if isinstance(given, GroundTruth):
        return _of_split(given, split)
    named = os.environ.get(variables.GROUND_TRUTH) if given is None else given
    place = DEMO_BUNDLES if named is None else named
    return _of_split(_load(Path(place), split), split)


def bundle_name(split: str, *, public: bool) -> str:
    """Return the name of a split's bundle in a folder of bundles."""
    return f"{split}.public.npz" if public else f"{split}.npz"


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
    raise GroundTruthError(_no_bundle(place, split))


def _no_bundle(place: Path, split: str) -> str:
    there = sorted({path.name.split(".")[0] for path in place.glob("*.npz")})
    if not there:
        name, dataset = bundle_name(split, public=False), shlex.quote(str(place))
        return (
            f"there are no bundles in {place}; if it is the dataset itself, run `reverie-eval "
            f"compile {dataset} --split {split} -o {name}` first"
        )
    where = "the demo world" if place == DEMO_BUNDLES else place
    return f"{where} has no split {split!r}; it has {', '.join(there)}"


def _of_split(ground_truth: GroundTruth, split: str) -> GroundTruth:
    if ground_truth.split != split:
        raise GroundTruthError(
            f"{ground_truth.origin} is the ground truth of {ground_truth.split}, not of {split}"
        )
    return ground_truth
