"""Comparisons: whether one submission is better than another, by how much, in which episodes.

Every submission is compared with the first, on the same episodes. Results on the same episodes are
correlated, so differences have intervals of their own, narrower than separate ones suggest.
"""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import comb, inf
from operator import attrgetter
from typing import TYPE_CHECKING, Literal

import numpy as np
from typing_extensions import Self

from reverie_eval.analysis._costs import (
    CostDifference,
    Front,
    cost_differences,
    pareto_front,
)
from reverie_eval.analysis._runs import RunIntervals, Runs, crossed_means, runs_of
from reverie_eval.arrays import Array, FloatArray, difference
from reverie_eval.errors import ProtocolError, SubmissionError, naming_missing_parts
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.logs import COSTS
from reverie_eval.metrics import CATALOGUE, Metric, units_of
from reverie_eval.scoring import (
    DEFAULT_PROTOCOL,
    Clustering,
    ClusterIntervals,
    Evaluator,
    Interval,
    Intervals,
    Scored,
    Track,
    bounds_of,
    check_same_signature,
    clusters_of,
)
from reverie_eval.submissions import Submission, check_names, submission_names
from reverie_eval.tasks import KnownSplit
from reverie_eval.text import did_you_mean

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from reverie_eval.metrics.engine import IntervalEngine
    from reverie_eval.reporting.comparisons import ComparisonReport

