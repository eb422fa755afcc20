"""REVERIE's sister tasks: their published files, what was recorded of them, and random worlds."""

import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.published import family_folder, unpack_task
from reverie_eval import GroundTruth, Scores, evaluate
from reverie_eval.dataset import DatasetFiles, compile_split
from reverie_eval.ground_truth import Bundle
from tests.conftest import unavailable
from tests.support.oracle import Predictions, World
from tests.support.sharing import shared_folder
from tests.support.worlds import SPLIT, ground_truth_arrays, instructions_of

LENGTHS_WITHIN = 1e-9
"""Metres, and fractions of lengths: the published evaluators add up in another order."""
HAMT = {
    "navigation_error": "nav_error",
    "oracle_error": "oracle_error",
    "path_length": "trajectory_lengths",
    "success": "success",
    "oracle_success": "oracle_success",
    "spl": "spl",
    "steps": "trajectory_steps",
    "dtw": "DTW",
    "ndtw": "nDTW",
    "sdtw": "SDTW",
    "cls": "CLS",
}
"""What HAMT's evaluator of R2R and R4R calls our metrics."""

AUTHORS = {"dtw": "dtw", "ndtw": "ndtw", "sdtw": "sdtw"}
"""What the classes of R4R's and RxR's authors call our metrics."""

less_than_3_m = pytest.mark.parametrize(
    ("metres", "success"),
    [
        pytest.param(float(np.nextafter(3.0, 0.0)), 1.0, id="just below 3 m"),
        pytest.param(3.0, 0.0, id="exactly 3 m"),
        pytest.param(float(np.nextafter(3.0, 4.0)), 0.0, id="just above 3 m"),
    ],
)
"""Stops on either side of the distance, where it is itself no success."""


@dataclass(frozen=True)
class Published:
    """A task's published files, with its bundles."""

    task: str
    folder: Path
    """With what was recorded."""
    bundles: Path
    annotations: Path

    def truth(self, split: str) -> GroundTruth:
        """Return the ground truth of a split."""
        return GroundTruth.load(self.bundles / f"{split}.npz")

    def submission(self, name: str) -> Path:
        """Return a reference submission."""
        return self.folder / "reference" / "submissions" / f"{name}.json.gz"

    def scores(self, name: str, protocol: str) -> Scores:
        """Score a reference submission, whose name begins with its split."""
        truth = self.truth(name.partition(".")[0])
        return evaluate(
            self.submission(name), split=truth.split, ground_truth=truth, protocol=protocol
        )

    def recorded(self, name: str, evaluator: str) -> Any:
        """Return what a published evaluator gave a submission: aggregates and episodes."""
        path = self.folder / "reference" / "expected" / evaluator / f"{name}.json.gz"
        return json.loads(gzip.decompress(path.read_bytes()))


def published_task(
    task: str,
    files: Mapping[str, str],
    published: Path,
    factory: pytest.TempPathFactory,
) -> Published:
    """Unpack a task and compile its splits, given with the names of their files."""
    family = family_folder()
    if family is None:
        unavailable("the files of the sister tasks are not here (beside the published REVERIE)")

    def make(folder: Path) -> None:
        unpack_task(family / task, folder / "annotations")
        for split, name in files.items():
            found = DatasetFiles.find(
                annotations=folder / "annotations" / name,
                connectivity=published / "reverie-v1" / "connectivity",
                split=split,
                task=task,
            )
            compile_split(found, split).save(folder / f"{split}.npz")

    folder = shared_folder(factory, f"published_{task}", make)
    return Published(task, family / task, folder, folder / "annotations")


def differences(
    scores: Scores, recorded: Mapping[str, Mapping[str, float]], names: Mapping[str, str]
) -> Mapping[str, float]:
    """Return the largest difference from the recorded values of any episode, by metric."""
    assert set(scores.instr_ids) == recorded.keys()
    return {
        ours: float(
            np.abs(
                scores.episodes[ours]
                - np.array([recorded[instr_id][theirs] for instr_id in scores.instr_ids])
            ).max()
        )
        for ours, theirs in names.items()
    }


def world_of_task(world: World, task: str) -> GroundTruth:
    """Return a world's ground truth as another task's, without its objects."""
    arrays = {
        name: array
        for name, array in ground_truth_arrays(world).items()
        if not name.startswith(("task_target", "candidate", "box"))
    }
    texts = instructions_of(world)
    return GroundTruth.from_bundle(
        Bundle.build(SPLIT, "custom", {}, arrays, {}, texts=texts, task=task)
    )


def walks_of(predictions: Predictions) -> list[dict[str, Any]]:
    """Return a submission without answers."""
    return [
        {"instr_id": instr_id, "trajectory": [[it, 0.0, 0.0] for it in prediction.trajectory]}
        for instr_id, prediction in predictions.items()
    ]
