"""Confidence intervals of a submission's scores."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, Self, get_args

import numpy as np

from reverie_eval.arrays import Array, IntArray, with_object
from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.text import count_text, did_you_mean

Clustering = Literal["target", "scan"]
"""What dependent episodes share: the target, or the building. The target is the object; in a task
without target objects, the goal region, or else the end of the path."""

FEW_CLUSTERS = 5
"""With fewer clusters, intervals contain the true mean less often than they claim; measured in
docs/explanation/uncertainty.md."""

_MIN_CLUSTERS = 2
_TABLES_AT_ONCE = 50
"""Resamples of so many tables, with all metrics, take 60 MB."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval, in the unit of its metric."""

    low: float
    high: float


@dataclass(frozen=True, eq=False)
class ClusterIntervals(Mapping[str, Interval]):
    """The interval of every metric by its key, over clusters of episodes."""

    cluster: Clustering
    n_clusters: int
    confidence: float
    _by_key: Mapping[str, Interval] = field(repr=False)

    def __getitem__(self, key: str) -> Interval:
        return self._by_key[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_key)

    def __len__(self) -> int:
        return len(self._by_key)

    @property
    def label(self) -> str:
        """The confidence for people: ``95 %``."""
        return f"{100 * self.confidence:g} %"

    @property
    @abstractmethod
    def method(self) -> str:
        """How the intervals were computed, so that they can be reproduced."""

    @property
    def caption(self) -> str:
        """How the intervals were computed, and any caution."""
        return "; ".join(filter(None, [self.method, self.caution]))

    @property
    def caution(self) -> str:
        """A caution if there are few clusters; else empty."""
        if self.n_clusters >= FEW_CLUSTERS:
            return ""
        return (
            f"only {self.clusters_text}: such intervals contain the true mean less often than "
            f"{self.label} of the time"
        )

    @property
    def clusters_text(self) -> str:
        """The number of clusters with their kind: ``513 targets``."""
        return count_text(self.n_clusters, self.cluster)


@dataclass(frozen=True, eq=False)
class Intervals(ClusterIntervals):
    """The interval of every metric by its key, by a bootstrap, and how it was computed."""

    resamples: int
    seed: int

    @classmethod
    def of_several(
        cls,
        tables: Mapping[str, Mapping[str, Array]],
        cluster: IntArray,
        clustering: Clustering,
        *,
        confidence: float | None = None,
        resamples: int | None = None,
        seed: int | None = None,
    ) -> Mapping[str, Self]:
        """Compute the intervals of several tables from the same resamples of clusters of episodes.

        Parameters
        ----------
        tables : mapping of mappings of arrays of shape (n_episodes,)
            Episode tables of the same episodes, by name.
        cluster : array of int, shape (n_episodes,)
            As :func:`clusters_of` returns it.
        clustering : "target" or "scan"
            What the episodes of a cluster share.
        confidence, resamples, seed : optional
            Settings of the bootstrap; the defaults are in :mod:`reverie_eval.metrics.uncertainty`.

        Raises
        ------
        ProtocolError
            If all episodes are in one cluster, or confidence, resamples or seed are out of range.
        """
        # Importing scipy would double the start-up time of commands that show no intervals.
        from reverie_eval.metrics import uncertainty

        n_clusters = len(np.unique(cluster))
        if n_clusters < _MIN_CLUSTERS:
            raise ProtocolError(_one_cluster(clustering))
        # The defaults cannot be in the signature: their module imports scipy.
        confidence = uncertainty.CONFIDENCE if confidence is None else confidence
        resamples = uncertainty.RESAMPLES if resamples is None else resamples
        seed = uncertainty.SEED if seed is None else seed
        if not 0 < confidence < 1 or resamples < 1 or seed < 0:
            raise ProtocolError(
                f"confidence {confidence}, {resamples} resamples, seed {seed}; expected a "
                "confidence between 0 and 1, at least one resample, and a seed of 0 or more"
            )
        found: dict[str, Self] = {}
        for start in range(0, len(tables), _TABLES_AT_ONCE):
            names = list(tables)[start : start + _TABLES_AT_ONCE]
            columns = [column for name in names for column in tables[name].values()]
            means = uncertainty.bootstrap_means(
                np.column_stack(columns), cluster, resamples=resamples, seed=seed
            )
            low, high = uncertainty.interval(means, n_clusters, confidence=confidence).tolist()
            ends = map(Interval, low, high)
            for name in names:
                by_key = {key: next(ends) for key in tables[name]}
                found[name] = cls(clustering, n_clusters, confidence, by_key, resamples, seed)
        return found

    @staticmethod
    def why_not(truth: GroundTruth, cluster: Clustering) -> str | None:
        """Return why intervals cannot be computed; None if they can."""
        n_clusters = len(np.unique(clusters_of(truth, cluster)))
        return _one_cluster(cluster) if n_clusters < _MIN_CLUSTERS else None

    @property
    def method(self) -> str:
        """How the intervals were computed, so that they can be reproduced."""
        return (
            f"{self.label} intervals: {self.resamples:,} bootstrap resamples of "
            f"{self.clusters_text}, seed {self.seed}"
        )


def clusters_of(truth: GroundTruth, cluster: Clustering) -> IntArray:
    """Return the cluster of each episode.

    By target, all instructions of a path are in one cluster, and so are all paths to the same
    object or, in a task without target objects, to the same region or viewpoint.

    Returns
    -------
    array of int, shape (n_episodes,)
        Equal numbers mean the same cluster.

    Raises
    ------
    ProtocolError
        If there is no such clustering.
    """
    if cluster not in get_args(Clustering):
        known = did_you_mean(cluster, get_args(Clustering))
        raise ProtocolError(f"cannot cluster episodes by {cluster!r}{known}")
    scan = truth.graph.viewpoint_scan[truth.episodes.start]
    if cluster == "scan":
        return scan
    answers = truth.require_answers()
    if truth.task.has_targets:
        return with_object(scan, answers.target_object)
    has_regions = answers.goal_viewpoint is not None
    return answers.goal_region[truth.episodes.task] if has_regions else answers.goal


def _one_cluster(cluster: Clustering) -> str:
    return f"all episodes share one {cluster}, so there is nothing to resample"
