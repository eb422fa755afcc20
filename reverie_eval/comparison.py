"""Compare submissions: whether one is better than another, by how much, and where.

Submissions are compared on the same episodes, each with the first. Two that fail in the same
episodes differ more surely than their separate intervals suggest, so differences have their own.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from reverie_eval.arrays import Array, IntArray
from reverie_eval.errors import ProtocolError
from reverie_eval.evaluation import evaluate
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.intervals import Clustering, Interval, Intervals, clusters_of
from reverie_eval.metrics import BINARY_METRICS, CATALOGUE, Metric, primary_of, units_of
from reverie_eval.naming import demand_texts, names_of
from reverie_eval.protocol import DEFAULT_PROTOCOL
from reverie_eval.reading import Submission
from reverie_eval.scores import Scores

if TYPE_CHECKING:
    import pandas as pd

    from reverie_eval.schemas.comparison import ComparisonReport

_LEAST = 2
_SMALLEST_P = 0.001


@dataclass(frozen=True, slots=True)
class Difference:
    """How a submission differs from the first in one metric; in the metric's own unit."""

    mean: float
    """Of the submission's values less the first's."""
    interval: Interval
    p_value: float
    """Of the paired randomisation test over clusters, two-sided; corrected by Holm's method for
    the number of submissions that are compared with the first."""
    higher: int
    """Episodes in which the submission's value is the higher one."""
    lower: int
    """Episodes in which it is the lower one."""
    mcnemar_p: float | None
    """Of McNemar's exact test, corrected likewise; None where values are more than yes and no."""

    @property
    def turned(self) -> Self:
        """How the first differs from the submission."""
        low, high = -self.interval.high, -self.interval.low
        return replace(
            self,
            mean=-self.mean,
            interval=Interval(low, high),
            higher=self.lower,
            lower=self.higher,
        )


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Mapping[str, Mapping[str, Difference]]):
    """How submissions differ from the first of them: ``comparison["b"]["rgspl"].mean``.

    Keys are the names of all but the first, and below each the keys of the CATALOGUE.
    """

    scores: Mapping[str, Scores]
    """All submissions' scores, by their names."""
    intervals: Mapping[str, Intervals]
    """Of the differences, by the names of all but the first."""
    _differences: Mapping[str, Mapping[str, Difference]] = field(repr=False)

    @classmethod
    def of(cls, scores: Mapping[str, Scores], by: Clustering = "target", *, seed: int = 0) -> Self:
        """Compare scores that are there already.

        Parameters
        ----------
        scores : mapping of Scores
            Two or more, by name, of the same episodes under the same protocol.
        by : "target" or "scan"
            What episodes have in common that are not independent.
        seed : int
            Of the resamples and swaps.

        Raises
        ------
        ProtocolError
            If they do not compare.
        """
        demand_comparable(scores)
        (_, first), *others = scores.items()
        keys = [key for key in first if all(key in other for _, other in others)]
        changes = {
            name: {key: other.episodes[key] - first.episodes[key] for key in keys}
            for name, other in others
        }
        intervals = {
            name: Intervals.of(change, first.ground_truth, by, seed=seed)
            for name, change in changes.items()
        }
        cluster = clusters_of(first.ground_truth, by)
        return cls(scores, intervals, _differences(changes, intervals, cluster, seed))

    def __getitem__(self, name: str) -> Mapping[str, Difference]:
        return self._differences[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._differences)

    def __len__(self) -> int:
        return len(self._differences)

    @property
    def first(self) -> str:
        """The name of the submission that the others are compared with."""
        return next(iter(self.scores))

    @property
    def primary(self) -> Metric:
        """What decides which is better: RGSPL, and where that is not scored RGS, or SPL."""
        return primary_of(self._scored)

    @property
    def judgement(self) -> Metric:
        """What says whether an episode is right: RGS, and where that is not scored success."""
        return CATALOGUE["rgs" if "rgs" in self._scored else "success"]

    @property
    def _scored(self) -> Mapping[str, Difference]:
        return next(iter(self.values()))

    def is_alike(self, name: str) -> bool:
        """Whether a submission and the first have the same value in every episode and metric."""
        return not any(each.higher or each.lower for each in self[name].values())

    def is_sure(self, name: str) -> bool:
        """Whether interval and test both exclude that a submission is no better or worse."""
        difference = self[name][self.primary.key]
        interval, confidence = difference.interval, self.intervals[name].confidence
        excludes_zero = interval.low > 0 or interval.high < 0
        return excludes_zero and difference.p_value + confidence < 1

    def sentence(self, name: str) -> str:
        """Say in a sentence whether a submission is better than the first, in the main metric."""
        metric, difference = self.primary, self[name][self.primary.key]
        if self.is_alike(name):
            return f"{name} and {self.first} score the same in every episode"
        if not self.is_sure(name):
            apart = f"These data cannot tell {name} and {self.first} apart in {metric.label}"
            size = metric.display(difference.mean)
            return f"{apart}: difference {size}, {self._evidence(name, difference)}"
        is_better = difference.mean > 0
        verdict = f"{name} is {'better' if is_better else 'worse'} than {self.first}"
        shown = difference if is_better else difference.turned
        size = f"{metric.display(shown.mean)} {metric.label}"
        return f"{verdict} by {size}, {self._evidence(name, shown)}"

    def _evidence(self, name: str, difference: Difference) -> str:
        low, high = map(self.primary.display, (difference.interval.low, difference.interval.high))
        label, p_value = self.intervals[name].label, p_text(difference.p_value)
        return f"{label} interval {low} to {high}, {p_value}"

    def to_report(self) -> "ComparisonReport":
        """Return the comparison report, the JSON of the command line."""
        from reverie_eval.schemas.comparison import ComparisonReport

        return ComparisonReport.model_validate(
            {
                "first": self.first,
                "submissions": {name: each.to_report() for name, each in self.scores.items()},
                "intervals": {name: each.caption for name, each in self.intervals.items()},
                "differences": self._differences,
                "sentences": {name: self.sentence(name) for name in self},
            }
        )

    def to_pandas(self) -> "pd.DataFrame":
        """Return a row per submission and metric, indexed by both.

        Values are in the metrics' own units, which ``attrs["units"]`` names by metric.
        """
        import pandas as pd

        rows = {
            (name, key): {
                "first": self.scores[self.first][key],
                "value": self.scores[name][key],
                "difference": difference.mean,
                "low": difference.interval.low,
                "high": difference.interval.high,
                "p_value": difference.p_value,
                "higher": difference.higher,
                "lower": difference.lower,
                "mcnemar_p": difference.mcnemar_p,
            }
            for name, differences in self.items()
            for key, difference in differences.items()
        }
        frame = pd.DataFrame.from_dict(rows, orient="index")
        frame.attrs["units"] = units_of(self._scored)
        return frame.rename_axis(index=["submission", "metric"])

    def episodes(self, metric: str | None = None) -> "pd.DataFrame":
        """Return the episodes that not all score alike: a row per instr_id, a column per name.

        ``attrs["units"]`` names the metric's unit, by column.

        Parameters
        ----------
        metric : str, optional
            By which they are alike or not; :attr:`judgement` if not given.
        """
        import pandas as pd

        key = self.judgement.key if metric is None else metric
        values = {name: each.episodes[key] for name, each in self.scores.items()}
        index = pd.Index(self.scores[self.first].instr_ids, name="instr_id")
        frame = pd.DataFrame(values, index=index)
        frame.attrs["units"] = dict.fromkeys(values, CATALOGUE[key].unit)
        return frame[frame.ne(frame[self.first], axis=0).any(axis=1)]

    def __repr__(self) -> str:
        return f"<Comparison: {'; '.join(map(self.sentence, self))}>"

    def _repr_html_(self) -> str:
        """Show the comparison in a notebook."""
        from reverie_eval.reporting.comparison import comparison_html

        return comparison_html(self)


