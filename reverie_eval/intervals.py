"""Confidence intervals of a submission's scores."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, Self, get_args

import numpy as np

from reverie_eval.arrays import Array, IntArray
from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.wording import counted

Clustering = Literal["target", "scan"]
"""What episodes have in common that are not independent: the target object, or the building."""

FEW_CLUSTERS = 5
"""Intervals drawn from fewer hold the truth less often than they say: docs/uncertainty.md."""

_LEAST_CLUSTERS = 2


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval, in the unit of its metric."""

    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Intervals(Mapping[str, Interval]):
    """An interval for every metric, by its key, and how they came about."""

    by: Clustering
    n_clusters: int
    confidence: float
    resamples: int
    seed: int
    _by_key: Mapping[str, Interval] = field(repr=False)

    @classmethod
    def of(
        cls,
        episodes: Mapping[str, Array],
        truth: GroundTruth,
        by: Clustering = "target",
        *,
        confidence: float | None = None,
        resamples: int | None = None,
        seed: int | None = None,
    ) -> Self:
        """Draw clusters of episodes again and again; what is not given is the default.

        Raises
        ------
        ProtocolError
            If there is no such clustering, all episodes are of one cluster, or confidence,
            resamples or seed make no sense.
        """
        from reverie_eval.metrics import uncertainty

        obstacle = cls.obstacle(truth, by)
        if obstacle:
            raise ProtocolError(obstacle)
        cluster = clusters_of(truth, by)
        n_clusters = len(np.unique(cluster))
        confidence = uncertainty.CONFIDENCE if confidence is None else confidence
        resamples = uncertainty.RESAMPLES if resamples is None else resamples
        seed = uncertainty.SEED if seed is None else seed
        _demand_drawable(confidence, resamples, seed)
        values = np.column_stack(list(episodes.values()))
        means = uncertainty.bootstrap_means(values, cluster, resamples=resamples, seed=seed)
        low, high = uncertainty.interval(means, n_clusters, confidence=confidence).tolist()
        by_key = dict(zip(episodes, map(Interval, low, high), strict=True))
        return cls(by, n_clusters, confidence, resamples, seed, by_key)

    @staticmethod
    def obstacle(truth: GroundTruth, by: Clustering) -> str | None:
        """Say what keeps intervals from being drawn, if anything does."""
        if len(np.unique(clusters_of(truth, by))) < _LEAST_CLUSTERS:
            return f"all episodes are of one {by}, which tells nothing of others"
        return None

    def __getitem__(self, key: str) -> Interval:
        return self._by_key[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_key)

    def __len__(self) -> int:
        return len(self._by_key)

    @property
    def label(self) -> str:
        """The confidence as people write it: ``95 %``."""
        return f"{100 * self.confidence:g} %"

    @property
    def caption(self) -> str:
        """How the intervals came about, for whoever wants to repeat them, and how far they hold."""
        drawn = (
            f"{self.label} intervals: {self.resamples:,} bootstrap resamples of "
            f"{self._clusters}, seed {self.seed}"
        )
        return "; ".join(filter(None, [drawn, self.caution]))

    @property
    def caution(self) -> str:
        """What is to be said where the clusters are few; else empty."""
        if self.n_clusters >= FEW_CLUSTERS:
            return ""
        holds = f"such an interval holds the truth less often than {self.label} says"
        return f"only {self._clusters}: {holds}"

    @property
    def _clusters(self) -> str:
        return counted(self.n_clusters, self.by)


def clusters_of(truth: GroundTruth, by: Clustering) -> IntArray:
    """Give every cluster a number, and return the one that each episode is in.

    By target, the up to three instructions of a task are together, and so are tasks that lead to
    the same object on different paths.

    Returns
    -------
    array of int, shape (n_episodes,)

    Raises
    ------
    ProtocolError
        If there is no such clustering.
    """
    if by not in get_args(Clustering):
        known = ", ".join(get_args(Clustering))
        raise ProtocolError(f"episodes are not clustered by {by!r}; choose one of: {known}")
    scan = truth.graph.viewpoint_scan[truth.episodes.start].astype(np.int64)
    return scan if by == "scan" else (scan << 32) | truth.secret.target_object


def _demand_drawable(confidence: float, resamples: int, seed: int) -> None:
    if not 0 < confidence < 1 or resamples < 1 or seed < 0:
        raise ProtocolError(
            f"confidence {confidence}, {resamples} resamples, seed {seed}; expected a confidence "
            "between 0 and 1, one resample or more, and no negative seed"
        )
