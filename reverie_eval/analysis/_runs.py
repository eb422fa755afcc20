"""Several runs of one method, such as trainings with different seeds: mean, interval, variance."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, cast

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import FloatArray, frozen
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE
from reverie_eval.scoring import (
    Clustering,
    ClusterIntervals,
    FailureModes,
    Interval,
    Intervals,
    Scored,
    Scores,
    bounds_of,
    check_same_signature,
    clusters_of,
    shared_keys,
)
from reverie_eval.submissions import check_names
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from reverie_eval.metrics.engine import CrossedMeans
    from reverie_eval.schemas.report import RunsReport

FEWEST_RUNS = 2


@dataclass(frozen=True, eq=False)
class RunIntervals(ClusterIntervals):
    """The interval of every metric by its key, over runs and clusters of episodes together."""

    n_runs: Sequence[int]
    """Number of different runs of each method."""
    copies: Sequence[Sequence[str]]
    """Names of runs that are equal in every episode, a group each; a group counts as one run."""
    run_shares: Mapping[str, float]
    """The part of each metric's variance that more runs would reduce, in [0, 1]; the rest is due to
    the choice of episodes."""

    @classmethod
    def of(
        cls,
        means: "CrossedMeans",
        ends: FloatArray,
        keys: Sequence[str],
        *,
        cluster: Clustering,
        confidence: float,
        runs: Sequence[Mapping[str, Scores]],
    ) -> Self:
        """Describe intervals of the means of methods' runs, or of differences of them.

        ``ends``, of shape (2, n_metrics), has a column for each of the keys.
        """
        groups = [_equal_runs(each) for each in runs]
        return cls(
            cluster,
            len(means.deviation),
            confidence,
            dict(zip(keys, map(Interval, *ends.tolist()), strict=True)),
            [len(each) for each in groups],
            [names for each in groups for names in each if len(names) > 1],
            dict(zip(keys, means.run_share.tolist(), strict=True)),
        )

    @property
    def procedure(self) -> str:
        """How the intervals were computed, so that they can be reproduced."""
        runs = " and ".join(map(str, self.n_runs))
        return (
            f"{self.label} intervals: Student's t within the bounds of each metric, by the "
            f"variance among {runs} run{'s' if max(self.n_runs) > 1 else ''} and among "
            f"{self.clusters_text}"
        )

    @property
    def caution(self) -> str:
        """What makes the intervals less certain than they look; empty if nothing does."""
        return "; ".join(
            [
                *filter(None, [super().caution]),
                *(
                    f"{' and '.join(names)} have the same values in every episode (a copy?): they "
                    "count as one run"
                    for names in self.copies
                ),
                *([_NO_EVIDENCE] if self.copies and 1 in self.n_runs else []),
                *([_TWO_RUNS] if FEWEST_RUNS in self.n_runs else []),
            ]
        )


_TWO_RUNS = (
    "only 2 runs: too few to show how much runs differ, so these intervals can be very wide; "
    "report each run"
)
_NO_EVIDENCE = (
    "nothing shows how much other runs would differ, so these intervals are about the choice of "
    "episodes alone"
)


@dataclass(frozen=True, eq=False, repr=False)
class Runs(Scored):
    """Several runs of one method: ``runs["rgspl"]`` is the mean over runs and episodes.

    Keys are the metrics that all runs have.
    """

    intervals: RunIntervals
    """Confidence intervals: other seeds and other episodes would give other means."""
    runs: Mapping[str, Scores]
    """The scores of each run, by name."""

    @classmethod
    def of(
        cls,
        runs: Mapping[str, Scores],
        cluster: Clustering = "target",
        *,
        confidence: float | None = None,
    ) -> Self:
        """Summarise existing scores.

        Parameters
        ----------
        runs : mapping of Scores
            Two or more, by name, of the same episodes under the same protocol.
        cluster : "target" or "scan"
            What dependent episodes share.
        confidence : float, optional
            Of the intervals, in (0, 1); by default 0.95.

        Raises
        ------
        ProtocolError
            If there are fewer than two runs, they are not comparable, all episodes are in one
            cluster, or the confidence is out of range.
        """
        # Importing scipy would double the start-up time of commands that show no intervals.
        from reverie_eval.metrics.engine import IntervalEngine

        if len(runs) < FEWEST_RUNS:
            raise ProtocolError(
                f"{count_text(len(runs), 'run')} given; the variance between runs needs two or more"
            )
        check_names(runs)
        first, *_ = runs.values()
        check_same_signature(runs.values(), "runs")
        Intervals.check_possible(first.ground_truth, cluster)
        keys = _common_keys(runs.values())
        means = crossed_means(runs, keys, cluster)
        # Checked and completed as everywhere, though nothing is resampled.
        level = IntervalEngine.of(confidence).confidence
        ends = means.interval(bounds_of(keys, attrgetter("bounds")), level)
        intervals = RunIntervals.of(
            means, ends, keys, cluster=cluster, confidence=level, runs=[runs]
        )
        mean = {
            key: frozen(np.mean([each.episodes[key] for each in runs.values()], axis=0))
            for key in keys
        }
        return cls(first.ground_truth, first.protocol, mean, first.qualifier, intervals, runs)

    def __getitem__(self, key: str) -> float:
        return float(self.episodes[key].mean())

    def deviation(self, key: str) -> float:
        """Return the standard deviation of a metric between the runs, in its own unit."""
        # The runs are a sample of those that other seeds would give: n - 1.
        return float(np.std([each[key] for each in self.runs.values()], ddof=1))

    @property
    def failure_modes(self) -> FailureModes:
        """How many episodes had each outcome in all runs together; errors are those of `Scores`."""
        modes = [run.failure_modes for run in self.runs.values()]
        return FailureModes(
            {key: sum(each.counts[key] for each in modes) for key in modes[0].counts},
            sum(each.wrong_stops_after_reaching for each in modes),
        )

    @property
    def notes(self) -> Sequence[str]:
        """What a reader should know about each run."""
        return [f"{name}: {note}" for name, each in self.runs.items() for note in each.notes]

    def to_report(self) -> "RunsReport":
        """Return the report of the runs, which ``--format json`` prints."""
        from reverie_eval.schemas.report import RunsReport

        return RunsReport(
            signature=self.signature,
            scores=dict(self),
            by=self.intervals.cluster,
            clusters=self.intervals.n_clusters,
            confidence=self.intervals.confidence,
            intervals={key: (each.low, each.high) for key, each in self.intervals.items()},
            deviations={key: self.deviation(key) for key in self},
            run_shares=dict(self.intervals.run_shares),
            runs={name: each.to_report() for name, each in self.runs.items()},
            notes=list(filter(None, [self.intervals.caution])),
        )

    def _repr_html_(self) -> str:
        """Show the runs and their mean in a notebook."""
        from reverie_eval.reporting.scores import runs_table

        return runs_table(self).to_html()

    def __repr__(self) -> str:
        return super().__repr__().replace("Runs", f"Runs of {len(self.runs)}:", 1)


def runs_of(scored: Scored) -> Mapping[str, Scores]:
    """Return the runs of a method by name; scores count as one run."""
    return scored.runs if isinstance(scored, Runs) else {"": cast("Scores", scored)}


def _equal_runs(runs: Mapping[str, Scores]) -> Sequence[Sequence[str]]:
    """Group the names of runs that have the same values in every episode.

    Such runs are most often the same file twice, or a seed that was not used.
    """
    keys = _common_keys(runs.values())
    groups: list[list[str]] = []
    for name, scores in runs.items():
        for names in groups:
            first = runs[names[0]]
            if all(np.array_equal(first.episodes[key], scores.episodes[key]) for key in keys):
                names.append(name)
                break
        else:
            groups.append([name])
    return groups


def _common_keys(scores: Iterable[Mapping[str, float]]) -> Sequence[str]:
    """Return the metrics that all have for all episodes, in the order of the CATALOGUE."""
    # A mean over runs needs a value of each run for the same episodes.
    return [key for key in shared_keys(scores) if not CATALOGUE[key].is_partial]


def crossed_means(
    runs: Mapping[str, Scores], keys: Sequence[str], cluster: Clustering
) -> "CrossedMeans":
    """Return the means of metrics over runs and episodes, with the parts of their variance.

    Equal runs are no evidence of how much runs differ: they weigh in the mean, but count as one.
    """
    # Importing scipy would double the start-up time of commands that show no intervals.
    from reverie_eval.metrics.engine import CrossedMeans

    groups = _equal_runs(runs)
    several = [runs[first] for first, *_ in groups]
    weight = np.array([len(names) for names in groups]) / len(runs)
    row_cluster = clusters_of(several[0].ground_truth, cluster)
    return CrossedMeans.of(values_of(several, keys), row_cluster, weight)


def values_of(runs: Iterable[Scores], keys: Sequence[str]) -> FloatArray:
    """Return the values of runs, shape (n_runs, n_episodes, n_metrics)."""
    return np.stack([np.column_stack([each.episodes[key] for key in keys]) for each in runs])
