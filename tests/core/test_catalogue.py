"""Properties of every metric of the CATALOGUE, on random worlds and submissions.

Most are tested on REVERIE, and again on the tasks that have further metrics.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import combinations, product
from pathlib import Path
from random import Random
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reverie_eval import CATALOGUE, PROTOCOLS, GroundTruth, Scores, evaluate, evaluate_protocols
from reverie_eval.arrays import Array
from reverie_eval.scoring import BOX_OUTCOMES, Protocol
from reverie_eval.submissions import Submission
from reverie_eval.tasks import find_task
from tests.support import ndh, soon
from tests.support.family import walks_of
from tests.support.oracle import Scan, score
from tests.support.worlds import (
    SPLIT,
    Case,
    cases,
    cases_with_boxes,
    cases_without_boxes,
    file_of,
    ground_truth_by_hand,
    ground_truth_of,
    random_case,
    records_of,
    scores_of,
)

BY_A_FIXED_DISTANCE = {"ndtw", "sdtw", "cls", "oracle_path_success"}
"""Metrics that depend on 3 m whatever the success rule: in a larger world they never increase."""
GROWTH_IN_A_WORLD_TWICE_AS_LARGE = {"metres": 2, "fraction": 1, "count": 1, "turns": 1}
"""Factor of all others, by their unit."""

ROUNDING = 1e-12
TOLERANCE = {**dict.fromkeys(BY_A_FIXED_DISTANCE, ROUNDING), "iou": 1e-9}
"""Exponentials, and projections through two cameras; all else agrees to the last digit."""
BOX_COLUMNS = ["iou", "iou_25", "iou_50", "iou_75"]
RANDOM_WORLDS, WORLDS_OF_A_TEST = 1000, 100
NEVER_ABOVE = [
    ("spl", "success"),
    ("success", "oracle_success"),
    ("rgspl", "rgs"),
    ("iou_75", "iou_50"),
    ("iou_50", "iou_25"),
    ("iou_50", "rgs"),
    ("oracle_error", "navigation_error"),
    ("sdtw", "ndtw"),
    ("sdtw", "success"),
    ("navigation_error", "dtw"),
]
"""The first never exceeds the second in an episode; DTW ends with the navigation error."""

METRICS = find_task("reverie").metrics
HEADLINE = ["path_length", "success", "oracle_success", "spl", "rgs", "rgspl"]

every_metric = pytest.mark.parametrize("key", CATALOGUE)
few_examples = settings(max_examples=10)
of_every_task = pytest.mark.parametrize("task", ["reverie", "ndh", "soon"])
"""The tasks that have all metrics between them."""


@pytest.mark.parametrize(
    ("key", "value", "shown"),
    [("success", 1.0, "yes"), ("success", 0.0, "no"), ("spl", 0.5, "50.00")],
)
def test_the_value_of_one_episode(key: str, value: float, shown: str) -> None:
    assert CATALOGUE[key].display_one(value) == shown


@pytest.mark.parametrize(
    ("key", "value", "shown", "rounded"),
    [
        pytest.param("success", 0.54532677, "54.53", 0.5453, id="a fraction"),
        pytest.param("path_length", 9.4734, "9.47", 9.47, id="metres"),
        pytest.param("steps", 6.125, "6.12", 6.12, id="a count"),
    ],
)
def test_rounding_keeps_the_digits_that_are_shown(
    key: str, value: float, shown: str, rounded: float
) -> None:
    assert CATALOGUE[key].display(value) == shown
    assert CATALOGUE[key].rounded(value) == rounded


@pytest.mark.parametrize(
    ("scored", "columns"),
    [
        pytest.param(METRICS, [*HEADLINE, *BOX_COLUMNS], id="everything"),
        pytest.param(["success", "spl", "steps"], HEADLINE, id="navigation only: empty columns"),
        pytest.param(["rgs"], ["rgs"], id="grounding alone"),
        pytest.param(["iou_25", "iou", "rgs"], ["rgs", "iou", "iou_25"], id="boxes in any order"),
    ],
)
def test_the_columns_of_a_score_table(scored: Sequence[str], columns: Sequence[str]) -> None:
    shown = find_task("reverie").table_metrics(scored)
    assert [metric.key for metric in shown] == columns


@pytest.mark.parametrize(
    "first",
    [
        pytest.param(first, marks=[pytest.mark.slow] if first else [])
        for first in range(0, RANDOM_WORLDS, WORLDS_OF_A_TEST)
    ],
)
def test_every_protocol_agrees_with_the_oracle(first: int) -> None:
    """To the last digit, except for the kinds with a tolerance."""
    for seed in range(first, first + WORLDS_OF_A_TEST):
        case = random_case(Random(seed))
        submission, truth = records_of(case.predictions), ground_truth_by_hand(case.world)
        assert _differences(case, submission, truth) == [], f"seed {seed}"


@given(case=cases)
def test_every_protocol_agrees_with_the_oracle_from_files(case: Case) -> None:
    assert _differences(case, file_of(case), ground_truth_of(case.world)) == []


def test_random_boxes_have_every_outcome() -> None:
    """Otherwise the agreement above would prove little about boxes."""
    found: Counter[str] = Counter()
    for seed in range(RANDOM_WORLDS // 4):
        case = random_case(Random(seed))
        truth = ground_truth_by_hand(case.world)
        scores = evaluate(records_of(case.predictions), split=SPLIT, ground_truth=truth)
        found["without boxes"] += scores.boxes is None
        found["all boxes"] += "" not in scores.box_outcomes
        found.update(scores.box_outcomes)
    assert {*BOX_OUTCOMES, "without boxes", "all boxes"} <= found.keys()
    assert min(found.values()) >= 50


@every_metric
def test_declared_rules_are_fields_of_the_protocol(key: str) -> None:
    assert CATALOGUE[key].protocol_fields <= {field.name for field in fields(Protocol)}


@few_examples
@given(case=cases_with_boxes)
def test_values_depend_on_the_declared_protocol_fields_only(case: Case) -> None:
    """Two protocols that agree in a metric's fields give it the same values."""
    scores = evaluate_protocols(
        records_of(case.predictions), split=SPLIT, ground_truth=ground_truth_by_hand(case.world)
    ).values()
    for first, second in combinations(scores, 2):
        for key in first.keys() & second.keys():
            given = [
                [getattr(each.protocol, name) for name in CATALOGUE[key].protocol_fields]
                for each in (first, second)
            ]
            if given[0] == given[1]:
                assert first.episodes[key].tolist() == second.episodes[key].tolist(), key


