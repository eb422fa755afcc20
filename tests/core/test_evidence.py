"""Numbers about how submissions came about: worked by hand, by slow oracles, and simulated."""

import math
from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from statistics import NormalDist

import numpy as np
import pytest

from fixtures.answer_histories import HONEST, PROBING
from reverie_eval import GroundTruth
from reverie_eval.analysis import (
    FEWEST_FILES,
    HONEST_SPREAD,
    most_similar,
    nearest_earlier,
    spread_of_changes,
)
from reverie_eval.analysis._evidence import _usual_variance, most_frequent
from reverie_eval.arrays import IntArray

FILES = 30


def random_codes(seed: int, files: int = 9, episodes: int = 40) -> IntArray:
    return np.random.default_rng(seed).integers(0, 3, (files, episodes))


@pytest.mark.parametrize("seed", range(5))
def test_the_most_frequent_code_is_that_of_a_counter(seed: int) -> None:
    codes = random_codes(seed)
    for column, found in zip(codes.T.tolist(), most_frequent(codes).tolist(), strict=True):
        counts = Counter(column)
        assert found == min(code for code in counts if counts[code] == max(counts.values()))


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_earlier_file_is_that_of_a_search(seed: int) -> None:
    codes = random_codes(seed)
    nearest, changed = nearest_earlier(codes)
    for row in range(1, len(codes)):
        differing = [int((codes[row] != codes[earlier]).sum()) for earlier in range(row)]
        assert changed[row] == min(differing)
        assert nearest[row] == differing.index(min(differing))


@pytest.mark.parametrize("seed", range(5))
def test_the_most_similar_pairs_are_those_of_a_search(seed: int) -> None:
    codes, group = random_codes(seed), np.array([0, 0, 2, 2, 2, 5, 6, 6, 6])
    best: dict[tuple[int, int], float] = {}
    for one, other in combinations(range(len(codes)), 2):
        if group[one] != group[other]:
            teams = int(group[one]), int(group[other])
            equal = float((codes[one] == codes[other]).mean())
            best[teams] = max(best.get(teams, 0.0), equal)
    found = most_similar(codes, group, 4)
    assert found is not None
    assert found.median == pytest.approx(np.median(list(best.values())))
    assert [pair.equal for pair in found.pairs] == sorted(best.values(), reverse=True)[:4]
    for pair in found.pairs:
        assert pair.equal == (codes[pair.first] == codes[pair.second]).mean()
        assert group[pair.first] < group[pair.second]


def test_of_equally_similar_files_the_first_are_shown() -> None:
    found = most_similar(np.array([[1, 1], [1, 1], [1, 1], [1, 1]]), np.array([0, 0, 1, 1]), 1)
    assert found is not None
    assert found.pairs == [(0, 2, 1.0)]


def test_files_of_one_group_are_not_compared() -> None:
    assert most_similar(random_codes(0), np.zeros(9, dtype=int), 4) is None


def changes_at_random(seed: int, rates: IntArray, episodes: int = 3000) -> IntArray:
    """Return files that each change episodes independently, at a rate of their own."""
    draws = np.random.default_rng(seed).random((len(rates), episodes))
    return (draws < rates[:, None]).astype(np.int64)


@pytest.mark.parametrize(
    "rates",
    [np.full(20, 0.1), np.linspace(0.01, 0.3, 20)],
    ids=["the same rate", "different rates"],
)
def test_changes_at_random_have_a_spread_of_1(rates: IntArray) -> None:
    found = [
        spread_of_changes(changes_at_random(seed, rates), np.arange(3000)) for seed in range(8)
    ]
    spreads = [spread for spread in found if spread is not None]
    assert len(spreads) == len(found)
    assert np.mean([spread.value for spread in spreads]) == pytest.approx(1, abs=0.05)
    assert all(abs(spread.value - 1) < 4 * spread.standard_error for spread in spreads)
    assert all(spread.p_value < 0.001 for spread in spreads)


def test_changes_of_the_same_episodes_have_a_large_spread() -> None:
    rate = np.where(np.arange(3000) < 300, 0.4, 0.02)
    codes = (np.random.default_rng(0).random((20, 3000)) < rate).astype(np.int64)
    spread = spread_of_changes(codes, np.arange(3000))
    assert spread is not None
    assert spread.value > 2
    assert spread.p_value > 0.99


def test_dependent_episodes_count_once() -> None:
    codes = changes_at_random(0, np.full(20, 0.1), 500)
    alone = spread_of_changes(codes, np.arange(500))
    thrice = spread_of_changes(np.repeat(codes, 3, axis=1), np.repeat(np.arange(500), 3))
    assert alone is not None
    assert thrice is not None
    assert thrice.value == pytest.approx(alone.value)
    assert thrice.standard_error == pytest.approx(alone.standard_error)


@pytest.mark.parametrize(
    "codes",
    [
        pytest.param(changes_at_random(0, np.full(FEWEST_FILES - 1, 0.1)), id="too few files"),
        pytest.param(np.zeros((20, 3000), dtype=int), id="no change"),
        pytest.param(
            np.random.default_rng(0).integers(0, 50, (20, 3000)), id="files without a common base"
        ),
    ],
)
def test_what_cannot_be_tested_has_no_spread(codes: IntArray) -> None:
    assert spread_of_changes(codes, np.arange(3000)) is None


def test_the_first_file_has_no_earlier_one() -> None:
    nearest, changed = nearest_earlier(random_codes(0))
    assert (nearest[0], changed[0]) == (-1, -1)
    assert most_frequent(np.array([[3, 1], [2, 1]])).tolist() == [2, 1]


