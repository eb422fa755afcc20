"""The same digits as the published evaluators print, on all reference submissions.

`official` is the dataset's own script; the values per episode are what it and the navigation
errors of its successors give. See the README next to the files.
"""

import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from reverie_eval import Scores, evaluate

pytestmark = pytest.mark.dataset

REFERENCE_SUBMISSIONS = [
    "val_seen.shortest",
    "val_seen.walk",
    "val_seen.mixed1",
    "val_seen.mixed2",
    "val_unseen.shortest",
    "val_unseen.walk",
    "val_unseen.mixed1",
    "val_unseen.mixed2",
]
PUBLISHED_EPISODE_KEYS = {
    "path_length": "length",
    "shortest_length": "shortest",
    "success": "success",
    "oracle_success": "oracle_success",
    "rgs": "rgs",
    "spl": "spl",
    "rgspl": "rgspl",
    "steps": "steps",
    "navigation_error": "nav_error",
    "oracle_error": "oracle_error",
}
PUBLISHED_SCORE_KEYS = {
    "path_length": "length",
    "success": "success_rate",
    "oracle_success": "oracle success_rate",
    "spl": "spl",
    "rgs": "rgs",
    "rgspl": "rgspl",
}


@dataclass(frozen=True)
class Reference:
    """A reference submission: what we score for it, and where its expected values begin."""

    scores: Scores
    expected: Path
    """Path of the expected files without their suffixes."""


@pytest.fixture(scope="module", params=REFERENCE_SUBMISSIONS)
def reference(
    request: pytest.FixtureRequest, published: Path, published_bundles: Path
) -> Reference:
    """Score a reference submission."""
    name, folder = request.param, published / "reference"
    split, _, _ = name.partition(".")
    submission = folder / "submissions" / f"{name}.json.gz"
    scores = evaluate(submission, split=split, ground_truth=published_bundles)
    return Reference(scores, folder / "expected" / name)


def test_every_episode_has_the_published_digits(reference: Reference) -> None:
    published = json.loads(gzip.decompress(_with(reference, ".episodes.json.gz").read_bytes()))
    expected = {
        instr_id: {ours: values[theirs] for ours, theirs in PUBLISHED_EPISODE_KEYS.items()}
        for instr_id, values in published.items()
    }
    assert _episodes(reference.scores) == expected


def test_scores_are_the_official_ones(reference: Reference) -> None:
    published = json.loads(_with(reference, ".json").read_bytes())["official"]
    expected = {ours: published[theirs] for ours, theirs in PUBLISHED_SCORE_KEYS.items()}
    scores = {key: reference.scores[key] for key in PUBLISHED_SCORE_KEYS}
    assert scores == pytest.approx(expected, abs=1e-12, rel=0)


def _with(reference: Reference, suffix: str) -> Path:
    return reference.expected.with_name(reference.expected.name + suffix)


def _episodes(scores: Scores) -> Mapping[str, Mapping[str, float]]:
    columns = {key: scores.episodes[key].tolist() for key in PUBLISHED_EPISODE_KEYS}
    return {
        instr_id: {key: column[row] for key, column in columns.items()}
        for row, instr_id in enumerate(scores.instr_ids)
    }
