"""Confidence intervals of a submission's scores."""

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from operator import attrgetter
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import Array, FloatArray, IntArray, with_object
from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.text import count_text, did_you_mean

if TYPE_CHECKING:
    from reverie_eval.metrics.engine import IntervalEngine
    from reverie_eval.schemas.report import IntervalReport

Clustering = Literal["target", "scan"]
"""What dependent episodes share: the target, or the building. The target is the object; in a task
without target objects, the goal region, or else the end of the path."""

FEW_CLUSTERS = 5
"""Fewer clusters do not show how much clusters differ: intervals are much wider than with these, as
docs/explanation/uncertainty.md measures."""

_MIN_CLUSTERS = 2
# Resamples of so many tables, with all metrics, take 60 MB.
_TABLES_AT_ONCE = 50


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval, in the unit of its metric."""

    low: float
    high: float

    @property
    def reversed(self) -> "Interval":
        """The interval of the same difference with the other sign."""
        return Interval(-self.high, -self.low)


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
    def procedure(self) -> str:
        """How the intervals were computed, so that they can be reproduced."""

    @property
    def caption(self) -> str:
        """How the intervals were computed, and any caution."""
        return "; ".join(filter(None, [self.procedure, self.caution]))

    @property
    def caution(self) -> str:
        """A caution if there are few clusters; else empty."""
        if self.n_clusters >= FEW_CLUSTERS:
            return ""
        return (
            f"only {self.clusters_text}: too few to show how much {self.cluster}s differ, so these "
            "intervals are very wide"
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
    with_score_intervals: Collection[str] = ()
    """The metrics whose intervals are score intervals, because few clusters are informative."""

    @classmethod
    def of_several(
        cls,
        tables: Mapping[str, Mapping[str, Array]],
        cluster: IntArray,
        clustering: Clustering,
        engine: "IntervalEngine",
        bounds: Callable[[Metric], tuple[float, float]] = attrgetter("bounds"),
    ) -> Mapping[str, Self]:
        """Compute the intervals of several tables from the same resamples of clusters of episodes.

        Parameters
        ----------
        tables : mapping of mappings of arrays of shape (n_episodes,)
            By name, values of the same episodes by metric.
        cluster : array of int, shape (n_episodes,)
            As :func:`clusters_of` returns it.
        clustering : "target" or "scan"
            What the episodes of a cluster share.
        engine : IntervalEngine
        bounds : callable
            Returns the bounds of a metric's values in the tables.

        Raises
        ------
        ProtocolError
            If all episodes are in one cluster.
        """
        n_clusters = len(np.unique(cluster))
        if n_clusters < _MIN_CLUSTERS:
            raise ProtocolError(_one_cluster(clustering))
        found: dict[str, Self] = {}
        for start in range(0, len(tables), _TABLES_AT_ONCE):
            names = list(tables)[start : start + _TABLES_AT_ONCE]
            # All tables side by side, so that each resample of the clusters is drawn once for all
            # of them.
            keys = [key for name in names for key in tables[name]]
            table = np.column_stack([each for name in names for each in tables[name].values()])
            ends, is_scored = engine.of_means(table, cluster, bounds_of(keys, bounds))
            # An iterator, of which each table takes as many as it has metrics.
            rows = zip(keys, map(Interval, *ends.tolist()), is_scored.tolist(), strict=True)
            for name in names:
                of_table = list(islice(rows, len(tables[name])))
                found[name] = cls(
                    clustering,
                    n_clusters,
                    engine.confidence,
                    {key: interval for key, interval, _ in of_table},
                    engine.resamples,
                    engine.seed,
                    [key for key, _, is_score in of_table if is_score],
                )
        return found

    @staticmethod
    def why_not(truth: GroundTruth, cluster: Clustering) -> str | None:
        """Return why intervals cannot be computed; None if they can."""
        n_clusters = len(np.unique(clusters_of(truth, cluster)))
        return _one_cluster(cluster) if n_clusters < _MIN_CLUSTERS else None

    @classmethod
    def check_possible(cls, truth: GroundTruth, cluster: Clustering) -> None:
        """Raise ProtocolError if intervals cannot be computed."""
        if reason := cls.why_not(truth, cluster):
            raise ProtocolError(reason)

    @property
    def procedure(self) -> str:
        """How the intervals were computed, so that they can be reproduced."""
        # Then no interval is from resamples, so neither their number nor the seed matters.
        if self and len(self.with_score_intervals) == len(self):
            return f"{self.label} intervals: score method, over {self.clusters_text}"
        drawn = (
            f"{self.label} intervals: {self.resamples:,} bootstrap resamples of "
            f"{self.clusters_text}, seed {self.seed}"
        )
        rare = f"; score method where few {self.cluster}s succeed or few fail"
        return drawn + rare * bool(self.with_score_intervals)

    def to_report(self) -> "IntervalReport":
        """Return what the score report says of the intervals."""
        from reverie_eval.schemas.report import IntervalReport

        return IntervalReport(
            by=self.cluster,
            clusters=self.n_clusters,
            confidence=self.confidence,
            resamples=self.resamples,
            seed=self.seed,
            intervals={key: (interval.low, interval.high) for key, interval in self.items()},
        )


def bounds_of(keys: Iterable[str], bounds: Callable[[Metric], tuple[float, float]]) -> FloatArray:
    """Return the bounds of metrics, shape (2, n_metrics)."""
    return np.array([bounds(CATALOGUE[key]) for key in keys]).reshape(-1, 2).T


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
    solution = truth.require_solution()
    if truth.task.has_targets:
        # Object ids are unique within a scan only.
        return with_object(scan, solution.target_object)
    has_regions = solution.goal_viewpoint is not None
    return solution.goal_region[truth.episodes.item] if has_regions else solution.goal


def _one_cluster(cluster: Clustering) -> str:
    return f"all episodes share one {cluster}, so there is nothing to resample"