def compare(
    *submissions: Submission | Scores,
    split: str | None = None,
    ground_truth: str | os.PathLike[str] | GroundTruth | None = None,
    protocol: str = DEFAULT_PROTOCOL,
    names: Sequence[str] | None = None,
    by: Clustering = "target",
    seed: int = 0,
) -> Comparison:
    """Score submissions on the same episodes, and compare all others with the first.

    Parameters
    ----------
    submissions : two or more, as :func:`reverie_eval.evaluate` takes them
        Or scores that are there already.
    split, ground_truth, protocol
        As :func:`reverie_eval.evaluate` takes them; of no use where all are scores.
    names : sequence of str, optional
        What :func:`reverie_eval.naming.names_of` calls them if not given.
    by, seed
        As :meth:`Comparison.of` takes them.

    Raises
    ------
    ProtocolError
        If there are fewer than two, or they do not compare.
    SubmissionError, GroundTruthError, OSError
        As :func:`reverie_eval.evaluate` does.

    Examples
    --------
    >>> samples = [f"fixtures/submissions/{name}.json" for name in ("mediocre", "good")]
    >>> comparison = compare(*samples, split="val_unseen")
    >>> comparison["good"]["rgspl"].mean > 0, comparison.is_sure("good")
    (True, True)
    """
    if split is None and not all(isinstance(each, Scores) for each in submissions):
        raise ProtocolError("name the split that the submissions are for: split=...")
    truth = find_ground_truth(ground_truth, split) if split else None
    scores = [
        each
        if isinstance(each, Scores)
        else evaluate(each, split=str(split), ground_truth=truth, protocol=protocol)
        for each in submissions
    ]
    called = names_of(submissions) if names is None else names
    if len(set(called)) != len(submissions):
        given = ", ".join(map(str, called))
        raise ProtocolError(f"every submission needs a name of its own; got {given}")
    return Comparison.of(dict(zip(called, scores, strict=True)), by, seed=seed)


