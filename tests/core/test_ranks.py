"""Ranks with their uncertainty: by hand, at the edges, and on simulated leaderboards."""

import numpy as np
import pytest

from fixtures.ranked_worlds import simulated_coverage
from reverie_eval.analysis import covariance_of_means, rank_intervals

FAR, NEAR = 10.0, 0.1


@pytest.mark.parametrize(
    ("costs", "low", "high", "group"),
    [
        pytest.param([0, FAR, 2 * FAR], [1, 2, 3], [1, 2, 3], [1, 2, 3], id="far apart"),
        pytest.param([0, 0, 0], [1, 1, 1], [3, 3, 3], [1, 1, 1], id="equal"),
        pytest.param([FAR, 0, NEAR], [3, 1, 1], [3, 2, 2], [2, 1, 1], id="in any order"),
        # The middle one is not significantly worse than the first, nor better than the last.
        pytest.param([0, 2.5, 5], [1, 1, 2], [2, 3, 3], [1, 1, 2], id="chained"),
        pytest.param([0], [1], [1], [1], id="alone"),
    ],
)
def test_by_hand(costs: list[float], low: list[int], high: list[int], group: list[int]) -> None:
    """Standard error of each is 1, so that of a difference 1.41; the bound is about 2.34 of these.

    That is 3.31 / sqrt(2), with the 95 % quantile of the studentised range of three means.
    """
    found = rank_intervals(np.array(costs, dtype=float), np.eye(len(costs)), np.inf)
    assert [each.tolist() for each in found] == [low, high, group]


@pytest.mark.parametrize(("difference", "is_told"), [(3.2, False), (3.45, True)])
def test_the_bound_is_that_of_the_studentised_range(difference: float, *, is_told: bool) -> None:
    """Tukey's method for three independent means: 3.314 (Pearson and Hartley, table 29)."""
    found = rank_intervals(np.array([0, 1.6, difference]), np.eye(3), np.inf)
    assert bool(found.low[2] > 1) is is_told


@pytest.mark.parametrize(("difference", "is_told"), [(2.7, False), (2.85, True), (3.2, True)])
def test_pairs_that_are_set_apart_leave_a_smaller_bound(
    difference: float, *, is_told: bool
) -> None:
    """The last two are the only open pair: 1.96 * sqrt(2) = 2.77; of three means it is 3.31."""
    found = rank_intervals(np.array([0, 100, 100 + difference]), np.eye(3), np.inf)
    assert found.low.tolist() == [1, 2, 3 if is_told else 2]
    assert found.high.tolist() == [1, 2 if is_told else 3, 3]


def test_few_clusters_make_ranks_less_certain() -> None:
    costs = np.array([0.0, 5.0])
    assert rank_intervals(costs, np.eye(2), np.inf).high.tolist() == [1, 2]
    assert rank_intervals(costs, np.eye(2), 3).high.tolist() == [2, 2]


@pytest.mark.parametrize(
    ("errors", "n_clusters", "is_told"),
    [
        pytest.param(3.7, 5, False, id="below the quantile of 2 degrees of freedom"),
        pytest.param(4.9, 5, True, id="above it"),
        pytest.param(3.7, 7, True, id="above that of 3"),
    ],
)
def test_clusters_count_for_half_a_degree_of_freedom(
    errors: float, n_clusters: int, *, is_told: bool
) -> None:
    """In standard errors of a difference, t is 4.30 with 2 degrees of freedom, 3.18 with 3."""
    found = rank_intervals(np.array([0, errors * 2**0.5]), np.eye(2), n_clusters)
    assert (found.low.tolist() == [1, 2]) is is_told


def test_only_results_that_go_together_are_told_apart_by_little() -> None:
    """The errors of the differences are 0.14, 1.41 and 1.41; the bound is above 1.96 of these."""
    covariance = np.array([[1, 0.99, 0], [0.99, 1, 0], [0, 0, 1]])
    found = rank_intervals(np.array([0, 0.5, 2.7]), covariance, np.inf)
    assert (found.low.tolist(), found.high.tolist()) == ([1, 2, 1], [2, 3, 3])


def test_rounding_tells_nothing_apart() -> None:
    covariance = np.array([[1, 1 - 2**-53], [1 - 2**-53, 1]])
    assert rank_intervals(np.array([0, 1e-6]), covariance, np.inf).group.tolist() == [1, 1]


def test_results_on_the_same_episodes_are_compared_in_pairs() -> None:
    """One is better by 0.1 wherever both have a chance; alone, their errors are far larger."""
    rng = np.random.default_rng(0)
    base = rng.normal(0, 5, 100)
    sums = np.column_stack([base, base + 0.1 + rng.normal(0, 0.01, 100)])
    covariance = covariance_of_means(sums, np.ones(100))
    costs = sums.mean(axis=0)
    assert rank_intervals(costs, covariance, 100).group.tolist() == [1, 2]
    assert rank_intervals(costs, np.diag(np.diag(covariance)), 100).group.tolist() == [1, 1]


def test_the_same_result_twice_is_not_told_apart() -> None:
    sums = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0], [1.0, 1.0, 2.0]])
    covariance = covariance_of_means(sums, np.array([2.0, 1.0, 3.0]))
    found = rank_intervals(sums.sum(axis=0) / 6, covariance, 3)
    assert found.low[0] == found.low[1]
    assert found.high[0] == found.high[1]


def test_the_covariance_of_means() -> None:
    """By hand: residuals 1 - 2/3 * 2 and 1 - 2/3 * 1, of 2 clusters, over 3 episodes squared."""
    covariance = covariance_of_means(np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([2.0, 1.0]))
    variance = ((-1 / 3) ** 2 + (1 / 3) ** 2) / 9 * 2
    assert covariance == pytest.approx(np.array([[variance, 0], [0, 0]]))


def test_true_ranks_are_within_on_simulated_leaderboards() -> None:
    """The long form is benchmarks/rank_intervals.py."""
    shares = simulated_coverage(30, (10, 10), 40, "equal")
    assert shares.paired >= 0.85
    assert shares.shown == 1
    different = simulated_coverage(10, (10, 10), 40, "different")
    assert different.ranks < different.ranks_in_one_step < 10
