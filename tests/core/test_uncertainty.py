"""Uncertainty: by hand, compared with enumeration and scipy, and in worlds with known means."""

import os
import subprocess
import sys
from itertools import product

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from fixtures.clustered_worlds import simulated_coverage, simulated_false_alarms
from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.metrics.uncertainty import (
    bootstrap_means,
    holm,
    interval,
    mcnemar_p,
    randomisation_p,
    smallest_p,
)


def column(*values: float) -> FloatArray:
    return np.array(values, dtype=np.float64)[:, None]


def test_resampled_means_are_means_of_drawn_clusters() -> None:
    """Clusters of 0, 0, 3 and of 5 have the means 1, 5 or, if both are drawn, 2."""
    means = bootstrap_means(column(0, 5, 0, 3), np.array([7, 9, 7, 7]), resamples=4000)
    values, counts = np.unique(means, return_counts=True)
    assert values.tolist() == [1, 2, 5]
    assert counts / 4000 == pytest.approx([0.25, 0.5, 0.25], abs=0.03)


def test_metrics_are_resampled_together() -> None:
    values = np.random.default_rng(0).random((60, 1))
    means = bootstrap_means(np.hstack([values, 1 - values]), np.arange(60) // 3, resamples=700)
    assert means.sum(axis=1) == pytest.approx(1.0)
    assert np.unique(means[:, 0]).size > 600


def test_the_seed_determines_the_resamples() -> None:
    values, cluster = column(*range(30)), np.arange(30) // 2
    first, again, other = (bootstrap_means(values, cluster, seed=seed) for seed in (3, 3, 4))
    assert (first == again).all()
    assert (first != other).any()


def test_the_digits_do_not_depend_on_the_number_of_threads() -> None:
    code = (
        "import numpy as np; from reverie_eval.metrics.uncertainty import bootstrap_means;"
        "values = np.random.default_rng(0).random((3521, 12)); cluster = np.arange(3521) // 7;"
        "print(bootstrap_means(values, cluster, resamples=500).tolist())"
    )
    one, two = (
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"OPENBLAS_NUM_THREADS": threads},
            capture_output=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    )
    assert one == two


def test_standard_errors_equal_scipys_on_cluster_sums() -> None:
    rng = np.random.default_rng(5)
    cluster = rng.integers(80, size=400)
    values = rng.random(400) + rng.random(80)[cluster]
    sums, sizes = np.bincount(cluster, weights=values), np.bincount(cluster)

    def mean(sums: FloatArray, sizes: IntArray, axis: int) -> FloatArray:
        return np.asarray(sums.sum(axis) / sizes.sum(axis))

    theirs = scipy.stats.bootstrap(
        (sums, sizes), mean, paired=True, vectorized=True, n_resamples=9000, random_state=6
    )
    ours = bootstrap_means(values[:, None], cluster)
    assert ours.std() == pytest.approx(theirs.standard_error, rel=0.03)


def test_an_interval_of_many_clusters_is_close_to_the_percentiles() -> None:
    means = np.arange(10_001, dtype=np.float64)[:, None] / 10_000
    assert interval(means, 10**9)[:, 0] == pytest.approx([0.025, 0.975], abs=1e-4)
    assert interval(means, 10**9, confidence=0.5)[:, 0] == pytest.approx([0.25, 0.75], abs=1e-4)


def test_an_interval_of_five_clusters_is_wider_by_students_t() -> None:
    """By hand: t(0.025, 4) = -2.7764, times sqrt(5 / 4) is -3.1042, below which 0.000954 lies."""
    means = np.arange(100_001, dtype=np.float64)[:, None] / 100_000
    assert interval(means, 5)[:, 0] == pytest.approx([0.000954, 0.999046], abs=2e-6)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(-2, 2)), min_size=1, max_size=12))
def test_random_swaps_approach_the_exact_test(episodes: list[tuple[int, int]]) -> None:
    cluster = np.array([number for number, _ in episodes])
    difference = column(*(value for _, value in episodes))
    sums = [difference[cluster == number].sum() for number in set(cluster.tolist())]
    swapped = [abs(np.dot(signs, sums)) for signs in product((-1, 1), repeat=len(sums))]
    exact = np.mean([total >= abs(sum(sums)) for total in swapped])
    assert randomisation_p(difference, cluster) == pytest.approx([exact], abs=0.03)


