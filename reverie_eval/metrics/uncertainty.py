"""Uncertainty of means over episodes that come in clusters.

Episodes are not independent: the instructions of a task share path and target, and tasks share
targets and buildings. So whole clusters are what is drawn, or swapped, at random.

All functions take one row per episode and one column per metric, and are seeded.
"""

from collections.abc import Iterator

import numpy as np
from scipy.special import bdtr, ndtr, stdtrit

from reverie_eval.arrays import Array, FloatArray, IntArray

CONFIDENCE = 0.95
RESAMPLES = 10_000
SEED = 0

_AT_ONCE = 500
"""Resamples that are held in memory together."""
_TIE = 1e-9
"""Relative; sums that differ by less are the same number, added up in another order."""


def bootstrap_means(
    values: FloatArray, cluster: IntArray, *, resamples: int = RESAMPLES, seed: int = SEED
) -> FloatArray:
    """Draw clusters with replacement, and take the means over their episodes.

    Parameters
    ----------
    values : array, shape (n_episodes, n_metrics)
    cluster : array of int, shape (n_episodes,)
        Whatever numbers tell the clusters apart.
    resamples, seed : int

    Returns
    -------
    array, shape (resamples, n_metrics)
        Clusters differ in size, so each is a ratio of two sums.

    References
    ----------
    .. [1] Field and Welsh, "Bootstrapping clustered data", JRSS B 69(3), 2007: the cluster
       bootstrap.
    """
    sums, sizes = _by_cluster(values, cluster)
    both = np.column_stack([sums, sizes])
    n_clusters = len(sizes)
    rng = np.random.default_rng(seed)
    means = np.empty((resamples, values.shape[1]))
    for part in _parts(resamples):
        count = part.stop - part.start
        drawn = rng.integers(n_clusters, size=(count, n_clusters), dtype=np.int32)
        cell = drawn + n_clusters * np.arange(count)[:, None]  # 64 bits, which bincount counts best
        times = np.bincount(cell.ravel(), minlength=count * n_clusters)
        total = times.reshape(count, n_clusters).astype(float) @ both
        means[part] = total[:, :-1] / total[:, -1:]
    return means


def interval(means: FloatArray, n_clusters: int, *, confidence: float = CONFIDENCE) -> FloatArray:
    """Return a confidence interval from bootstrap means.

    Percentiles, moved outwards as Student's t is wider than the normal: with few clusters the
    percentiles of resamples are too narrow.

    Parameters
    ----------
    means : array, shape (resamples, n_metrics)
    n_clusters : int
        How many clusters there were to draw from, at least 2.
    confidence : float
        In (0, 1).

    Returns
    -------
    array, shape (2, n_metrics)
        Low and high.

    References
    ----------
    .. [1] Hesterberg, "What Teachers Should Know About the Bootstrap", The American Statistician
       69(4), 2015, section 5.3: the expanded percentile interval.
    """
    freedom = n_clusters - 1
    outermost = stdtrit(freedom, (1 - confidence) / 2) * np.sqrt(n_clusters / freedom)
    tail = float(ndtr(outermost))
    return np.quantile(means, [tail, 1 - tail], axis=0)


def randomisation_p(
    difference: FloatArray, cluster: IntArray, *, resamples: int = RESAMPLES, seed: int = SEED
) -> FloatArray:
    """Test whether two submissions could be swapped, cluster by cluster, without a trace.

    Parameters
    ----------
    difference : array, shape (n_episodes, n_metrics)
        Of the two submissions' values.
    cluster : array of int, shape (n_episodes,)
    resamples, seed : int

    Returns
    -------
    array, shape (n_metrics,)
        Two-sided p-values in (0, 1]: the share of random swaps whose sum of differences is at
        least as far from 0 as what was found, which counts as one of them.

    References
    ----------
    .. [1] Noreen, "Computer-Intensive Methods for Testing Hypotheses", Wiley 1989: approximate
       randomisation.
    .. [2] Phipson and Smyth, "Permutation P-values Should Never Be Zero", SAGMB 9(1), 2010.
    """
    sums, _ = _by_cluster(difference, cluster)
    found = np.abs(sums.sum(axis=0))
    enough = found - _TIE * np.abs(sums).sum(axis=0)
    rng = np.random.default_rng(seed)
    as_far = np.zeros(sums.shape[1], dtype=np.int64)
    for part in _parts(resamples):
        sign = rng.integers(2, size=(part.stop - part.start, len(sums)), dtype=np.int8)
        swapped = (2.0 * sign - 1.0) @ sums
        as_far += (np.abs(swapped) >= enough).sum(axis=0)
    p_value: FloatArray = (as_far + 1) / (resamples + 1)
    return p_value


def mcnemar_p(won: Array, lost: Array) -> FloatArray:
    """Test whether as many episodes were won as lost, as if each stood for itself.

    The exact test. It takes episodes for independent, and so finds more than there is where they
    come in clusters; it is what other papers report.

    Parameters
    ----------
    won, lost : arrays of int, shape (n_metrics,)
        Episodes in which only the one, or only the other, succeeded.

    Returns
    -------
    array, shape (n_metrics,)
        Two-sided p-values in (0, 1]; 1 where no episode tells the two apart.

    References
    ----------
    .. [1] McNemar, "Note on the sampling error of the difference between correlated proportions
       or percentages", Psychometrika 12(2), 1947.
    """
    fewer, both = np.minimum(won, lost), won + lost
    p_value: FloatArray = np.minimum(1.0, 2.0 * bdtr(fewer.astype(float), both, 0.5))
    return p_value


def holm(p_values: FloatArray) -> FloatArray:
    """Correct p-values of several comparisons, so that one false alarm stays as rare as in one.

    Parameters
    ----------
    p_values : array, shape (n_comparisons, ...)
        Corrected along the first axis.

    References
    ----------
    .. [1] Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of
       Statistics 6(2), 1979.
    """
    order = np.argsort(p_values, axis=0)
    ordered = np.take_along_axis(p_values, order, axis=0)
    remaining = np.arange(len(p_values), 0, -1).reshape(-1, *[1] * (p_values.ndim - 1))
    stepped = np.minimum(1.0, np.maximum.accumulate(ordered * remaining, axis=0))
    corrected = np.empty_like(stepped)
    np.put_along_axis(corrected, order, stepped, axis=0)
    return corrected


def _by_cluster(values: FloatArray, cluster: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the sums of each cluster's values, (n_clusters, n_metrics), and their sizes."""
    _, row = np.unique(cluster, return_inverse=True)
    sums: FloatArray = np.column_stack([np.bincount(row, weights=column) for column in values.T])
    sizes: FloatArray = np.bincount(row).astype(np.float64)
    return sums, sizes


def _parts(resamples: int) -> Iterator[slice]:
    """Split the resamples into parts that fit into memory."""
    for start in range(0, resamples, _AT_ONCE):
        yield slice(start, min(start + _AT_ONCE, resamples))