def p_text(p_value: float) -> str:
    """Write a p-value as papers do.

    >>> p_text(0.0312), p_text(0.00009999)
    ('p = 0.031', 'p < 0.001')
    """
    return "p < 0.001" if p_value < _SMALLEST_P else f"p = {p_value:.3f}"


def demand_comparable(scores: Mapping[str, Scores]) -> None:
    """Make sure that scores can be held against each other.

    Raises
    ------
    ProtocolError
        If they are fewer than two, have names that are no texts, or other signatures.
    """
    if len(scores) < _LEAST:
        raise ProtocolError("a comparison needs two submissions or more, of different names")
    demand_texts(scores)
    signatures = {each.signature for each in scores.values()}
    if len(signatures) > 1:
        raise ProtocolError(f"these scores do not compare: {', '.join(sorted(signatures))}")


def _differences(
    changes: Mapping[str, Mapping[str, Array]],
    intervals: Mapping[str, Intervals],
    cluster: IntArray,
    seed: int,
) -> Mapping[str, Mapping[str, Difference]]:
    """Judge every change, (n_episodes,) by submission and metric, with all others in view."""
    from reverie_eval.metrics.uncertainty import holm, mcnemar_p, randomisation_p

    tables = [np.column_stack(list(change.values())) for change in changes.values()]
    p_value = holm(np.stack([randomisation_p(table, cluster, seed=seed) for table in tables]))
    higher = np.stack([(table > 0).sum(axis=0) for table in tables])
    lower = np.stack([(table < 0).sum(axis=0) for table in tables])
    mcnemar = holm(mcnemar_p(higher, lower))
    return {
        name: {
            key: Difference(
                mean=float(values.mean()),
                interval=intervals[name][key],
                p_value=float(p_value[row, column]),
                higher=int(higher[row, column]),
                lower=int(lower[row, column]),
                mcnemar_p=float(mcnemar[row, column]) if key in BINARY_METRICS else None,
            )
            for column, (key, values) in enumerate(change.items())
        }
        for row, (name, change) in enumerate(changes.items())
    }