def test_sums_that_differ_only_by_rounding_are_ties() -> None:
    """In both clusters 0.1 + 0.2 and 0.3: every swap is as far from 0 as the observed sum."""
    difference = column(0.1, 0.2, -0.3)
    assert randomisation_p(difference, np.array([0, 0, 1])).tolist() == [1.0]


def test_what_counts_as_rounding_is_decided_for_each_metric_alone() -> None:
    """A certain difference in fractions stays certain beside one of a thousand billion metres."""
    difference = np.column_stack([np.ones(50), np.full(50, 1e12)])
    p_values = randomisation_p(difference, np.arange(50), resamples=999)
    assert p_values.tolist() == [1 / 1000, 1 / 1000]


def test_a_certain_difference_has_the_smallest_possible_p_value() -> None:
    p_value = randomisation_p(np.ones((50, 1)), np.arange(50), resamples=999)
    assert p_value.tolist() == [1 / 1000]


@pytest.mark.parametrize(
    ("won", "lost", "p_value"),
    [
        pytest.param(0, 0, 1.0, id="nothing differs"),
        pytest.param(4, 4, 1.0, id="balanced"),
        pytest.param(5, 0, 2 / 32, id="all won"),
        pytest.param(0, 5, 2 / 32, id="all lost"),
        pytest.param(1, 7, 2 * (1 + 8) / 256, id="one of eight"),
        pytest.param(1023, 0, 2.0**-1022, id="the smallest that a float holds"),
        pytest.param(3521, 0, 2.0**-1022, id="smaller than a float holds, and never 0"),
    ],
)
def test_mcnemars_exact_test(won: int, lost: int, p_value: float) -> None:
    assert mcnemar_p(np.array([won]), np.array([lost])) == pytest.approx([p_value], abs=0)


@pytest.mark.parametrize(
    ("comparisons", "clusters", "expected"),
    [
        pytest.param(1, 513, 1 / 10_001, id="one comparison"),
        pytest.param(10, 513, 10 / 10_001, id="ten share the swaps of one"),
        pytest.param(49, 513, 49 / 49_001, id="49 have more swaps, so p < 0.001 stays possible"),
        pytest.param(600, 513, 600 / 100_001, id="600 can still be significant"),
        pytest.param(1, 5, 2 / 32, id="two of the 32 swaps of five clusters"),
        pytest.param(3, 5, 6 / 32, id="times three by Holm's correction"),
        pytest.param(20, 5, 1.0, id="never above 1"),
    ],
)
def test_the_smallest_p_value(comparisons: int, clusters: int, expected: float) -> None:
    assert smallest_p(comparisons, clusters) == pytest.approx(expected, rel=1e-12)


def test_holm_multiplies_by_the_remaining_comparisons_and_never_decreases() -> None:
    """By hand, sorted: 0.01 x 4, 0.02 x 3, 0.025 x 2 = 0.05 but not below 0.06, 0.9 x 1."""
    corrected = holm(column(0.02, 0.9, 0.01, 0.025))
    assert corrected[:, 0] == pytest.approx([0.06, 0.9, 0.04, 0.06])
    assert holm(column(0.6, 0.7))[:, 0].tolist() == [1.0, 1.0]
    assert holm(column(0.03)).tolist() == [[0.03]]


@pytest.mark.slow
@pytest.mark.parametrize("clusters", [100, 10], ids=["as targets", "as scans"])
def test_intervals_contain_the_true_mean_as_often_as_they_claim(clusters: int) -> None:
    """In 1,000 worlds; intervals for independent episodes are too narrow."""
    coverage = simulated_coverage(1000, clusters)
    assert 0.93 <= coverage.clustered <= 0.97
    assert coverage.naive < 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("clusters", "truth"),
    [(2, 0.5), (3, 0.5), (5, 0.5), (20, 0.05), (100, 0.02)],
    ids=["2", "3", "5", "rare in 20", "rare in 100"],
)
def test_intervals_of_few_informative_clusters_contain_it_as_often(
    clusters: int, truth: float
) -> None:
    """Percentiles of resamples contain it in 61, 82, 93, 87 and 89 % of these worlds."""
    assert simulated_coverage(1000, clusters, truth).clustered >= 0.93


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_claimed() -> None:
    """Among 4,000 pairs of equally good methods; McNemar's test assumes independent episodes."""
    alarms = simulated_false_alarms(4000, 100)
    assert 0.04 <= alarms.clustered <= 0.06
    assert alarms.naive > 0.1
