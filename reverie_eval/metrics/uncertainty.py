"""Uncertainty of means over clustered episodes.

Episodes are not independent: the instructions of an item share path and target, and items share
targets and buildings. Therefore whole clusters are drawn, or swapped, at random.

Functions take one row per episode and one column per metric. Those that draw at random are seeded.
"""

from collections.abc import Iterator

import numpy as np

from reverie_eval.arrays import ROUNDING, Array, FloatArray, IntArray
from reverie_eval.errors import naming_missing_parts

CONFIDENCE = 0.95
RESAMPLES = 10_000
SEED = 0
SWAPS_PER_COMPARISON = 1_000
"""Enough that a p-value corrected by Holm's method can be below 0.001."""
MOST_SWAPS = 100_000
"""Enough for 100 comparisons; more would take minutes for hundreds of them."""

# Resamples held in memory at once.
_BATCH = 500


def bootstrap_means(
    values: FloatArray, cluster: IntArray, *, resamples: int = RESAMPLES, seed: int = SEED
) -> FloatArray:
    """Draw clusters with replacement and return the means over their episodes.

    Parameters
    ----------
    values : array, shape (n_episodes, n_metrics)
    cluster : array of int, shape (n_episodes,)
        Equal numbers mean the same cluster.
    resamples, seed : int

    Returns
    -------
    array, shape (resamples, n_metrics)

    References
    ----------
    .. [1] Field and Welsh, "Bootstrapping clustered data", JRSS B 69(3), 2007: the cluster
       bootstrap.
    """
    sums, sizes = cluster_sums(values, cluster)
    sums_and_sizes = np.column_stack([sums, sizes])
    n_clusters = len(sizes)
    rng = np.random.default_rng(seed)
    means = np.empty((resamples, values.shape[1]))
    for batch in _batches(resamples):
        count = batch.stop - batch.start
        drawn = rng.integers(n_clusters, size=(count, n_clusters), dtype=np.int32)
        # One bincount for all resamples of the batch: each has cells of its own. 64-bit cells,
        # because bincount would copy any others.
        cell = drawn + n_clusters * np.arange(count)[:, None]
        times = np.bincount(cell.ravel(), minlength=count * n_clusters)
        times = times.reshape(count, n_clusters).astype(float)
        # Not by ``@``: the order of BLAS's sums, and so their last digit, depends on its threads.
        total = np.einsum("rc,cm->rm", times, sums_and_sizes)
        # Clusters differ in size, so the number of episodes is random too.
        means[batch] = total[:, :-1] / total[:, -1:]
    return means


def interval(means: FloatArray, n_clusters: int, *, confidence: float = CONFIDENCE) -> FloatArray:
    """Return a confidence interval from bootstrap means.

    Percentiles of resamples are too narrow with few clusters, so they are moved outwards, by as
    much as Student's t distribution is wider than the normal.

    Parameters
    ----------
    means : array, shape (resamples, n_metrics)
    n_clusters : int
        Number of clusters that were drawn from, at least 2.
    confidence : float
        In (0, 1).

    Returns
    -------
    array, shape (2, n_metrics)
        Low and high ends.

    References
    ----------
    .. [1] Hesterberg, "What Teachers Should Know About the Bootstrap", The American Statistician
       69(4), 2015, section 5.3: the expanded percentile interval.
    """
    with naming_missing_parts():
        from scipy.special import ndtr, stdtrit  # takes longer to import than all of this module

    freedom = n_clusters - 1
    # The root undoes that resamples vary by n and not by n - 1.
    outermost = stdtrit(freedom, (1 - confidence) / 2) * np.sqrt(n_clusters / freedom)
    tail = float(ndtr(outermost))
    return np.quantile(means, [tail, 1 - tail], axis=0)


def randomisation_p(
    difference: FloatArray, cluster: IntArray, *, resamples: int = RESAMPLES, seed: int = SEED
) -> FloatArray:
    """Test the mean difference of two submissions by swapping their results in random clusters.

    Parameters
    ----------
    difference : array, shape (n_episodes, n_metrics)
        One submission's values minus the other's.
    cluster : array of int, shape (n_episodes,)
    resamples, seed : int

    Returns
    -------
    array, shape (n_metrics,)
        Two-sided p-values in (0, 1]: the share of random swaps whose sum of differences is at least
        as far from 0 as the observed one, counting the observed one [2]_.

    References
    ----------
    .. [1] Noreen, "Computer-Intensive Methods for Testing Hypotheses", Wiley 1989: approximate
       randomisation.
    .. [2] Phipson and Smyth, "Permutation P-values Should Never Be Zero", SAGMB 9(1), 2010.
    """
    sums, _ = cluster_sums(difference, cluster)
    observed = np.abs(sums.sum(axis=0))
    # Swapping everything gives the observed sum up to rounding, and must count as a tie.
    extreme = observed - ROUNDING * np.abs(sums).sum(axis=0)
    rng = np.random.default_rng(seed)
    n_extreme = np.zeros(sums.shape[1], dtype=np.int64)
    for batch in _batches(resamples):
        sign = rng.integers(2, size=(batch.stop - batch.start, len(sums)), dtype=np.int8)
        # A swap changes the sign of a cluster's sum; signs for all resamples at once are one
        # product.
        swapped = (2.0 * sign - 1.0) @ sums
        n_extreme += (np.abs(swapped) >= extreme).sum(axis=0)
    # The observed assignment is one of the possible ones, so no p-value is 0.
    return np.asarray((n_extreme + 1) / (resamples + 1))


