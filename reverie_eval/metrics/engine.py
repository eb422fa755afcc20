"""Intervals of means: one confidence level, number of resamples and seed for all of them.

Means of one file and differences between files are resampled over clusters of episodes; means over
several runs have a variance by formula. Both come back within the bounds of their metric.

Of several runs of a method, such as trainings with other seeds, runs and clusters of episodes are
both drawn at random, and every run answers all episodes: two crossed random factors. Studies in
which several readers judge the same cases have the same design [1]_. Runs are few, so the critical
value lies between those of Student's t for the runs and for the clusters [2]_.

References
----------
.. [1] Obuchowski and Rockette, "Hypothesis testing of diagnostic accuracy for multiple readers and
   multiple tests", Communications in Statistics - Simulation and Computation 24(2), 1995.
.. [2] Cochran and Cox, "Experimental Designs", 2nd edition, Wiley 1957, section 4.14: the critical
   values of variances that are estimated with different degrees of freedom, weighted by these
   variances; Satterthwaite, "An approximate distribution of estimates of variance components",
   Biometrics Bulletin 2(6), 1946.
.. [3] MacKinnon, Nielsen and Webb, "Leverage, influence, and the jackknife in clustered regression
   models", The Stata Journal 23(4), 2023.
.. [4] Carter, Schnepel and Steigerwald, "Asymptotic behavior of a t-test robust to cluster
   heterogeneity", Review of Economics and Statistics 99(4), 2017: the effective number of clusters.
.. [5] Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22(158),
   1927; with the effective sample size of clustered episodes, Dean and Pagano, "Evaluating
   confidence interval methods for binomial proportions in clustered surveys", Journal of Survey
   Statistics and Methodology 3(4), 2015.
.. [6] Clopper and Pearson, "The use of confidence or fiducial limits illustrated in the case of the
   binomial", Biometrika 26(4), 1934.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import ROUNDING, BoolArray, FloatArray, IntArray
from reverie_eval.errors import ProtocolError, naming_missing_parts
from reverie_eval.metrics.uncertainty import (
    CONFIDENCE,
    RESAMPLES,
    SEED,
    bootstrap_means,
    cluster_sums,
    interval,
)

with naming_missing_parts():
    from scipy.special import stdtrit

FEWEST_CLUSTERS = 10
"""How many clusters must have something other than the worst possible value, and the best: with
fewer, percentiles of resamples are too narrow: measured in docs/explanation/uncertainty.md."""


class MeanIntervals(NamedTuple):
    """Intervals of means, a column per metric."""

    ends: FloatArray
    """Shape (2, n_metrics): low and high."""
    is_scored: BoolArray
    """Shape (n_metrics,): whether few clusters are informative, so that the score interval replaces
    the percentiles."""


@dataclass(frozen=True)
class IntervalEngine:
    """How all intervals are computed.

    Raises
    ------
    ProtocolError
        If confidence, resamples or seed are out of range.
    """

    confidence: float = CONFIDENCE
    """The share of intervals that contain the truth, in (0, 1)."""
    resamples: int = RESAMPLES
    seed: int = SEED

    def __post_init__(self) -> None:
        if not 0 < self.confidence < 1 or self.resamples < 1 or self.seed < 0:
            raise ProtocolError(
                f"confidence {self.confidence}, {self.resamples} resamples, seed {self.seed}; "
                "expected a confidence between 0 and 1, at least one resample, and a seed of 0 or "
                "more"
            )

    @classmethod
    def of(
        cls,
        confidence: float | None = None,
        resamples: int | None = None,
        seed: int | None = None,
    ) -> "IntervalEngine":
        """Return an engine with the defaults where nothing is given."""
        return cls(
            CONFIDENCE if confidence is None else confidence,
            RESAMPLES if resamples is None else resamples,
            SEED if seed is None else seed,
        )

    def of_means(self, values: FloatArray, cluster: IntArray, bounds: FloatArray) -> MeanIntervals:
        """Return the intervals of means over clustered episodes.

        These are percentiles of resamples, which cannot leave the bounds. Where fewer than
        ``FEWEST_CLUSTERS`` clusters differ from a bound, as when hardly any episode succeeds, or
        where all clusters have the same mean, they are those of a single run of
        :class:`CrossedMeans`.

        Parameters
        ----------
        values : array, shape (n_episodes, n_metrics)
        cluster : array of int, shape (n_episodes,)
            Equal numbers mean the same cluster; there are at least two.
        bounds : array, shape (2, n_metrics)
            The smallest and the largest possible value of each metric.
        """
        means = CrossedMeans.of(values[None], cluster)
        is_scored = _informative(values, cluster, bounds) < FEWEST_CLUSTERS
        is_scored |= means.is_constant
        resampled = bootstrap_means(values, cluster, resamples=self.resamples, seed=self.seed)
        percentiles = interval(resampled, len(means.deviation), confidence=self.confidence)
        scored = means.interval(bounds, self.confidence)
        return MeanIntervals(np.where(is_scored, scored, percentiles), is_scored)


def _informative(values: FloatArray, cluster: IntArray, bounds: FloatArray) -> IntArray:
    """Count the clusters that are not all at the low bound, or at the high one if these are fewer.

    For a rate, these are the clusters in which something succeeds, or in which something fails.
    """
    # reduceat needs the episodes of a cluster side by side.
    order = np.argsort(cluster, kind="stable")
    _, first = np.unique(cluster[order], return_index=True)
    counts = []
    for bound in bounds:
        differs = (np.abs(values - bound) > ROUNDING)[order]
        counts.append(np.logical_or.reduceat(differs, first, axis=0).sum(axis=0))
    return np.asarray(np.minimum(*counts))


# The critical value of runs has the weight of their share of the variance, to this power. Cochran
# and Cox have 1; then up to 98 % of 95 % intervals over two runs contain the truth, and up to 97 %
# with this power. Measured by benchmarks/runs.py.
_SHARE_POWER = 1.35
# Enough to find the logarithm of any p-value that a float holds to its last digits.
_BISECTIONS = 60
# With smaller tails, SciPy's quantiles of some degrees of freedom are infinite, and negative.
_SMALLEST_TAIL = 1e-200


@dataclass(frozen=True)
class CrossedMeans:
    """Means over runs and episodes, and where their variance comes from; one for each metric."""

    mean: FloatArray
    """Shape (n_metrics,)."""
    run_variance: FloatArray
    """Shape (n_methods, n_metrics): the part of the mean's variance that is due to the choice of
    each method's runs."""
    run_freedom: FloatArray
    """Shape (n_methods, 1): degrees of freedom of these parts, the number of runs less one."""
    deviation: FloatArray
    """Shape (n_clusters, n_metrics): how much the mean of all runs would fall if a cluster were
    left out, for the jackknife [3]_."""
    cluster_freedom: float
    """Degrees of freedom of the clusters: their effective number [4]_ less one."""
    noise: FloatArray
    """Shape (n_metrics,): what ``run_variance`` and ``deviation`` both count, because runs differ
    by cluster: a part of ``run_variance``."""

    @classmethod
    def of(cls, values: FloatArray, cluster: IntArray, weight: FloatArray | None = None) -> Self:
        """Summarise the runs of a method.

        For a single run, the mean has no variance due to the choice of runs.

        Parameters
        ----------
        values : array, shape (n_runs, n_episodes, n_metrics)
        cluster : array of int, shape (n_episodes,)
            Equal numbers mean the same cluster.
        weight : array, shape (n_runs,), optional
            The weight of each run in the mean; by default all weigh the same.
        """
        weight = np.full(len(values), 1 / len(values)) if weight is None else weight
        sums, size = zip(*(cluster_sums(run, cluster) for run in values), strict=True)
        by_run = values.mean(axis=1)
        n_episodes, sizes = values.shape[1], size[0][:, None]
        deviation = np.stack(sums) - sizes * by_run[:, None]
        # What the mean would lose without the cluster: clusters differ in size, so its share of the
        # others counts.
        deviation /= n_episodes - sizes
        mean = weight @ by_run
        common = np.tensordot(weight, deviation, axes=1)
        # A single run has no variance between runs, whatever it is divided by; 0 would make it NaN.
        freedom = max(len(values) - 1, 1)
        # For equal weights this is 1 / (n (n - 1)), as in the variance of a mean of n runs.
        squares = (weight**2).sum() / freedom
        differing = ((deviation - deviation.mean(axis=0)) ** 2).sum(axis=(0, 1))
        return cls(
            mean=mean,
            run_variance=((by_run - by_run.mean(axis=0)) ** 2).sum(axis=0)[None] * squares,
            run_freedom=np.array([[float(freedom)]]),
            deviation=common,
            cluster_freedom=float(n_episodes**2 / (sizes**2).sum() - 1),
            noise=differing * _jackknife(len(sizes)) * squares,
        )

    def minus(self, other: Self) -> Self:
        """Return the difference of two methods on the same episodes; runs are not paired."""
        return type(self)(
            mean=self.mean - other.mean,
            run_variance=np.concatenate([self.run_variance, other.run_variance]),
            run_freedom=np.concatenate([self.run_freedom, other.run_freedom]),
            deviation=self.deviation - other.deviation,
            cluster_freedom=self.cluster_freedom,
            noise=self.noise + other.noise,
        )

    @property
    def cluster_variance(self) -> FloatArray:
        """Shape (n_metrics,): the part of the variance that is due to the choice of clusters.

        Never negative, though the estimate of a small one may be.
        """
        observed = (self.deviation**2).sum(axis=0) * _jackknife(len(self.deviation))
        return np.asarray(np.maximum(observed - self.noise, 0.0))

    @property
    def variance(self) -> FloatArray:
        """Shape (n_metrics,): the variance of the mean."""
        return np.asarray(self.run_variance.sum(axis=0) + self.cluster_variance)

    @property
    def run_share(self) -> FloatArray:
        """Shape (n_metrics,): the part of the variance that more runs would reduce, in [0, 1]."""
        return divide(self.run_variance.sum(axis=0), self.variance)

    @property
    def is_constant(self) -> BoolArray:
        """Shape (n_metrics,): whether all runs and clusters have the same mean, up to rounding."""
        return np.asarray(self.variance <= (ROUNDING * np.maximum(1, np.abs(self.mean))) ** 2)

    def critical(self, tail: float | FloatArray) -> FloatArray:
        """Return beyond how many standard errors a tail of the mean's distribution lies.

        Parameters
        ----------
        tail : float, or array of shape (n_metrics,)
            Its probability, on one side: 0.025 for a 95 % interval.

        Returns
        -------
        array, shape (n_metrics,)
        """
        # Satterthwaite's degrees of freedom of the runs of both methods together.
        freedom = divide(
            self.run_variance.sum(axis=0) ** 2,
            (self.run_variance**2 / self.run_freedom).sum(axis=0),
        )
        of_clusters = -stdtrit(max(self.cluster_freedom, 1.0), tail)
        # Without variance between runs, their freedom comes out as 0; so does their share, and any
        # number will do.
        of_runs = -stdtrit(np.maximum(freedom, 1.0), tail)
        share = self.run_share**_SHARE_POWER
        return np.asarray(of_clusters + share * (of_runs - of_clusters))

    def interval(self, bounds: FloatArray, confidence: float | FloatArray) -> FloatArray:
        """Return the low and high ends of a confidence interval, shape (2, n_metrics).

        The score interval [5]_: it has the means that the observed one does not contradict, if a
        mean varies less the closer it is to a bound, as rates do. So no end is beyond a bound.

        If all clusters have the same mean, their variance says nothing. Then it is the exact
        interval [6]_ of the share of clusters that have another mean, each as far away as possible.
        Only a difference of 0 stays: methods that never differ mostly share what is measured.

        Parameters
        ----------
        bounds : array, shape (2, n_metrics)
            The smallest and the largest possible value of each metric; infinite if there is none.
        confidence : float, or array of shape (n_metrics,)
            In (0, 1).
        """
        half = self.critical((1 - confidence) / 2) * np.sqrt(self.variance)
        ends = score_interval(self.mean, half, bounds)
        # The rule of three in its exact form: of n clusters that all agree, up to this share may
        # not.
        unseen = 1 - ((1 - confidence) / 2) ** (1 / (self.cluster_freedom + 1))
        is_same = (np.abs(self.mean) <= ROUNDING) & (bounds[0] < 0)
        room = np.where(np.isfinite(bounds) & ~is_same, bounds - self.mean, 0.0)
        ends = np.where(self.is_constant, self.mean + unseen * room, ends)
        # Only rounding can be beyond.
        return np.asarray(np.clip(ends, *bounds))

    def p_value(self, bounds: FloatArray) -> FloatArray:
        """Return two-sided p-values of the test that the mean is 0, shape (n_metrics,).

        It is below 0.05 if and only if the 95 % interval does not contain 0.

        Parameters
        ----------
        bounds : array, shape (2, n_metrics)
            Of differences: a number and its negative.
        """
        size = np.abs(self.mean)
        relative: FloatArray = size / bounds[1]
        # By the score interval, a difference of 0 varies more than a large one.
        wider = divide(np.ones_like(size), 1 - relative**2)
        observed = divide(size, np.sqrt(self.variance * wider))
        # A weighted sum of quantiles has no inverse by formula: search the logarithm.
        # Its logarithm, because p-values of large differences are far below what a search in steps
        # of p finds.
        low, high = np.full_like(size, np.log(np.finfo(np.float64).tiny)), np.zeros_like(size)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            tail = np.maximum(np.exp(middle) / 2, _SMALLEST_TAIL)
            is_below = self.critical(tail) > observed
            low, high = np.where(is_below, middle, low), np.where(is_below, high, middle)
        # Where the exact interval ends at 0.
        exact = np.minimum(1.0, 2 * (1 + relative) ** -(self.cluster_freedom + 1))
        return np.asarray(np.where(self.is_constant, exact, np.exp(high)))


