"""How far a method is from a published mean, of which nothing but the number of episodes is known.

The mean was published without a value for each episode, so the two results cannot be paired. Each
has an interval of its own, and the interval of the difference has the distances to both [1]_.

Over ``n`` episodes of a split, the variance of a published rate ``p`` is
``s p (1 - p) (1 + r (m - 1)) / n``: ``r`` is the correlation of episodes with the same target,
``m`` the mean number of episodes that share an episode's target, and ``s`` how much less a metric
varies than one that is 0 or 1. The split says what ``m`` is; the results at hand say what ``r`` and
``s`` are.

Two differences can be meant. Beyond the split, on other episodes of the kind, both means vary.
*On the split itself*, only what was left out varies: a mean over ``n`` of its ``N`` episodes,
drawn at random, has ``1 - n / N`` of the variance, and a mean over all of it none. Which episodes
both drew does not matter there. Beyond the split it does: with ``c`` the covariance of the methods
in an episode, the variance falls by ``2 c / N`` if one of them has all episodes. As ``c`` is not
known, it counts as 0; results of methods that succeed in the same episodes are closer than that.

References
----------
.. [1] Newcombe, "Interval estimation for the difference between independent proportions: comparison
   of eleven methods", Statistics in Medicine 17(8), 1998, method 10; for other means and dependent
   episodes, Zou and Donner, "Construction of confidence limits about effect measures: a general
   approach", Statistics in Medicine 27(10), 2008.
"""

from dataclasses import dataclass

import numpy as np

from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.errors import naming_missing_parts
from reverie_eval.metrics.engine import CrossedMeans, divide, score_interval
from reverie_eval.metrics.uncertainty import cluster_sums

with naming_missing_parts():
    from scipy.special import stdtrit

_BISECTIONS = 50
# Smaller p-values are not told apart: `1 - p` would lose their digits.
_SMALLEST_P = 1e-12
# A published 0 or 100 % counts as so far within the bounds: there, rates would not vary at all.
_INSIDE = 1e-9


@dataclass(frozen=True)
class ResultSpread:
    """How results vary between the episodes of a split and within its targets, by metric."""

    variance: FloatArray
    """Shape (n_metrics,): of the values of episodes."""
    correlation: FloatArray
    """Shape (n_metrics,), in [0, 1]: of two episodes with the same target; 1 if there are none."""
    sizes: IntArray
    """Shape (n_clusters,): the number of the split's episodes with each target."""

    @classmethod
    def of(cls, values: FloatArray, cluster: IntArray, sizes: IntArray) -> "ResultSpread":
        """Estimate it.

        Parameters
        ----------
        values : array, shape (n_runs, n_episodes, n_metrics)
        cluster : array of int, shape (n_episodes,)
            Equal numbers mean the same target.
        sizes : array of int, shape (n_clusters,)
            Of the whole split.
        """
        rest = values - values.mean(axis=1, keepdims=True)
        squares = (rest**2).sum(axis=(0, 1))
        sums, counts = zip(*(cluster_sums(run, cluster) for run in rest), strict=True)
        pairs = len(values) * (counts[0] * (counts[0] - 1)).sum()
        products = (np.stack(sums) ** 2).sum(axis=(0, 1)) - squares
        variance = squares / rest[..., 0].size
        # Without two episodes of a target, nothing is known, and 1 is the most cautious.
        of_pairs = products / pairs if pairs else variance
        return cls(variance, np.clip(divide(of_pairs, variance), 0.0, 1.0), sizes)

    def others(self, n_episodes: int) -> float:
        """Return how many more episodes share a target, as a mean over a part of the split."""
        whole = int(self.sizes.sum())
        of_whole = float((self.sizes.astype(np.float64) ** 2).sum() / whole) - 1
        # A random part of the split has that part of the other episodes of each target.
        return of_whole * (n_episodes - 1) / max(whole - 1, 1)

    def independent(self, n_episodes: int) -> FloatArray:
        """Return how many independent episodes a part of the split is worth, shape (n_metrics,)."""
        return np.asarray(n_episodes / (1 + self.correlation * self.others(n_episodes)))

    def left_out(self, n_episodes: int) -> FloatArray:
        """Return which part of a mean's variance is due to the choice among the split's episodes.

        Shape (n_metrics,), in [0, 1].
        """
        whole = self.independent(int(self.sizes.sum()))
        return np.asarray(np.maximum(1 - self.independent(n_episodes) / whole, 0.0))


@dataclass(frozen=True)
class PublishedDifference:
    """The difference between the means of a method and published ones, a column per metric."""

    means: CrossedMeans
    """The means at hand."""
    published: FloatArray
    """Shape (n_metrics,)."""
    n_published: int
    """The number of episodes that the published means are over."""
    spread: ResultSpread
    bounds: FloatArray
    """Shape (2, n_metrics): the smallest and the largest possible value of each metric."""
    n_episodes: int | None = None
    """The number of episodes at hand, for differences on the split itself; None for those beyond
    it."""

    def interval(self, confidence: float | FloatArray) -> FloatArray:
        """Return the low and high ends of the difference, shape (2, n_metrics)."""
        own = self.means.mean - self.means.interval(self.bounds, confidence)
        theirs = self.published - self._published_interval(confidence)
        if self.n_episodes is not None:
            # What is due to the choice of runs stays.
            of_runs, left_out = self.means.run_share, self.spread.left_out(self.n_episodes)
            own = own * np.sqrt(of_runs + (1 - of_runs) * left_out)
            theirs = theirs * np.sqrt(self.spread.left_out(self.n_published))
        difference = self.means.mean - self.published
        below = np.hypot(own[0], theirs[1])
        above = np.hypot(own[1], theirs[0])
        return np.stack([difference - below, difference + above])

    def p_value(self) -> FloatArray:
        """Return two-sided p-values of the test that the difference is 0, shape (n_metrics,).

        It is below 0.05 if and only if the 95 % interval does not contain 0, and at least 1e-12.
        """
        low = np.full_like(self.published, np.log(_SMALLEST_P))
        high = np.zeros_like(self.published)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            ends = self.interval(1 - np.exp(middle))
            excludes = (ends[0] > 0) | (ends[1] < 0)
            low, high = np.where(excludes, low, middle), np.where(excludes, middle, high)
        return np.asarray(np.exp(high))

    def _published_interval(self, confidence: float | FloatArray) -> FloatArray:
        """Return score intervals of the published means, shape (2, n_metrics)."""
        is_rate = np.isfinite(self.bounds).all(axis=0)
        low, high = np.where(is_rate, self.bounds, 0.0)
        inside = np.clip(self.published, low + _INSIDE, high - _INSIDE)
        mean = np.where(is_rate, inside, self.published)
        # How much the metric varies, as a part of what one that is 0 or 1 would.
        most = (self.means.mean - low) * (high - self.means.mean)
        part = np.where(most > 0, divide(self.spread.variance, np.maximum(most, 0.0)), 1.0)
        variance = np.where(is_rate, part * (mean - low) * (high - mean), self.spread.variance)
        error = np.sqrt(variance / self.spread.independent(self.n_published))
        n_targets = self.n_published / (1 + self.spread.others(self.n_published))
        critical = -stdtrit(max(n_targets - 1, 1.0), (1 - confidence) / 2)
        half: FloatArray = np.asarray(critical * error, dtype=np.float64)
        return score_interval(mean, half, self.bounds)
