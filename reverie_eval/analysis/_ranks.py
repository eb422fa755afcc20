"""How certain ranks are: those that results may have, their groups, and the luck of the best.

These are the ranks of true means, over all episodes that a split might have had.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from reverie_eval.analysis._comparison import Comparison
from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.errors import naming_missing_parts
from reverie_eval.metrics import CATALOGUE
from reverie_eval.scoring import Clustering, Scored

# Degrees of freedom per cluster. Differences of two results have heavy tails, as they are 0 in most
# clusters: a variance estimated with a kurtosis of 5 is as certain as that of half as many normal
# values. Measured in docs/explanation/evidence.md.
_SHARE_OF_FREEDOM = 0.5


class Ranks(NamedTuple):
    """What is known of the ranks of results; arrays of shape (n_results,), in their order."""

    low: IntArray
    """The best rank that each may have, from 1."""
    high: IntArray
    """The worst."""
    group: IntArray
    """The number of each result's group, from 1. A group begins with the best result outside
    earlier groups, and includes all that follow until one is significantly worse than the group's
    first."""


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
    # What a cluster has beyond its share: clusters of other sizes have other sums at the same rate.
    residual = sums - np.outer(sizes, sums.sum(axis=0) / n_episodes)
    covariance: FloatArray = residual.T @ residual / n_episodes**2
    return covariance * n_clusters / (n_clusters - 1)


def rank_intervals(costs: FloatArray, covariance: FloatArray, n_clusters: float) -> Ranks:
    """Bound the rank of every result: all true ranks are within at once, at 95 % confidence.

    All pairwise differences are compared with one bound, the quantile of the largest of them in
    standard errors if all true means were equal. Pairs that differ by more are set apart, and the
    others are compared again with a smaller bound, that of the largest difference among them, until
    no more differ [1]_. The best rank of a result is one more than the number of those that are
    significantly better [2]_.

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
    .. [1] Romano and Wolf, "Exact and Approximate Stepdown Methods for Multiple Hypothesis
       Testing", JASA 100(469), 2005: the step-down max-t procedure.
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
    # An infinite error makes every difference 0, so equal results are never apart.
    error = np.where(is_same, np.inf, np.sqrt(np.maximum(squares, 0)))
    difference = (costs - costs[:, None]) / error
    drawn = _draw_errors(covariance)
    freedom = (n_clusters - 1) * _SHARE_OF_FREEDOM
    is_better: BoolArray = np.zeros(error.shape, dtype=bool)
    is_open = np.triu(~is_same, k=1)
    while is_open.any():
        found = np.abs(difference) > _bound(drawn, error, is_open, freedom)
        is_new = is_open & found
        if not is_new.any():
            break
        is_open &= ~is_new
        is_better |= (is_new | is_new.T) & (difference > 0)
    low, high = 1 + is_better.sum(axis=0), len(costs) - is_better.sum(axis=1)
    return Ranks(low, high, _groups(costs, is_better))


def covariance_of_rows(values: FloatArray, cluster: IntArray) -> FloatArray:
    """Estimate the covariance of the means of rows, without what all rows share.

    Most of it is estimated from clusters of episodes. The means of runs vary more than these
    explain, because trainings differ; as a few seeds cannot show how that part covaries, it counts
    as independent between rows, with its average variance over the rows.

    Parameters
    ----------
    values : array, shape (n_rows, n_runs, n_episodes)
    cluster : array of int, shape (n_episodes,)
        Equal numbers mean the same cluster, of which there are at least two.

    Returns
    -------
    array, shape (n_rows, n_rows)
    """
    from reverie_eval.metrics.uncertainty import cluster_sums

    values = values - values.mean(axis=0)
    n_rows, n_runs, _ = values.shape
    mean = values.mean(axis=1)
    covariance = covariance_of_means(*cluster_sums(mean.T, cluster))
    if n_runs == 1:
        return covariance
    rests = (cluster_sums((values[:, run] - mean).T, cluster) for run in range(n_runs))
    noise = sum(np.trace(covariance_of_means(*rest)) for rest in rests) / (n_runs - 1)
    of_runs = values.mean(axis=2).var(axis=1, ddof=1).sum()
    beyond = max(float(of_runs - noise), 0.0) / n_runs / n_rows
    return np.asarray(covariance + beyond * np.eye(n_rows))