def swaps_for(n_comparisons: int) -> int:
    """Return how many random swaps the tests of several comparisons need.

    Holm's method multiplies the smallest p-value by their number, and p is at least
    ``1 / (swaps + 1)``.

    >>> swaps_for(1), swaps_for(49), swaps_for(500)
    (10000, 49000, 100000)
    """
    return min(max(RESAMPLES, SWAPS_PER_COMPARISON * n_comparisons), MOST_SWAPS)


def smallest_p(n_comparisons: int, n_clusters: int) -> float:
    """Return the smallest corrected p-value that any difference could have, in (0, 1].

    Of all swaps of ``n_clusters`` clusters, two give the largest difference: none and all. Of the
    random swaps, at least one counts: the observed difference itself.
    """
    # With few clusters the number of different swaps is the limit, with many the number drawn.
    uncorrected = max(2.0 ** (1 - n_clusters), 1 / (swaps_for(n_comparisons) + 1))
    return min(1.0, n_comparisons * uncorrected)


def mcnemar_p(won: Array, lost: Array) -> FloatArray:
    """McNemar's exact test of whether two submissions win equally many episodes.

    It assumes independent episodes, so its p-values are too small for clustered ones. Other papers
    report it.

    Parameters
    ----------
    won, lost : arrays of int, shape (n_metrics,)
        Episodes in which only the one submission succeeded, and in which only the other did.

    Returns
    -------
    array, shape (n_metrics,)
        Two-sided p-values in (0, 1]; 1 if no episode differs. Those below the smallest normal
        float, 2.2e-308, are returned as that: from 1,024 episodes won and none lost.

    References
    ----------
    .. [1] McNemar, "Note on the sampling error of the difference between correlated proportions
       or percentages", Psychometrika 12(2), 1947.
    """
    with naming_missing_parts():
        from scipy.special import bdtr

    # Doubling the smaller tail can exceed 1, as it counts a balanced outcome in both tails.
    smaller, total = np.minimum(won, lost), won + lost
    p_value = 2.0 * bdtr(smaller.astype(float), total, 0.5)
    return np.asarray(np.clip(p_value, np.finfo(np.float64).tiny, 1.0))


def holm(p_values: FloatArray, family: int | None = None) -> FloatArray:
    """Correct the p-values of several comparisons by Holm's method.

    The probability of any false alarm is then at most that of a single comparison.

    Parameters
    ----------
    p_values : array, shape (n_comparisons, ...)
        Corrected along the first axis.
    family : int, optional
        The number of comparisons from which these were chosen, if there were more.

    References
    ----------
    .. [1] Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of
       Statistics 6(2), 1979.
    """
    order = np.argsort(p_values, axis=0)
    ordered = np.take_along_axis(p_values, order, axis=0)
    most = len(p_values) if family is None else family
    remaining = np.arange(most, most - len(p_values), -1).reshape(-1, *[1] * (p_values.ndim - 1))
    # A comparison cannot be more significant than one with a smaller uncorrected p-value.
    stepped = np.minimum(1.0, np.maximum.accumulate(ordered * remaining, axis=0))
    corrected = np.empty_like(stepped)
    np.put_along_axis(corrected, order, stepped, axis=0)
    return corrected


def cluster_sums(values: FloatArray, cluster: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the sums of each cluster's values, shape (n_clusters, n_metrics), and the sizes."""
    _, row = np.unique(cluster, return_inverse=True)
    sums: FloatArray = np.column_stack([np.bincount(row, weights=column) for column in values.T])
    sizes: FloatArray = np.bincount(row).astype(np.float64)
    return sums, sizes


def _batches(resamples: int) -> Iterator[slice]:
    """Split the resamples into batches that fit into memory."""
    for start in range(0, resamples, _BATCH):
        yield slice(start, min(start + _BATCH, resamples))