def test_metrics_are_binary_signed_or_partial_exactly_if_they_say_so(tmp_path: Path) -> None:
    found: dict[str, set[str]] = {"other than 0 and 1": set(), "negative": set(), "NaN": set()}
    for task, seed in product(("reverie", "ndh", "soon"), range(50)):
        for scores in scores_of_task(task, seed, tmp_path).values():
            for key, values in scores.episodes.items():
                found["other than 0 and 1"] |= set() if set(values) <= {0, 1} else {key}
                found["negative"] |= {key} if (values < 0).any() else set()
                found["NaN"] |= {key} if np.isnan(values).any() else set()
    assert found == {
        "other than 0 and 1": {key for key, it in CATALOGUE.items() if not it.is_binary},
        "negative": {key for key, it in CATALOGUE.items() if it.is_signed},
        "NaN": {key for key, it in CATALOGUE.items() if it.is_partial},
    }


@given(case=cases)
def test_score_is_the_mean_over_episodes(case: Case) -> None:
    episodes = list(score(case.world, case.predictions)["official-v1"].values())
    means = {key: fmean(values[key] for values in episodes) for key in episodes[0]}
    assert dict(scores_of(case)) == pytest.approx(means, rel=1e-9)


@few_examples
@given(case=cases_with_boxes)
def test_columns_are_in_the_order_of_the_catalogue(case: Case) -> None:
    assert list(scores_of(case).episodes) == list(METRICS)


@few_examples
@given(case=cases_without_boxes)
def test_a_file_without_boxes_has_no_box_metrics(case: Case) -> None:
    scores = scores_of(case)
    assert list(scores.episodes) == [key for key in METRICS if key not in BOX_COLUMNS]
    assert (scores.boxes, set(scores.box_outcomes)) == (None, {""})
    for key in BOX_COLUMNS:
        with pytest.raises(KeyError, match=f"{key} is not scored"):
            scores[key]


