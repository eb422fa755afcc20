"""Comparisons with published means, of which nothing but the number of episodes is known."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.analysis._comparison import evidence_text
from reverie_eval.analysis._runs import crossed_means, runs_of, values_of
from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import CUSTOM_DATASET
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.scoring import (
    Clustering,
    ClusterIntervals,
    Interval,
    Intervals,
    Scored,
    bounds_of,
    clusters_of,
)
from reverie_eval.tasks import PublishedResult, published_on
from reverie_eval.text import did_you_mean

if TYPE_CHECKING:
    from reverie_eval.metrics.published import PublishedDifference
    from reverie_eval.reporting.comparisons import AgainstReport


@dataclass(frozen=True, slots=True)
class DifferenceOfMeans:
    """How a mean differs from a published one, in the metric's own unit."""

    mean: float
    """The mean at hand minus the published one."""
    interval: Interval
    p_value: float
    """Two-sided, and below 0.05 if and only if the 95 % interval does not contain 0."""


@dataclass(frozen=True, eq=False)
class IntervalsAgainst(ClusterIntervals):
    """The intervals of differences from published means, by metric."""

    @property
    def procedure(self) -> str:
        """How the intervals were computed, so that they can be reproduced."""
        return (
            f"{self.label} intervals: by the score intervals of both means (Newcombe's method 10), "
            f"over {self.clusters_text}; p by the same intervals"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Against(Mapping[str, DifferenceOfMeans]):
    """How scores differ from published means: ``against["rgs"].mean``.

    Keys are the metrics that both have. The differences are those to be expected on other episodes
    of the kind.
    """

    scored: Scored
    published: Mapping[str, float]
    """The published means, by metric: fractions or metres."""
    name: str
    """What was published: a method with its source, or ``the published mean``."""
    n_published: int
    """The number of episodes that the published means are over."""
    is_n_assumed: bool
    """Whether nobody has said how many they are, so that they count as the whole split."""
    n_split: int
    """The number of episodes of the split."""
    intervals: IntervalsAgainst
    differences: Mapping[str, DifferenceOfMeans] = field(repr=False)
    on_split: Mapping[str, DifferenceOfMeans] = field(repr=False)
    """The differences to be expected on all episodes of the split itself, of which either mean has
    a random part; empty if both are over all of them."""

    def __getitem__(self, key: str) -> DifferenceOfMeans:
        return self.differences[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.differences)

    def __len__(self) -> int:
        return len(self.differences)

    @property
    def primary(self) -> Metric:
        """The metric of the verdict: the one that the task ranks by, or else the first."""
        ranking = self.scored.ground_truth.task.ranking
        return CATALOGUE[next(filter(self.__contains__, [*ranking, *self]))]

    @property
    def sentence(self) -> str:
        """Whether the scores are better than the published mean, in a sentence."""
        metric = self.primary
        found, here = self[metric.key], self.on_split.get(metric.key)
        is_significant = found.p_value + self.intervals.confidence < 1
        # "worse by 2" needs a positive difference, with an interval to match.
        is_reversed = is_significant and found.mean < 0
        told = self._told(found, is_reversed=is_reversed)
        if here:
            on_split = self._told(here, is_reversed=is_reversed)
            told += f"; on {self.scored.split} itself, {on_split}"
        mean = metric.display(-found.mean if is_reversed else found.mean)
        if not is_significant:
            return (
                f"No significant difference from {self.name} in {metric.label}: difference {mean}, "
                f"{told}"
            )
        is_higher = found.mean > 0
        words = ("higher", "lower") if metric.better == "neither" else ("better", "worse")
        word = words[is_higher == (metric.better == "lower")]
        return f"{word.capitalize()} than {self.name} by {mean} {metric.label}, {told}"

    @property
    def assumptions(self) -> Sequence[str]:
        """What nobody could check, a line each."""
        split, whole, own = self.scored.split, self.n_split, len(self.scored.instr_ids)
        size = f"all {whole:,}" if self.n_published == whole else f"{self.n_published:,}"
        unknown = ", for want of a number" if self.is_n_assumed else ""
        parts = [f"{n:,}" for n in dict.fromkeys((own, self.n_published)) if n < whole]
        drawn = f"the {' and the '.join(parts)} were drawn at random from its {whole:,}; "
        mean = (
            f"assumed: the published mean is over {size} episodes of {split}{unknown}, by "
            f"{self.scored.protocol.name}; {drawn if parts else ''}its results vary between "
            "episodes as much as these"
        )
        pair = (
            "assumed: results of the two methods are unrelated; the more they succeed in the same "
            "episodes, the narrower the intervals should be"
        )
        return [mean, pair + f"; those on {split} do not depend on it" * bool(self.on_split)]

    def _told(self, found: DifferenceOfMeans, *, is_reversed: bool) -> str:
        interval = found.interval.reversed if is_reversed else found.interval
        return evidence_text(self.primary, interval, found.p_value, self.intervals.label)

    def to_report(self) -> "AgainstReport":
        """Return the report, which ``--format json`` prints."""
        from reverie_eval.reporting.comparisons import against_report

        return against_report(self)

    def _repr_html_(self) -> str:
        """Show the comparison in a notebook."""
        from reverie_eval.reporting.comparisons import against_table

        return against_table(self).to_html()

    def __repr__(self) -> str:
        return f"<Against: {self.sentence}>"


def against(
    scored: Scored,
    published: Mapping[str, float] | str,
    n: int | None = None,
    cluster: Clustering = "target",
    *,
    confidence: float | None = None,
) -> Against:
    """Compare scores with published means; see :meth:`Scored.against`.

    ``cluster`` says what dependent episodes share.
    """
    # Only comparisons and intervals need scipy, which these import.
    from reverie_eval.metrics.engine import IntervalEngine
    from reverie_eval.metrics.published import PublishedDifference, ResultSpread

    truth = scored.ground_truth
    whole = truth.whole.scored_by(scored.protocol)
    name = "the published mean"
    if isinstance(published, str):
        result = _find(scored, published)
        name, n = f"{result.method} ({result.paper})", result.episodes if n is None else n
        published = {key: value for key, value in result.scores.items() if key in scored}
    n_split = len(whole.episodes.instr_ids)
    _check(scored, published, n, n_split)
    Intervals.check_possible(truth, cluster)
    level = IntervalEngine.of(confidence).confidence
    keys, n_own = list(published), len(scored.instr_ids)
    runs, row_cluster = runs_of(scored), clusters_of(truth, cluster)
    _, sizes = np.unique(clusters_of(whole, cluster), return_counts=True)
    n_published = n_split if n is None else n

    def expected(n_episodes: int | None) -> Mapping[str, DifferenceOfMeans]:
        return _describe(
            keys,
            PublishedDifference(
                means=crossed_means(runs, keys, cluster),
                published=np.array(list(published.values())),
                n_published=n_published,
                spread=ResultSpread.of(values_of(runs.values(), keys), row_cluster, sizes),
                bounds=bounds_of(keys, attrgetter("bounds")),
                n_episodes=n_episodes,
            ),
            level,
        )

    differences = expected(None)
    ends = {key: each.interval for key, each in differences.items()}
    return Against(
        scored=scored,
        published=published,
        name=name,
        n_published=n_published,
        is_n_assumed=n is None and name == "the published mean",
        n_split=n_split,
        intervals=IntervalsAgainst(cluster, len(np.unique(row_cluster)), level, ends),
        differences=differences,
        on_split=expected(n_own) if min(n_own, n_published) < n_split else {},
    )


def _describe(
    keys: Sequence[str], found: "PublishedDifference", confidence: float
) -> Mapping[str, DifferenceOfMeans]:
    columns = zip(
        keys,
        (found.means.mean - found.published).tolist(),
        *found.interval(confidence).tolist(),
        found.p_value().tolist(),
        strict=True,
    )
    return {
        key: DifferenceOfMeans(mean, Interval(low, high), p_value)
        for key, mean, low, high, p_value in columns
    }


def _find(scored: Scored, name: str) -> PublishedResult:
    """Return the published result of a method on the split of scores."""
    track = "full" if "success" in scored else "grounding"
    of_split = published_on(scored.ground_truth.task.name, scored.split, track)
    found = next((it for it in of_split.values() if it.method.casefold() == name.casefold()), None)
    if found is None:
        raise ProtocolError(
            f"nothing published of {name!r} on {scored.split} is known here"
            f"{did_you_mean(name, of_split)}; or give its values, as in SR=41.2"
        )
    check_scored_alike(found, scored)
    return found


def check_scored_alike(published: PublishedResult, scored: Scored) -> None:
    """Check that a published result is of the same data, under the same protocol, as scores.

    Raises
    ------
    ProtocolError
        If it is not.
    """
    dataset = scored.ground_truth.header.dataset
    is_same_data = dataset in {published.dataset, CUSTOM_DATASET}  # unknown files may be those
    if published.protocol != scored.protocol.name or not is_same_data:
        raise ProtocolError(
            f"{published.method} was scored by {published.protocol} on {published.dataset}, and "
            f"these scores are by {scored.protocol.name} on {dataset}; score by the same rules on "
            "the same data"
        )


def _check(scored: Scored, published: Mapping[str, float], n: int | None, n_split: int) -> None:
    """Raise ProtocolError with everything that is wrong with published means."""
    known = [key for key in scored if not CATALOGUE[key].is_partial]
    wrong = [
        f"{key!r} is not scored here{did_you_mean(key, known)}"
        for key in published
        if key not in known
    ]
    for key in filter(known.__contains__, published):
        metric, value = CATALOGUE[key], published[key]
        if not (np.isfinite(value) and metric.lower_bound <= value <= metric.upper_bound):
            wrong.append(
                f"{key} is {value:g}; expected "
                + (
                    "a fraction from 0 to 1"
                    if metric.unit == "fraction"
                    else "a number within bounds"
                )
            )
    if not published:
        wrong.append("no metric is given that these scores have")
    if n is not None and not 1 <= n <= n_split:
        wrong.append(
            f"the published mean is over {n:,} episodes; expected 1 to {n_split:,}, all of "
            f"{scored.split}"
        )
    if wrong:
        raise ProtocolError("; ".join(wrong))
