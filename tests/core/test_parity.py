"""On all reference submissions, the digits are those that the published evaluators print.

`official` is the dataset's own script, `duet` and `hamt` are those codebases' functions, `r2r` is
Room-to-Room's rule, and `fidelity` what DUET's utilities compute with `r2r`'s success. See the
README next to the files.
"""

import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest

from reverie_eval import GroundTruth, Scores, evaluate

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

EXACT: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "official-v1": {
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
        },
        "r2r-style": {
            "success": "r2r_success",
            "oracle_success": "r2r_oracle_success",
            "spl": "r2r_spl",
            "dtw": "dtw",
        },
    }
)
"""Published values per episode, by protocol and metric, that we have bit for bit."""

ROUNDED: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "duet": {"spl": "duet_spl", "rgspl": "duet_rgspl"},
        "r2r-style": {"ndtw": "ndtw", "sdtw": "sdtw", "cls": "cls"},
    }
)
"""Metrics that may differ in the last digit: DUET adds up the legs of a route in another order,
and fidelity goes through an exponential."""

DUET_KEYS = {
    "path_length": "lengths",
    "success": "sr",
    "oracle_success": "oracle_sr",
    "spl": "spl",
    "rgs": "rgs",
    "rgspl": "rgspl",
    "steps": "steps",
}
AGGREGATES = [
    pytest.param(
        "official-v1",
        "official",
        {
            "path_length": "length",
            "success": "success_rate",
            "oracle_success": "oracle success_rate",
            "spl": "spl",
            "rgs": "rgs",
            "rgspl": "rgspl",
        },
        id="official-v1",
    ),
    pytest.param("duet", "duet", DUET_KEYS, id="duet"),
    pytest.param("hamt", "hamt", DUET_KEYS, id="hamt"),
    pytest.param(
        "r2r-style",
        "r2r",
        {
            "path_length": "length",
            "success": "success_rate",
            "oracle_success": "oracle success_rate",
            "spl": "spl",
            "navigation_error": "nav_error",
            "oracle_error": "oracle_error",
        },
        id="r2r-style",
    ),
    pytest.param(
        "r2r-style",
        "fidelity",
        {key: key for key in ("dtw", "ndtw", "sdtw", "cls")},
        id="fidelity",
    ),
]
IN_PERCENT = {"sr", "oracle_sr", "spl", "rgs", "rgspl"}
"""The keys that DUET and HAMT give in percent."""

ROUNDING = 1e-12


@dataclass(frozen=True)
class Reference:
    """A reference submission: its file, its ground truth, and where its expected values begin."""

    submission: Path
    ground_truth: GroundTruth
    expected: Path
    """Path of the expected files without their suffixes."""

    def scores(self, protocol: str) -> Scores:
        """Score the submission."""
        truth = self.ground_truth
        return evaluate(self.submission, split=truth.split, ground_truth=truth, protocol=protocol)

    def aggregates(self) -> Any:
        """Read what the published evaluators print."""
        return json.loads(self._with(".json").read_bytes())

    def episodes(self) -> Any:
        """Read what they compute per episode."""
        return json.loads(gzip.decompress(self._with(".episodes.json.gz").read_bytes()))

    def _with(self, suffix: str) -> Path:
        return self.expected.with_name(self.expected.name + suffix)


def _reference(name: str, published: Path, bundles: Path) -> Reference:
    split, _, _ = name.partition(".")
    folder = published / "reference"
    return Reference(
        submission=folder / "submissions" / f"{name}.json.gz",
        ground_truth=GroundTruth.load(bundles / f"{split}.npz"),
        expected=folder / "expected" / name,
    )


@pytest.fixture(scope="module", params=REFERENCE_SUBMISSIONS)
def reference(
    request: pytest.FixtureRequest, published: Path, published_bundles: Path
) -> Reference:
    """Find a reference submission."""
    return _reference(request.param, published, published_bundles)


@pytest.mark.parametrize("protocol", EXACT)
def test_every_episode_has_exactly_the_published_value(protocol: str, reference: Reference) -> None:
    names = EXACT[protocol]
    assert _found(reference, protocol, names) == _published(reference, names)


@pytest.mark.parametrize("protocol", ROUNDED)
def test_every_episode_has_the_published_value_up_to_the_last_digit(
    protocol: str, reference: Reference
) -> None:
    found = _found(reference, protocol, ROUNDED[protocol])
    expected = _published(reference, ROUNDED[protocol])
    assert found.keys() == expected.keys()
    assert [
        instr_id
        for instr_id, values in expected.items()
        if found[instr_id] != pytest.approx(values, abs=ROUNDING, rel=0)
    ] == []


@pytest.mark.parametrize(("protocol", "evaluator", "names"), AGGREGATES)
def test_scores_equal_those_of_the_published_evaluator(
    protocol: str, evaluator: str, names: Mapping[str, str], reference: Reference
) -> None:
    published = reference.aggregates()[evaluator]
    percent = IN_PERCENT if evaluator in ("duet", "hamt") else set()
    expected = {
        ours: published[theirs] / 100 if theirs in percent else published[theirs]
        for ours, theirs in names.items()
    }
    scores = reference.scores(protocol)
    assert {key: scores[key] for key in names} == pytest.approx(expected, abs=ROUNDING, rel=0)


def test_official_fidelity_differs_only_in_success(reference: Reference) -> None:
    official, r2r = reference.scores("official-v1"), reference.scores("r2r-style")
    for key in ("dtw", "ndtw", "cls"):
        assert official.episodes[key].tolist() == r2r.episodes[key].tolist()
    expected = official.episodes["ndtw"] * official.episodes["success"]
    assert official.episodes["sdtw"].tolist() == expected.tolist()


@pytest.mark.parametrize(
    ("protocol", "shown"),
    [
        pytest.param("official-v1", "54.53", id="the target is visible"),
        pytest.param("r2r-style", "62.54", id="the path's end is near"),
    ],
)
def test_the_same_file_has_two_success_rates(
    protocol: str, shown: str, published: Path, published_bundles: Path
) -> None:
    mixed = _reference("val_seen.mixed1", published, published_bundles)
    assert f"{100 * mixed.scores(protocol)['success']:.2f}" == shown


def _found(
    reference: Reference, protocol: str, names: Mapping[str, str]
) -> Mapping[str, Mapping[str, float]]:
    scores = reference.scores(protocol)
    columns = {key: scores.episodes[key].tolist() for key in names}
    return {
        instr_id: {key: column[row] for key, column in columns.items()}
        for row, instr_id in enumerate(scores.instr_ids)
    }


def _published(reference: Reference, names: Mapping[str, str]) -> Mapping[str, Mapping[str, float]]:
    return {
        instr_id: {ours: values[theirs] for ours, theirs in names.items()}
        for instr_id, values in reference.episodes().items()
    }