def usual_variance(shares: Sequence[float]) -> float:
    """Return the usual variance of two files or more, by bisection and sums in Python."""
    low, high = 1e-6, 1.0
    for _ in range(80):
        counted = (low + high) / 2
        is_more = 1 - math.prod(1 - counted * share for share in shares) > counted
        low, high = (counted, high) if is_more else (low, counted)
    rates = [high * share for share in shares]
    square = sum(rate * (1 - rate) for rate in rates) + sum(rates) ** 2
    return square / high - sum(shares) ** 2


def dispersion(codes: IntArray, cluster: IntArray) -> tuple[float, float]:
    """Return the index of dispersion and its standard error, worked out once more in Python."""
    base = [Counter(sorted(column)).most_common(1)[0][0] for column in codes.T.tolist()]
    changes = [[code != usual for code, usual in zip(row, base, strict=True)] for row in codes]
    counts = [sum(column) for column in zip(*changes, strict=True)]
    changed = [episode for episode, count in enumerate(counts) if count]
    shares = [sum(row[each] for each in changed) / len(changed) for row in changes]
    mean = sum(counts) / len(changed)
    variance = sum((counts[each] - mean) ** 2 for each in changed) / len(changed)
    usual = usual_variance(shares)
    step = 1e-4
    lower = usual_variance([share * (1 - step) for share in shares])
    slope = (usual - lower) / (step * mean)
    sums: Counter[int] = Counter()
    for each in changed:
        off = counts[each] - mean
        sums[int(cluster[each])] += (off**2 - variance - variance / usual * slope * off) / usual
    error = math.sqrt(sum(each**2 for each in sums.values())) / len(changed)
    return variance / usual, max(error, math.sqrt(2 / len(sums)))


def test_the_usual_variance_of_two_files_by_hand() -> None:
    """Both change three of four: 8 in 9 are counted, of which each changes two in three."""
    assert _usual_variance(np.array([0.75, 0.75])) == pytest.approx(0.25)
    assert _usual_variance(np.array([0.75, 0.75, 0.0])) == pytest.approx(0.25)
    # If one changes all of them, all are counted.
    assert _usual_variance(np.array([1.0, 0.5])) == pytest.approx(0.25)


@pytest.mark.parametrize("episodes", [60, 300])
def test_a_spread_worked_out_once_more(episodes: int) -> None:
    """The standard error is over clusters, and by the jackknife over ten groups of files."""
    rate = np.where(np.arange(episodes) < episodes // 3, 0.4, 0.1)
    codes = (np.random.default_rng(3).random((FEWEST_FILES, episodes)) < rate).astype(np.int64)
    codes[0] = np.arange(episodes) < episodes // 2
    codes[0, : episodes // 2] = 2  # in half of the episodes, so that it still counts
    cluster = np.arange(episodes) // 2
    value, over_clusters = dispersion(codes, cluster)
    # In the smaller file, it is more than that of independent counts, the least that is assumed.
    assert (over_clusters > 1.01 * math.sqrt(4 / episodes)) == (episodes == 60)
    parts = []
    for group in range(10):
        kept = [file for file in range(FEWEST_FILES) if file % 10 != group]
        part, _ = dispersion(codes[kept], cluster)
        parts.append(1 + (part - 1) * (FEWEST_FILES - 1) / (len(kept) - 1))
    mean = sum(parts) / 10
    over_files = math.sqrt(9 * sum((part - mean) ** 2 for part in parts) / 10)
    error = math.hypot(over_clusters, over_files)
    spread = spread_of_changes(codes, cluster)
    assert spread is not None
    assert spread.files == FEWEST_FILES
    assert spread.value == pytest.approx(value)
    assert spread.standard_error == pytest.approx(error, rel=1e-3)
    below = NormalDist().cdf((value - HONEST_SPREAD) / error)
    assert spread.p_value == pytest.approx(below, rel=1e-2)


def test_files_whose_changes_never_meet() -> None:
    """Twenty files, each with a change of its own, and half of an episode per cluster."""
    codes = np.eye(20, 40, dtype=np.int64)
    spread = spread_of_changes(codes, np.arange(40) // 2)
    assert spread is not None
    assert (spread.files, spread.value) == (20, 1.0)
    assert spread.standard_error == pytest.approx(math.sqrt(2 / 10))


def test_files_that_change_all_episodes_or_none() -> None:
    codes = np.zeros((20, 40), dtype=np.int64)
    codes[:9, :10] = 1
    assert spread_of_changes(codes, np.arange(40)) is None


@pytest.mark.parametrize("name", PROBING)
def test_probing_the_demo_world_is_seen(name: str, demo: GroundTruth) -> None:
    answers = PROBING[name](demo.episodes.item, FILES, np.random.default_rng(0))
    spread = spread_of_changes(answers, demo.episodes.item)
    assert spread is not None
    assert spread.value < 1.3
    assert spread.p_value < 0.2


@pytest.mark.parametrize("name", HONEST)
def test_honest_work_on_a_larger_split_is_not(name: str) -> None:
    item = np.repeat(np.arange(400), 3)
    answers = HONEST[name](item, FILES, np.random.default_rng(1))
    spread = spread_of_changes(answers, item)
    assert spread is None or spread.p_value > 0.5


@pytest.mark.parametrize("name", PROBING)
def test_probing_a_larger_split_is(name: str) -> None:
    item = np.repeat(np.arange(400), 3)
    answers = PROBING[name](item, FILES, np.random.default_rng(1))
    spread = spread_of_changes(answers, item)
    assert spread is not None
    assert spread.p_value < 0.001