def score_interval(mean: FloatArray, half: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return the ends of score intervals, shape (2, n_metrics).

    They are the means ``x`` with ``(x - mean)^2 = half^2 v(x) / v(mean)``, where the variance
    ``v(x)`` is proportional to the distances of ``x`` from the bounds: a quadratic equation. The
    distance from an infinite bound counts as constant.
    """
    has_low, has_high = np.isfinite(bounds)
    low, high = np.where(np.isfinite(bounds), bounds, 0.0)
    is_rate = has_low & has_high
    room = np.where(has_low, mean - low, 1.0) * np.where(has_high, high - mean, 1.0)
    excess = divide(half**2, room)
    middle = np.select([is_rate, has_low], [(low + high) / 2, 0.5], 0.0)
    reach = np.select([is_rate, has_low], [(high - low) / 2, 0.5], 0.0)
    scale = np.where(is_rate, 1 + excess, 1.0)
    centre = mean + excess * middle
    root = np.sqrt(half**2 + (excess * reach) ** 2)
    return np.stack([centre - root, centre + root]) / scale


def _jackknife(n_clusters: int) -> float:
    """Return what the jackknife multiplies the sum of squares with."""
    return (n_clusters - 1) / n_clusters


def divide(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Divide, with 0 where there is no variance at all."""
    out = np.zeros_like(denominator)
    return np.divide(numerator, denominator, out=out, where=denominator > 0)
