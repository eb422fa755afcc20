"""Uncertainty of a method's mean over several runs, such as trainings with other seeds.

Runs and clusters of episodes are both drawn at random, and every run answers all episodes: two
crossed random factors. Studies in which several readers judge the same cases have the same design
[1]_, and the degrees of freedom are theirs [2]_.

References
----------
.. [1] Obuchowski and Rockette, "Hypothesis testing of diagnostic accuracy for multiple readers and
   multiple tests", Communications in Statistics - Simulation and Computation 24(2), 1995.
.. [2] Hillis, "A comparison of denominator degrees of freedom methods for multiple observer ROC
   analysis", Statistics in Medicine 26(3), 2007; Satterthwaite, "An approximate distribution of
   estimates of variance components", Biometrics Bulletin 2(6), 1946.
.. [3] MacKinnon, Nielsen and Webb, "Leverage, influence, and the jackknife in clustered regression
   models", The Stata Journal 23(4), 2023.
.. [4] Carter, Schnepel and Steigerwald, "Asymptotic behavior of a t-test robust to cluster
   heterogeneity", Review of Economics and Statistics 99(4), 2017: the effective number of clusters.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import stdtr, stdtrit

from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.metrics.uncertainty import CONFIDENCE


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
    def of(cls, values: FloatArray, cluster: IntArray) -> Self:
        """Summarise the runs of a method.

        For a single run, the mean has no variance due to the choice of runs.

        Parameters
        ----------
        values : array, shape (n_runs, n_episodes, n_metrics)
        cluster : array of int, shape (n_episodes,)
            Equal numbers mean the same cluster.
        """
        n_runs, n_episodes, n_metrics = values.shape
        _, row, size = np.unique(cluster, return_inverse=True, return_counts=True)
        by_run = values.mean(axis=1)
        deviation = np.zeros((n_runs, len(size), n_metrics))
        others = (n_episodes - size)[row, None]
        for run in range(n_runs):
            np.add.at(deviation[run], row, (values[run] - by_run[run]) / others)
        freedom = max(n_runs - 1, 1)
        common = deviation.mean(axis=0)
        differing = ((deviation - common) ** 2).sum(axis=(0, 1)) / freedom
        return cls(
            mean=by_run.mean(axis=0),
            run_variance=((by_run - by_run.mean(axis=0)) ** 2).sum(axis=0)[None] / freedom / n_runs,
            run_freedom=np.array([[float(freedom)]]),
            deviation=common,
            cluster_freedom=float(n_episodes**2 / (size**2).sum() - 1),
            noise=differing * _jackknife(len(size)) / n_runs,
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
        return _divide(self.run_variance.sum(axis=0), self.variance)

    @property
    def freedom(self) -> FloatArray:
        """Shape (n_metrics,): Satterthwaite's degrees of freedom of the variance."""
        squares = (self.run_variance**2 / self.run_freedom).sum(axis=0)
        squares += self.cluster_variance**2 / self.cluster_freedom
        return np.maximum(_divide(self.variance**2, squares), 1.0)

    def interval(self, confidence: float = CONFIDENCE) -> FloatArray:
        """Return the low and high ends of a confidence interval, shape (2, n_metrics)."""
        t = stdtrit(self.freedom, (1 + confidence) / 2)
        half = t * np.sqrt(self.variance)
        return np.stack([self.mean - half, self.mean + half])

    @property
    def p_value(self) -> FloatArray:
        """Shape (n_metrics,): two-sided p-values of Student's t test that the mean is 0."""
        t = np.abs(_divide(self.mean, np.sqrt(self.variance)))
        return np.asarray(2 * stdtr(self.freedom, -t))


def _jackknife(n_clusters: int) -> float:
    """Return what the jackknife multiplies the sum of squares with."""
    return (n_clusters - 1) / n_clusters


def _divide(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Divide, with 0 where there is no variance at all."""
    out = np.zeros_like(denominator)
    return np.divide(numerator, denominator, out=out, where=denominator > 0)
