"""How certain ranks are: which ranks each of several results may have, and which groups they form.

These are the ranks of true means, over all episodes that a split might have had.
"""

from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray

DRAWS = 2_000
"""Of the largest difference; their 95 % quantile is then the 94 to 96 % quantile."""
_SHARE_OF_FREEDOM = 0.5
"""Degrees of freedom per cluster. Differences of two results have heavy tails, as they are 0 in
most clusters: a variance estimated with a kurtosis of 5 is as certain as that of half as many
normal values. Measured in docs/explanation/evidence.md."""
_BATCH = 100
"""Draws in memory at once: of 100 results, a million differences."""


class Ranks(NamedTuple):
    """What is known of the ranks of results; arrays of shape (n_results,), in their order."""

    low: IntArray
    """The best rank that each may have, from 1."""
    high: IntArray
    """The worst."""
    group: IntArray
    """From 1. A group begins with the best result outside earlier groups, and includes all that
    follow until one is significantly worse than the group's first."""


def covariance_of_means(sums: FloatArray, sizes: FloatArray) -> FloatArray:
    """Estimate the covariance of means over the same clustered episodes.

    Parameters
    ----------
    sums : array, shape (n_clusters, n_results)
        Of each result's values in each cluster.
    sizes : array, shape (n_clusters,)
        Number of episodes; there are at least two clusters.

    Returns
    -------
    array, shape (n_results, n_results)

    References
    ----------
    .. [1] Cochran, "Sampling Techniques", 3rd edition, Wiley 1977, section 9A.2: the variance of a
       ratio estimate, for clusters of unequal sizes.
    """
    n_clusters, n_episodes = len(sizes), sizes.sum()
    residual = sums - np.outer(sizes, sums.sum(axis=0) / n_episodes)
    covariance: FloatArray = residual.T @ residual / n_episodes**2
    return covariance * n_clusters / (n_clusters - 1)


def rank_intervals(costs: FloatArray, covariance: FloatArray, n_clusters: float) -> Ranks:
    """Bound the rank of every result: all true ranks are within at once, with 95 % confidence.

    All pairwise differences are compared with one bound, the quantile of the largest of them in
    standard errors if all true means were equal [1]_. The best rank of a result is one more than
    the number of those that are significantly better [2]_.

    Parameters
    ----------
    costs : array, shape (n_results,)
        Means; lower is better.
    covariance : array, shape (n_results, n_results)
        Of the means.
    n_clusters : float
        Number of clusters that the covariance was estimated from; infinity if it is a bound.

    References
    ----------
    .. [1] Hothorn, Bretz and Westfall, "Simultaneous Inference in General Parametric Models",
       Biometrical Journal 50(3), 2008: the single-step max-t procedure.
    .. [2] Mogstad, Romano, Shaikh and Wilhelm, "Inference for Ranks with Applications to Mobility
       across Neighbourhoods and Academic Achievement across Countries", Review of Economic Studies
       91(1), 2024, section 3.

    Examples
    --------
    >>> costs = np.array([0.0, 0.1, 5.0])
    >>> low, high, group = rank_intervals(costs, np.eye(3) / 10, np.inf)
    >>> low.tolist(), high.tolist(), group.tolist()
    ([1, 1, 3], [2, 2, 3], [1, 1, 2])
    """
    variance = np.diag(covariance)
    squares = variance[:, None] + variance - 2 * covariance
    # Results with the same value in every episode differ by nothing, up to rounding.
    is_same = squares <= np.finfo(np.float64).eps * (variance[:, None] + variance)
    error = np.where(is_same, np.inf, np.sqrt(np.maximum(squares, 0)))
    bound = _largest_difference(covariance, error, (n_clusters - 1) * _SHARE_OF_FREEDOM)
    is_better: BoolArray = (costs - costs[:, None]) / error > bound
    low, high = 1 + is_better.sum(axis=0), len(costs) - is_better.sum(axis=1)
    return Ranks(low, high, _groups(costs, is_better))


def _largest_difference(covariance: FloatArray, error: FloatArray, freedom: float) -> float:
    """Return the 95 % quantile of the largest difference of two results, in standard errors.

    If all true means are equal. Estimated errors are allowed for as in the interval of a mean: the
    normal quantile is replaced by the t quantile of the same probability.
    """
    # Only intervals need scipy, which these import.
    from scipy.special import ndtr, stdtrit

    from reverie_eval.metrics.uncertainty import CONFIDENCE, SEED

    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    first, second = np.triu_indices(len(covariance), k=1)
    rng = np.random.default_rng(SEED)
    largest = np.empty(DRAWS)
    for start in range(0, DRAWS, _BATCH):
        drawn = rng.standard_normal((_BATCH, len(covariance))) @ root.T
        difference = np.abs(drawn[:, first] - drawn[:, second]) / error[first, second]
        largest[start : start + _BATCH] = difference.max(axis=1, initial=0.0)
    normal = float(np.quantile(largest, CONFIDENCE, method="higher"))
    return normal if np.isinf(freedom) else -float(stdtrit(freedom, float(ndtr(-normal))))


def _groups(costs: FloatArray, is_better: BoolArray) -> IntArray:
    group = np.empty(len(costs), dtype=np.int64)
    first, number = -1, 0
    for place in np.argsort(costs, kind="stable").tolist():
        if first < 0 or is_better[first, place]:
            first, number = place, number + 1
        group[place] = number
    return group
