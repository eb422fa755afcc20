"""One digest over all values of the reference files: ``python -m tests.support.digest``.

It needs nothing but the package, so that any environment can be asked for it, and all must give the
same. The files are the reference submissions to REVERIE's splits, by every protocol, and the sample
with boxes.
"""

import hashlib
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fixtures.published import published_folder, unpack_dataset
from reverie_eval import GroundTruth, Scores, evaluate, evaluate_protocols
from reverie_eval.dataset import DatasetFiles, compile_split

WITH_BOXES = Path(__file__).parents[2] / "fixtures" / "submissions" / "drawn.json"
TRANSCENDENTAL = {"ndtw", "sdtw", "cls", "iou"}
"""Metrics that go through an exponential, or the sine of a camera's heading, which differ in the
last bit between versions of numpy, and between processors with the same version."""
DECIMALS = 9
"""How many decimals of these metrics are compared; of all other values, every bit is."""


def scores_of(published: Path, unpacked: Path) -> Iterator[Scores]:
    """Compile the ground truth from the published files, and score every reference file with it."""
    files = unpack_dataset(published, unpacked)
    for split in ("val_seen", "val_unseen"):
        truth = GroundTruth.from_bundle(compile_split(DatasetFiles.find(files, split=split), split))
        for submission in sorted((published / "reference" / "submissions").glob(f"{split}.*")):
            yield from evaluate_protocols(submission, split=split, ground_truth=truth).values()
    yield evaluate(WITH_BOXES, split="val_unseen")


def digest_of(every: Iterator[Scores]) -> str:
    """Return a digest over the fingerprints of ground truths and the values of every episode."""
    digest = hashlib.sha256()
    for scores in every:
        digest.update(scores.signature.encode())
        for key, values in scores.episodes.items():
            counted = values.round(DECIMALS) if key in TRANSCENDENTAL else values
            digest.update(key.encode() + np.ascontiguousarray(counted).tobytes())
    return digest.hexdigest()


if __name__ == "__main__":
    folder = published_folder()
    if folder is None:
        sys.exit("the published REVERIE files are not here (REVERIE_DATA names their folder)")
    with tempfile.TemporaryDirectory() as temporary:
        sys.stdout.write(f"{digest_of(scores_of(folder, Path(temporary)))}\n")
