"""R4R: the same digits as its authors' metrics and HAMT's evaluator."""

import math
import operator
from collections.abc import Mapping
from pathlib import Path
from random import Random

import numpy as np
import pytest

from reverie_eval import SubmissionError, evaluate
from tests.conftest import REPOSITORY
from tests.support.amounts import amount, is_evidence, tell
from tests.support.family import (
    AUTHORS,
    HAMT,
    LENGTHS_WITHIN,
    Published,
    differences,
    published_task,
    walks_of,
    world_of_task,
)
from tests.support.oracle import Episode, Item, Scan, Viewpoint, World, measure, weighted
from tests.support.worlds import SPLIT, random_case

SAMPLE = REPOSITORY / "fixtures" / "submissions" / "r4r.json"
SPLITS = ["val_seen", *(["val_unseen"] if is_evidence() else [])]
"""The 45,234 episodes of val_unseen take a minute."""


@pytest.fixture(scope="module")
def r4r(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Published:
    """Compile R4R as it is built from R2R."""
    files = {split: f"R4R_{split}.json" for split in SPLITS}
    return published_task("r4r", files, published, tmp_path_factory)


@pytest.mark.dataset
@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize(
    ("protocol", "evaluator", "names"),
    [
        pytest.param("official-v1", "google_r4r", AUTHORS, id="authors"),
        pytest.param("hamt", "hamt", HAMT, id="hamt"),
    ],
)
def test_every_episode_has_the_recorded_value(
    protocol: str, evaluator: str, names: Mapping[str, str], split: str, r4r: Published
) -> None:
    name = f"{split}.mixed1"
    recorded = r4r.recorded(name, evaluator)["episodes"]
    scores = r4r.scores(name, protocol)
    found = differences(scores, recorded, names)
    assert not found.get("success")
    assert not found.get("oracle_success")
    assert max(found.values()) < LENGTHS_WITHIN
    # The authors' class fails for a viewpoint that is repeated in place, and for a jump.
    theirs = [recorded[id_].get("cls", recorded[id_].get("CLS")) for id_ in scores.instr_ids]
    expected = np.array([math.nan if value is None else value for value in theirs])
    assert np.nanmax(np.abs(scores.episodes["cls"] - expected)) < LENGTHS_WITHIN


@pytest.mark.parametrize(
    ("protocol", "metres", "success"),
    [
        pytest.param("official-v1", 3.0, 1.0, id="the authors: exactly 3 m"),
        pytest.param("official-v1", float(np.nextafter(3.0, 4.0)), 0.0, id="the authors: above"),
        pytest.param("hamt", float(np.nextafter(3.0, 0.0)), 1.0, id="HAMT: just below 3 m"),
        pytest.param("hamt", 3.0, 0.0, id="HAMT: exactly 3 m"),
    ],
)
@pytest.mark.parametrize("task", ["r4r", "rxr"])
def test_whether_exactly_3_m_is_a_success(
    task: str, protocol: str, metres: float, success: float
) -> None:
    viewpoints = {
        "goal": Viewpoint((0.0, 0.0, 0.0)),
        "stop": Viewpoint((metres, 0.0, 0.0)),
        "start": Viewpoint((10.0, 0.0, 0.0)),
    }
    scan = Scan(viewpoints, frozenset({("goal", "stop"), ("stop", "start")}))
    world = World({"house": scan}, [Item("1", "house", ["start", "stop", "goal"], 0)])
    records = [{"instr_id": "1_0", "trajectory": [["start", 0, 0], ["stop", 0, 0]]}]
    truth = world_of_task(world, task)
    scores = evaluate(records, split=SPLIT, ground_truth=truth, protocol=protocol)
    assert (scores["success"], scores["oracle_success"]) == (success, success)
    assert (scores["sdtw"] > 0) == bool(success)


@pytest.mark.parametrize("task", ["r4r", "rxr"])
def test_both_protocols_agree_with_the_oracle(task: str) -> None:
    """The authors of both tasks score alike, and so does HAMT."""
    worlds = amount(15)
    for seed in range(worlds):
        case = random_case(Random(seed), (0,))
        truth, records = world_of_task(case.world, task), walks_of(case.predictions)
        episodes = [
            measure(case.world.scans[of.scan_id], of, case.predictions[instr_id])
            for of in case.world.items
            for instr_id in of.instr_ids
        ]
        for protocol in ("official-v1", "hamt"):
            scores = evaluate(records, split=SPLIT, ground_truth=truth, protocol=protocol)
            expected = [expected_values(episode, protocol) for episode in episodes]
            for key in expected[0]:
                values = [each[key] for each in expected]
                assert scores.episodes[key] == pytest.approx(values, abs=1e-12), (seed, key)
    tell(**{f"random_worlds_of_{task}": worlds})


def expected_values(episode: Episode, protocol: str) -> Mapping[str, float]:
    """Score an episode by the authors' rules, or HAMT's."""
    near = operator.le if protocol == "official-v1" else operator.lt
    success = near(episode.errors[-1], 3.0)
    by_annotated = weighted(episode.walked, episode.annotated, 0.01, achieved=success)
    by_shortest = weighted(episode.walked, episode.shortest, 0.0, achieved=success)
    return {
        "success": float(success),
        "oracle_success": float(near(min(episode.errors), 3.0)),
        "spl": by_shortest if protocol == "official-v1" else by_annotated,
        "dtw": episode.warped,
        "ndtw": episode.likeness,
        "sdtw": episode.likeness if success else 0.0,
        "cls": episode.coverage,
    }


def test_a_path_that_ends_where_it_starts() -> None:
    """Standing still succeeds; the R2R script's SPL would divide 0 by 0."""
    scan = Scan(
        {"a": Viewpoint((0.0, 0.0, 0.0)), "b": Viewpoint((4.0, 0.0, 0.0))},
        frozenset({("a", "b")}),
    )
    world = World({"house": scan}, [Item("1", "house", ["a", "b", "a"], 0)])
    records = [{"instr_id": "1_0", "trajectory": [["a", 0, 0]]}]
    scores = evaluate(records, split=SPLIT, ground_truth=world_of_task(world, "r4r"))
    assert (scores["success"], scores["spl"]) == (1.0, 1.0)
    assert scores["cls"] < 0.5


def test_files_of_other_tasks_are_recognised() -> None:
    with pytest.raises(SubmissionError, match="look like REVERIE ids, not like R4R ids"):
        evaluate(SAMPLE.with_name("good.json"), split="val_unseen", task="r4r")
    with pytest.raises(SubmissionError, match="look like R4R ids, not like R2R ids"):
        evaluate(SAMPLE, split="val_unseen", task="r2r")