def largest_error(covariance: FloatArray) -> float:
    """Return the expected largest of several normal errors with a mean of 0."""
    errors = _draw_errors(covariance)
    # The mean of all errors is 0 on average; without it, the same draws vary less.
    return float((errors.max(axis=0) - errors.mean(axis=0)).mean())


def _draw_errors(covariance: FloatArray) -> FloatArray:
    """Draw normal errors of all means together, shape (n_results, n_draws)."""
    from reverie_eval.metrics.uncertainty import RESAMPLES, SEED

    # Not Cholesky: the covariance of results that are sums of each other is singular.
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    rng = np.random.default_rng(SEED)
    return np.asarray(root @ rng.standard_normal((len(covariance), RESAMPLES)))


def _bound(drawn: FloatArray, error: FloatArray, is_open: BoolArray, freedom: float) -> float:
    """Return the quantile of the largest difference among open pairs, in standard errors.

    If all true means are equal. Estimated errors are allowed for as in the interval of a mean: the
    normal quantile is replaced by the t quantile of the same probability.
    """
    with naming_missing_parts():
        from scipy.special import ndtr, stdtrit

    from reverie_eval.metrics.uncertainty import CONFIDENCE

    largest = np.zeros(drawn.shape[1])
    for first, others in enumerate(is_open):
        if others.any():
            # Row by row: all pairs at once would take nearly a gigabyte for a hundred results.
            difference = drawn[others] - drawn[first]
            difference /= error[first, others, None]
            np.maximum(largest, np.abs(difference, out=difference).max(axis=0), out=largest)
    normal = float(np.quantile(largest, CONFIDENCE, method="higher"))
    return normal if np.isinf(freedom) else -float(stdtrit(freedom, float(ndtr(-normal))))


def _groups(costs: FloatArray, is_better: BoolArray) -> IntArray:
    group = np.empty(len(costs), dtype=np.int64)
    first, number = -1, 0
    for row in np.argsort(costs, kind="stable").tolist():
        if first < 0 or is_better[first, row]:
            first, number = row, number + 1
        group[row] = number
    return group


def leaders(
    scores: Mapping[str, Scored],
    keys: Iterable[str],
    cluster: Clustering = "target",
    *,
    confidence: float | None = None,
) -> Mapping[str, Sequence[str]]:
    """Return the best and the second best by each metric, as far as the data separate them.

    The best is named if it is significantly better than all others, and then the second if it is
    significantly better than all but the best. P-values are corrected for all pairs.

    Parameters
    ----------
    scores : mapping of Scores or Runs
        By name, of the same episodes under the same protocol.
    keys : iterable of str
        Metrics in which one direction is better. One that some scores lack is compared between
        the others.
    cluster : "target" or "scan"
        What dependent episodes share; there are at least two.
    confidence : float, optional
        In (0, 1); by default 0.95.

    Returns
    -------
    mapping of str to sequence of str
        By metric: no name, that of the best, or also that of the second of three or more.
    """
    values = {
        key: {name: each[key] for name, each in scores.items() if key in each} for key in keys
    }
    ranked = {
        key: sorted(each, key=each.__getitem__, reverse=CATALOGUE[key].better == "higher")
        for key, each in values.items()
    }
    found: dict[str, list[str]] = {key: [] for key in ranked}
    for rank in (0, 1):
        # Metrics with the same candidate are compared at once.
        asked: defaultdict[tuple[str, frozenset[str]], list[str]] = defaultdict(list)
        for key, names in ranked.items():
            if len(found[key]) == rank and len(names) > rank + 1:
                asked[names[rank], frozenset(names)].append(key)
        for (candidate, rivals), several in asked.items():
            compared = {
                name: replace(each, episodes={key: each.episodes[key] for key in several})
                for name, each in scores.items()
                if name in rivals
            }
            comparison = Comparison.of(
                compared, cluster, confidence=confidence, baseline=candidate, all_pairs=True
            )
            for key in several:
                worse = ranked[key][rank + 1 :]
                if all(comparison.is_significant(name, key) for name in worse):
                    found[key].append(candidate)
    return found
