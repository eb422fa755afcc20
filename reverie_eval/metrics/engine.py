"""The engine of intervals: one confidence level, number of resamples and seed for all of them.

Means of one file and differences between files are resampled over clusters of episodes; means over
several runs have a variance by formula. Both come back within the bounds of their metric.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import ROUNDING, BoolArray, FloatArray, IntArray
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics.runs import CrossedMeans
from reverie_eval.metrics.uncertainty import (
    CONFIDENCE,
    RESAMPLES,
    SEED,
    bootstrap_means,
    interval,
)

FEWEST_CLUSTERS = 10
"""If fewer clusters have something other than the worst possible value, or the best, percentiles of
resamples are too narrow: measured in docs/explanation/uncertainty.md."""


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
    """In (0, 1): the share of intervals that contain the truth."""
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
    order = np.argsort(cluster, kind="stable")
    _, first = np.unique(cluster[order], return_index=True)
    counts = []
    for bound in bounds:
        differs = (np.abs(values - bound) > ROUNDING)[order]
        counts.append(np.logical_or.reduceat(differs, first, axis=0).sum(axis=0))
    return np.asarray(np.minimum(*counts))