@given(case=cases_with_boxes)
def test_values_are_one_per_episode_and_within_the_declared_bounds(case: Case) -> None:
    for key, values in scores_of(case).episodes.items():
        assert values.shape == (len(case.predictions),), key
        assert within_bounds(key, values), key


@given(case=cases_with_boxes, data=st.data())
def test_order_of_records_does_not_matter(case: Case, data: st.DataObject) -> None:
    ground_truth = ground_truth_by_hand(case.world)
    records = records_of(case.predictions)
    shuffled = data.draw(st.permutations(records))
    before, after = (
        evaluate(submission, split=SPLIT, ground_truth=ground_truth).episodes
        for submission in (records, shuffled)
    )
    assert [*after] == [*before]
    for key, values in before.items():
        assert after[key].tolist() == values.tolist(), key


@given(case=cases_with_boxes)
def test_duplicating_every_episode_does_not_change_the_mean(case: Case) -> None:
    assert dict(scores_of(_doubled(case))) == pytest.approx(dict(scores_of(case)), rel=ROUNDING)


@given(case=cases_with_boxes)
def test_doubling_the_world_doubles_metres_only(case: Case) -> None:
    """What depends on a fixed distance never increases with the size of the world."""
    before = scores_of(case).episodes
    for key, values in scores_of(_twice_as_large(case)).episodes.items():
        if key in BY_A_FIXED_DISTANCE:
            assert (values <= before[key] + ROUNDING).all(), key
        else:
            growth = GROWTH_IN_A_WORLD_TWICE_AS_LARGE[CATALOGUE[key].unit]
            assert values == pytest.approx(growth * before[key], rel=ROUNDING), key


@given(case=cases_with_boxes)
def test_metrics_keep_their_order(case: Case) -> None:
    episodes = scores_of(case).episodes
    for smaller, larger in NEVER_ABOVE:
        assert (episodes[smaller] <= episodes[larger]).all(), (smaller, larger)


# The same for the metrics of all tasks, under all protocols.


@of_every_task
def test_values_of_a_task_are_within_the_declared_bounds(task: str, tmp_path: Path) -> None:
    scored = set()
    for seed in range(20):
        for name, scores in scores_of_task(task, seed, tmp_path).items():
            assert list(scores) == [key for key in find_task(task).metrics if key in scores]
            scored |= set(scores)
            for key, values in scores.episodes.items():
                assert values.shape == (len(scores.instr_ids),)
                assert within_bounds(key, values), (seed, name, key)
    assert scored == set(find_task(task).metrics)


@of_every_task
def test_order_of_a_tasks_records_does_not_matter(task: str, tmp_path: Path) -> None:
    for seed in range(10):
        before = scores_of_task(task, seed, tmp_path)
        after = scores_of_task(task, seed, tmp_path, is_shuffled=True)
        for name, scores in before.items():
            for key, values in scores.episodes.items():
                found = after[name].episodes[key]
                assert np.array_equal(found, values, equal_nan=True), (seed, name, key)


@of_every_task
def test_duplicating_every_episode_of_a_task_does_not_change_the_mean(
    task: str, tmp_path: Path
) -> None:
    for seed in range(10):
        doubled = scores_of_task(task, seed, tmp_path, copies=2)
        for name, scores in scores_of_task(task, seed, tmp_path).items():
            expected = pytest.approx(dict(scores), rel=ROUNDING, nan_ok=True)
            assert dict(doubled[name]) == expected, (seed, name)


@of_every_task
def test_doubling_a_tasks_world_doubles_metres_only(task: str, tmp_path: Path) -> None:
    """Other tasks' success depends on 3 m, so of these only the further metrics are looked at."""
    keys = [key for key in find_task(task).metrics if task == "reverie" or key not in METRICS]
    for seed in range(10):
        larger = scores_of_task(task, seed, tmp_path, metres=2)
        for name, scores in scores_of_task(task, seed, tmp_path).items():
            if task == "reverie" and scores.protocol.goal != "visible":
                continue  # its further protocols depend on 3 m
            for key in scores.keys() & set(keys):
                before, after = scores.episodes[key], larger[name].episodes[key]
                if key in BY_A_FIXED_DISTANCE:
                    assert (after <= before + ROUNDING).all(), (seed, name, key)
                else:
                    growth = GROWTH_IN_A_WORLD_TWICE_AS_LARGE[CATALOGUE[key].unit]
                    expected = pytest.approx(growth * before, rel=ROUNDING, nan_ok=True)
                    assert after == expected, (seed, name, key)


