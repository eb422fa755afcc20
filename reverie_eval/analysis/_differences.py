"""Differences in one metric between scores that can be compared, with their tests."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from typing_extensions import Self

from reverie_eval.analysis._runs import RunIntervals, crossed_means, runs_of
from reverie_eval.arrays import Array, FloatArray
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.scoring import (
    Clustering,
    ClusterIntervals,
    Interval,
    Intervals,
    Scored,
    bounds_of,
    check_same_signature,
)
from reverie_eval.submissions import check_names
from reverie_eval.text import did_you_mean

BEST = "best"
"""The name that chooses the baseline by its scores."""
SMALLEST_SHOWN_P = 0.001
"""The smallest p-value that is shown; smaller ones are ``p < 0.001``."""
_MIN_SUBMISSIONS = 2


@dataclass(frozen=True, slots=True)
class Difference:
    """How a submission differs from the first in one metric, in the metric's own unit."""

    mean: float
    """Mean of the submission's values minus the first's."""
    interval: Interval
    p_value: float
    """Two-sided p-value of the paired randomisation test over clusters, corrected by Holm's method
    for the number of submissions compared with the first."""
    higher: int
    """Episodes in which the submission's value is higher."""
    lower: int
    """Episodes in which the value is lower than the first submission's."""
    mcnemar_p: float | None
    """P-value of McNemar's exact test, corrected as ``p_value``; null if the metric is not
    binary, or there are several runs."""

    @property
    def is_change(self) -> bool:
        """Whether the difference is not 0 in some episode."""
        return bool(self.higher or self.lower)

    @property
    def reversed(self) -> Self:
        """How the first submission differs from this one."""
        return replace(
            self,
            mean=-self.mean,
            interval=self.interval.reversed,
            higher=self.lower,
            lower=self.higher,
        )


def intervals_of_runs(
    scores: Mapping[str, Scored],
    changes: Mapping[str, Mapping[str, Array]],
    cluster: Clustering,
    confidence: float,
) -> tuple[Mapping[str, RunIntervals], FloatArray]:
    """Test methods of several runs: the intervals of their changes, and each one's p-value."""
    first = runs_of(next(iter(scores.values())))
    intervals: dict[str, RunIntervals] = {}
    p_values = []
    for name, change in changes.items():
        keys, runs = list(change), runs_of(scores[name])
        means = crossed_means(runs, keys, cluster).minus(crossed_means(first, keys, cluster))
        bounds = bounds_of(keys, attrgetter("difference_bounds"))
        ends = means.interval(bounds, confidence)
        intervals[name] = RunIntervals.of(
            means, ends, keys, cluster=cluster, confidence=confidence, runs=[runs, first]
        )
        p_values.append(means.p_value(bounds))
    return intervals, np.concatenate(p_values)


def describe_differences(
    changes: Mapping[str, Mapping[str, Array]],
    intervals: Mapping[str, ClusterIntervals],
    p_value: FloatArray,
    pairs: int | None,
) -> Mapping[str, Mapping[str, Difference]]:
    """Describe the changes, arrays of shape (n_episodes,) by submission and metric.

    ``p_value`` has the p-value of each change, one after the other.
    """
    from reverie_eval.metrics.uncertainty import holm, mcnemar_p

    columns = [(name, key) for name, change in changes.items() for key in change]
    # Counted on differences up to rounding, as `changes` are.
    higher = np.array([(changes[name][key] > 0).sum() for name, key in columns])
    lower = np.array([(changes[name][key] < 0).sum() for name, key in columns])
    mcnemar = mcnemar_p(higher, lower)
    # Holm's correction is over the submissions that have a metric.
    metric = np.array([key for _, key in columns])
    for key in set(metric.tolist()):
        rows = metric == key
        p_value[rows] = holm(p_value[rows], pairs)
        mcnemar[rows] = holm(mcnemar[rows], pairs)
    differences: dict[str, dict[str, Difference]] = {name: {} for name in changes}
    for column, (name, key) in enumerate(columns):
        has_mcnemar = CATALOGUE[key].is_binary and isinstance(intervals[name], Intervals)
        differences[name][key] = Difference(
            mean=float(changes[name][key].mean()),
            interval=intervals[name][key],
            p_value=float(p_value[column]),
            higher=int(higher[column]),
            lower=int(lower[column]),
            mcnemar_p=float(mcnemar[column]) if has_mcnemar else None,
        )
    return differences


def evidence_text(metric: Metric, interval: Interval, p_value: float, label: str) -> str:
    """Return the interval of a difference, with its confidence, and the p-value."""
    low, high = metric.display(interval.low), metric.display(interval.high)
    return f"{label} interval {low} to {high}, {p_text(p_value)}"


def p_text(p_value: float) -> str:
    """Format a p-value as papers do.

    >>> p_text(0.0312), p_text(0.00009999)
    ('p = 0.031', 'p < 0.001')
    """
    return "p < 0.001" if p_value < SMALLEST_SHOWN_P else f"p = {p_value:.3f}"


def check_comparable(scores: Mapping[str, Scored]) -> None:
    """Check that scores can be compared.

    Raises
    ------
    ProtocolError
        If there are fewer than two, a name is not text, or signatures differ.
    """
    if len(scores) < _MIN_SUBMISSIONS:
        raise ProtocolError("a comparison needs two or more submissions with different names")
    check_names(scores)
    check_same_signature(scores.values())


def baseline_first(scores: Mapping[str, Scored], baseline: str | None) -> Mapping[str, Scored]:
    """Return the scores with those of the baseline first, the others in their order."""
    if baseline is None:
        return scores
    if baseline == BEST:
        task = next(iter(scores.values())).ground_truth.task
        key = task.primary_metric({key for each in scores.values() for key in each}).key
        baseline = max(scores, key=lambda name: scores[name].get(key, -math.inf))
    if baseline not in scores:
        raise ProtocolError(f"no submission is named {baseline!r}{did_you_mean(baseline, scores)}")
    return {baseline: scores[baseline], **scores}