BEST = "best"
"""The name that chooses the baseline by its scores."""
SMALLEST_SHOWN_P = 0.001
"""The smallest p-value that is shown; smaller ones are ``p < 0.001``."""
_MIN_SUBMISSIONS = 2
Verdict = Literal["better", "worse", "same", "not significant"]


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


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Mapping[str, Mapping[str, Difference]]):
    """How submissions differ from the first of them: ``comparison["b"]["rgspl"].mean``.

    Keys are the names of all but the first; values are mappings by the keys of the CATALOGUE. A
    submission is compared in the metrics that both it and the first have: without answers, only
    those of navigation.
    """

    scores: Mapping[str, Scored]
    """The scores of all submissions by name; several runs of a method count as one."""
    intervals: Mapping[str, ClusterIntervals]
    """Intervals of the differences, by the names of all but the first."""
    differences: Mapping[str, Mapping[str, Difference]] = field(repr=False)
    """The differences, by the names of all but the first, and by metric."""

    pairs: int | None
    """The number of all pairs if the first was chosen as the best, because p-values are then
    corrected for all of them; otherwise they are corrected for the comparisons with the first."""
    swaps: int
    """Random swaps of each test, more for more comparisons. 0 if there are runs, whose means are
    tested by Student's t."""
    smallest_p: float
    """The smallest p-value that any difference could have, after Holm's correction."""

    @classmethod
    def of(
        cls,
        scores: Mapping[str, Scored],
        cluster: Clustering = "target",
        *,
        confidence: float | None = None,
        resamples: int | None = None,
        seed: int | None = None,
        baseline: str | None = None,
        all_pairs: bool = False,
    ) -> Self:
        """Compare existing scores.

        Parameters
        ----------
        scores : mapping of Scores or Runs
            Two or more, by name, of the same episodes under the same protocol.
        cluster : "target" or "scan"
            What dependent episodes share.
        confidence, resamples, seed : optional
            As for :meth:`Scores.with_intervals`; the seed is also that of the swaps. A difference
            is significant at this confidence.
        baseline : str, optional
            The name of the submission that all others are compared with, by default the first; or
            ``best`` for the one with the highest RGSPL, or RGS or SPL if RGSPL is not scored.
        all_pairs : bool
            Whether the baseline was chosen by its scores, so that p-values are corrected for all
            pairs, as they always are for ``best``.

        Raises
        ------
        ProtocolError
            If they are not comparable, or none is named like the baseline.
        """
        # Only comparisons and intervals need scipy, which these import.
        from reverie_eval.metrics.engine import IntervalEngine
        from reverie_eval.metrics.uncertainty import randomisation_p, smallest_p, swaps_for

        engine = IntervalEngine.of(confidence, resamples, seed)
        check_comparable(scores)
        scores = _baseline_first(scores, baseline)
        (_, first), *others = scores.items()
        changes = {
            name: {
                key: difference(other.episodes[key], first.episodes[key])
                for key in first
                if key in other and not CATALOGUE[key].is_partial
            }
            for name, other in others
        }
        # To have compared all pairs for the best one is no less than to test them all.
        pairs = comb(len(scores), 2) if all_pairs or baseline == BEST else None
        if any(isinstance(each, Runs) for each in scores.values()):
            run_intervals, p_value = _intervals_of_runs(scores, changes, cluster, engine.confidence)
            differences = _describe_differences(changes, run_intervals, p_value, pairs)
            return cls(scores, run_intervals, differences, pairs, 0, 0.0)
        row_cluster = clusters_of(first.ground_truth, cluster)
        intervals = Intervals.of_several(
            changes, row_cluster, cluster, engine, attrgetter("difference_bounds")
        )
        n_comparisons = pairs or len(others)
        swaps = swaps_for(n_comparisons)
        # All changes side by side, so that the swaps are drawn once.
        table = np.column_stack([each for change in changes.values() for each in change.values()])
        p_value = randomisation_p(table, row_cluster, resamples=swaps, seed=engine.seed)
        differences = _describe_differences(changes, intervals, p_value, pairs)
        smallest = smallest_p(n_comparisons, len(np.unique(row_cluster)))
        return cls(scores, intervals, differences, pairs, swaps, smallest)

    def __getitem__(self, name: str) -> Mapping[str, Difference]:
        return self.differences[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.differences)

    def __len__(self) -> int:
        return len(self.differences)

    @property
    def first(self) -> str:
        """The name of the submission that the others are compared with."""
        return next(iter(self.scores))

    def primary(self, name: str) -> Metric:
        """Return the metric of the verdict on a submission; for REVERIE RGSPL, else RGS or SPL."""
        return self.scores[self.first].ground_truth.task.primary_metric(self[name])

    @property
    def correctness(self) -> Metric:
        """The metric that defines a correct episode: RGS if all have it, else success."""
        return CATALOGUE["rgs" if all("rgs" in each for each in self.values()) else "success"]

    def is_significant(self, name: str, metric: str | None = None) -> bool:
        """Whether interval and test agree that a submission differs in a metric.

        By default in the primary one.
        """
        # The two can disagree when clusters are few; then nothing is claimed.
        found = self[name][metric or self.primary(name).key]
        interval, confidence = found.interval, self.intervals[name].confidence
        # By the bounds that are shown, so that a reader comes to the same conclusion.
        excludes_zero = interval.low > 0 or interval.high < 0
        # p < 1 - confidence, without a subtraction that turns 1 - 0.95 into more than 0.05.
        return excludes_zero and found.p_value + confidence < 1

    @cached_property
    def costs(self) -> Mapping[str, Mapping[str, CostDifference]]:
        """How much more an episode cost than in the first submission, by name and cost.

        Intervals are by the same resamples as those of scores. Several runs of a method are left
        out, and so are those without a log, and costs that are unknown for some episodes.
        """
        return cost_differences(self.scores, self._cluster, self._engine)

    def front(self, cost: str | None = None, metric: str | None = None) -> Front:
        """Return what each run cost and scored, and whether it is on their Pareto front.

        A run is on it if no other is as good in both and better in one. Runs without a log are left
        out.

        Parameters
        ----------
        cost, metric : str, optional
            As for :meth:`Scores.success_within`.

        Raises
        ------
        ProtocolError
            If there is no such cost or metric, or the cost is unknown for some episodes.
        """
        return pareto_front(self.scores, cost, metric, self._cluster, self._engine)

    @property
    def _cluster(self) -> Clustering:
        return next(iter(self.intervals.values())).cluster

    @property
    def _engine(self) -> "IntervalEngine":
        """What computed the intervals; with several runs, what would have."""
        from reverie_eval.metrics.engine import IntervalEngine

        used = next(iter(self.intervals.values()))
        if isinstance(used, Intervals):
            return IntervalEngine(used.confidence, used.resamples, used.seed)
        return IntervalEngine(used.confidence)

    def verdict(self, name: str) -> Verdict:
        """Return in a word or two whether a submission is better than the first.

        One of ``better``, ``worse``, ``same`` (the primary metric has the same value in every
        episode) and ``not significant``.
        """
        found = self[name][self.primary(name).key]
        if not found.is_change:
            return "same"
        if not self.is_significant(name):
            return "not significant"
        return "better" if found.mean > 0 else "worse"

    def sentence(self, name: str) -> str:
        """Return a sentence that says whether a submission is better than the first."""
        if not any(each.is_change for each in self[name].values()):
            has_all = self.scores[name].keys() == self.scores[self.first].keys()
            verb = "score" if has_all else "navigate"
            return f"{name} and {self.first} {verb} the same in every episode"
        metric = self.primary(name)
        found = self[name][metric.key]
        verdict = self.verdict(name)
        if verdict == "same":
            return f"{name} and {self.first} score the same {metric.label} in every episode"
        # "worse by 2" needs a positive difference, with an interval to match.
        shown = found.reversed if verdict == "worse" else found
        mean = metric.display(shown.mean)
        label = self.intervals[name].label
        evidence = evidence_text(metric, shown.interval, shown.p_value, label)
        if verdict == "not significant":
            return (
                f"No significant difference between {name} and {self.first} in {metric.label}: "
                f"difference {mean}, {evidence}"
            )
        return f"{name} is {verdict} than {self.first} by {mean} {metric.label}, {evidence}"

    def to_pandas(self) -> "pd.DataFrame":
        """Return a row per submission and metric, indexed by both.

        Values are in the metrics' own units, which ``attrs["units"]`` lists by metric; ``caution``
        is empty unless intervals are less certain than they look.
        """
        with naming_missing_parts():
            import pandas as pd

        rows = {
            (name, key): {
                "first": self.scores[self.first][key],
                "value": self.scores[name][key],
                "difference": found.mean,
                "low": found.interval.low,
                "high": found.interval.high,
                "p_value": found.p_value,
                "higher": found.higher,
                "lower": found.lower,
                "mcnemar_p": found.mcnemar_p,
                "caution": self.intervals[name].caution,
            }
            for name, differences in self.items()
            for key, found in differences.items()
        }
        rows |= {
            (name, key): {
                "first": found.first,
                "value": found.value,
                "difference": found.mean,
                "low": found.interval.low,
                "high": found.interval.high,
            }
            for name, differences in self.costs.items()
            for key, found in differences.items()
        }
        frame = pd.DataFrame.from_dict(rows, orient="index")
        costs = COSTS if self.costs else {}
        frame.attrs["units"] = {**units_of(self.scores[self.first]), **costs}
        return frame.rename_axis(index=["submission", "metric"])

    def episodes(self, metric: str | None = None) -> "pd.DataFrame":
        """Return the episodes with different values: a row per instr_id, a column per submission.

        ``attrs["units"]`` has the metric's unit, by column.

        Parameters
        ----------
        metric : str, optional
            The metric to compare; :attr:`correctness` if not given.
        """
        with naming_missing_parts():
            import pandas as pd

        key = self.correctness.key if metric is None else metric
        values = {name: each.episodes[key] for name, each in self.scores.items()}
        index = pd.Index(self.scores[self.first].instr_ids, name="instr_id")
        frame = pd.DataFrame(values, index=index)
        frame.attrs["units"] = dict.fromkeys(values, CATALOGUE[key].unit)
        first = values[self.first]
        # Differences as they are counted, up to rounding, not those of the last bit.
        differs = np.any([difference(each, first) != 0 for each in values.values()], axis=0)
        return frame[differs]

    # Conveniences by what is above this package; the import contract lists them.

    def to_report(self) -> "ComparisonReport":
        """Return the comparison report, which ``--format json`` prints."""
        from reverie_eval.reporting.comparisons import comparison_report

        return comparison_report(self)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the differences from the first submission, with their intervals. Needs matplotlib.

        Every metric of the score table that is a fraction has a row.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; a new figure if not given.

        Raises
        ------
        ReverieEvalError
            If matplotlib is not installed.
        """
        from reverie_eval.reporting.figures import plot_comparison

        return plot_comparison(self, ax)

    def _repr_html_(self) -> str:
        """Show the comparison in a notebook."""
        from reverie_eval.reporting.comparisons import comparison_table

        return comparison_table(self).to_html()

    def __repr__(self) -> str:
        return f"<Comparison: {'; '.join(map(self.sentence, self))}>"


class ComparedSubmissionsError(SubmissionError):
    """Some of the compared submissions are invalid; ``errors`` has their errors by name."""

    def __init__(self, errors: Mapping[str, SubmissionError]) -> None:
        self.errors = errors
        super().__init__([problem for error in errors.values() for problem in error.problems])

    def __str__(self) -> str:
        return "\n".join(f"{name}: {error}" for name, error in self.errors.items())


def compare(
    *submissions: Submission | Scored,
    split: KnownSplit | str | None = None,
    ground_truth: str | os.PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
    track: Track = "full",
    subset: Iterable[str] | None = None,
    task: str | None = None,
    names: Sequence[str] | None = None,
    cluster: Clustering = "target",
    confidence: float | None = None,
    resamples: int | None = None,
    seed: int | None = None,
    baseline: str | None = None,
) -> Comparison:
    """Score submissions on the same episodes, and compare all others with the first.

    Parameters
    ----------
    submissions : two or more
        As for :func:`reverie_eval.evaluate`, or existing scores, or several runs of a method.
    split, ground_truth, protocol, track, subset, task
        As for :func:`reverie_eval.evaluate`; not used if all are scores.
    names : sequence of str, optional
        Names of the submissions; by default those of their files.
    cluster, confidence, resamples, seed, baseline
        As for :meth:`Comparison.of`.

    Raises
    ------
    ProtocolError
        If there are fewer than two, or they are not comparable.
    ComparedSubmissionsError
        If some are invalid; reports all of them.
    GroundTruthError, OSError
        As :func:`reverie_eval.evaluate` does.

    Examples
    --------
    >>> samples = [f"demo/{name}.json" for name in ("mediocre", "good")]
    >>> comparison = compare(*samples, split="val_unseen")
    >>> comparison["good"]["rgspl"].mean > 0, comparison.is_significant("good")
    (True, True)
    """
    names = submission_names(submissions) if names is None else names
    # Of two with one name, the second would silently take the place of the first.
    if len(set(names)) != len(submissions):
        given = ", ".join(map(str, names))
        raise ProtocolError(f"every submission needs a name of its own; got {given}")
    evaluator = (
        None
        if split is None
        else Evaluator(
            split=split,
            ground_truth=ground_truth,
            protocol=protocol,
            track=track,
            subset=subset,
            task=task,
        )
    )
    scores: dict[str, Scored] = {}
    errors: dict[str, SubmissionError] = {}
    for name, each in zip(names, submissions, strict=True):
        if isinstance(each, Scored):
            scores[name] = each
            continue
        if evaluator is None:
            raise ProtocolError("give the split of the submissions: split=...")
        try:
            scores[name] = evaluator(each)
        except SubmissionError as error:
            # Go on, so that all invalid files are reported at once.
            errors[name] = error
    if errors:
        raise ComparedSubmissionsError(errors)
    return Comparison.of(
        scores,
        cluster,
        confidence=confidence,
        resamples=resamples,
        seed=seed,
        baseline=baseline,
    )


def _intervals_of_runs(
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


def _describe_differences(
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


def _baseline_first(scores: Mapping[str, Scored], baseline: str | None) -> Mapping[str, Scored]:
    """Return the scores with those of the baseline first, the others in their order."""
    if baseline is None:
        return scores
    if baseline == BEST:
        task = next(iter(scores.values())).ground_truth.task
        key = task.primary_metric({key for each in scores.values() for key in each}).key
        baseline = max(scores, key=lambda name: scores[name].get(key, -inf))
    if baseline not in scores:
        raise ProtocolError(f"no submission is named {baseline!r}{did_you_mean(baseline, scores)}")
    return {baseline: scores[baseline], **scores}