class Difference(NamedTuple):
    """A value on which the package and the oracle disagree."""

    protocol: str
    instr_id: str
    key: str
    found: float | None
    expected: float | None


def _differences(
    case: Case, submission: Submission, ground_truth: GroundTruth
) -> Sequence[Difference]:
    """Compare every value under every protocol with the oracle's."""
    scored = evaluate_protocols(submission, split=SPLIT, ground_truth=ground_truth)
    by_protocol = score(case.world, case.predictions, scored)
    assert [*scored] == [*PROTOCOLS]
    differences = []
    for protocol, scores in scored.items():
        columns = {key: column.tolist() for key, column in scores.episodes.items()}
        expected = by_protocol[protocol]
        assert list(scores.instr_ids) == list(expected)
        for row, (instr_id, values) in enumerate(expected.items()):
            assert list(columns) == list(values)
            differences += [
                Difference(protocol, instr_id, key, columns[key][row], value)
                for key, value in values.items()
                if not _is_same(key, columns[key][row], value)
            ]
    return differences


def _is_same(key: str, found: float, expected: float) -> bool:
    return math.isclose(found, expected, rel_tol=0, abs_tol=TOLERANCE.get(key, 0.0))


def within_bounds(key: str, values: Array) -> bool:
    """Whether all values are between a metric's bounds, or missing if only some have one."""
    metric = CATALOGUE[key]
    within = (values >= metric.lower_bound) & (values <= metric.upper_bound)
    return bool((within | (np.isnan(values) & metric.is_partial)).all())


def scores_of_task(
    task: str,
    seed: int,
    folder: Path,
    *,
    metres: int = 1,
    copies: int = 1,
    is_shuffled: bool = False,
) -> Mapping[str, Scores]:
    """Score a random submission for a random world of a task under every protocol.

    Distances are multiplied by ``metres``, and each episode is there ``copies`` times.
    """
    random = Random(seed)
    case = random_case(random, (1, 0.5) if task == "reverie" else (0,))
    regions = [ndh.random_region(random, case.world, each) for each in case.world.items]
    made = soon.random_items(random, case.world)
    case = _twice_as_large(case) if metres == 2 else case
    case = _doubled(case) if copies == 2 else case
    match task:
        case "ndh":
            truth, records = ndh.truth_of(case.world, regions * copies), walks_of(case.predictions)
        case "soon":
            numbers = {old + 10 * copy: old for copy in range(copies) for old in made.walks}
            items = [{**made.items[old], "instr_id": new} for new, old in numbers.items()]
            records = soon.records_of({new: made.walks[old] for new, old in numbers.items()})
            with TemporaryDirectory(dir=folder) as temporary:
                truth = soon.truth_of(Path(temporary) / "world", case.world, items)
        case _:
            truth, records = ground_truth_by_hand(case.world), records_of(case.predictions)
    if is_shuffled:
        random.shuffle(records)
    return evaluate_protocols(records, split=SPLIT, ground_truth=truth)


def _doubled(case: Case) -> Case:
    """Add every episode and its prediction again, under another id."""
    copies = [replace(item, item_id=f"copy_{item.item_id}") for item in case.world.items]
    copied = {f"copy_{instr_id}": done for instr_id, done in case.predictions.items()}
    world = replace(case.world, items=[*case.world.items, *copies])
    return Case(world, {**case.predictions, **copied})


def _twice_as_large(case: Case) -> Case:
    """Double the coordinates of every viewpoint."""
    scans = {id_: _scan_twice_as_large(scan) for id_, scan in case.world.scans.items()}
    return replace(case, world=replace(case.world, scans=scans))


def _scan_twice_as_large(scan: Scan) -> Scan:
    viewpoints = {}
    for viewpoint_id, viewpoint in scan.viewpoints.items():
        x, y, z = viewpoint.position
        viewpoints[viewpoint_id] = replace(viewpoint, position=(2 * x, 2 * y, 2 * z))
    return replace(scan, viewpoints=viewpoints)
