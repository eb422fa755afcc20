"""The results of several methods as papers show them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

from typing_extensions import Self

from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import Metric
from reverie_eval.reporting.tables import MISSING, Group, Number, Style, Table, metric_cell
from reverie_eval.scoring import ClusterIntervals, Intervals, Scored, Scores
from reverie_eval.tasks import PublishedResult
from reverie_eval.text import did_you_mean

if TYPE_CHECKING:
    from reverie_eval.analysis import Comparison

_MARKS = "†‡§¶"
# Of the best and the second best.
_STYLES: Sequence[Style] = ("bold", "underlined")
_NAVIGATION = frozenset({"trajectory", "goal region", "planner's path"})


def results_table(
    results: Mapping[str, Scored | Sequence[Scored]],
    *,
    baselines: Sequence[str] = (),
    published: Sequence[PublishedResult] = (),
) -> Table:
    r"""Return the results of several methods as a table, as papers show them.

    The splits are side by side, and under each the metrics of navigation and of grounding. The best
    of a column is bold if it is significantly better than all others, and then the second is
    underlined if it is significantly better than all but the best. The caption says by which test,
    and what the numbers depend on.

    Parameters
    ----------
    results : mapping of Scores or Runs, or of several
        By the name of the method; a method may have scores for several splits. If any have
        intervals, as those of runs do, all rows show them, of the same confidence.
    baselines : sequence of str
        Names of methods, up to four; what differs significantly from one has its mark, except the
        other baselines.
    published : sequence of PublishedResult
        Rows above the others. Their episodes are not known, so nothing is tested against them, but
        where one is at least as good as the best of the others, nothing is bold.

    Returns
    -------
    Table
        A notebook shows it; ``to_latex()``, ``to_markdown()``, ``to_html()``, ``to_csv()`` and
        ``to_text()`` return it for other places.

    Raises
    ------
    ProtocolError
        If there are no scores, they are not comparable, a baseline is not among them, or a
        published result was scored under other rules.
    ReverieEvalError
        If there is something to test and scipy is not installed.

    Examples
    --------
    >>> from reverie_eval import evaluate
    >>> samples = {"first": "mediocre", "second": "good"}
    >>> results = {
    ...     name: evaluate(f"demo/{sample}.json", split="val_unseen")
    ...     for name, sample in samples.items()
    ... }
    >>> table = results_table(results, baselines=["first"])
    >>> print("\n".join(table.to_markdown().splitlines()[:4]))
    | Method | SR | OSR | SPL | TL | RGS | RGSPL |
    | :--- | ---: | ---: | ---: | ---: | ---: | ---: |
    | first | 41.67 | 55.95 | 35.89 | 8.72 | 40.48 | 34.52 |
    | second | **80.95**† | **88.10**† | **72.88**† | 9.84 | **65.48**† | **57.22**† |
    """
    by_method = {name: _by_split(name, scores) for name, scores in results.items()}
    every = [scores for by_split in by_method.values() for scores in by_split.values()]
    _check_comparable(every)
    _check_names(by_method, baselines, published)
    metrics = _metrics(every)
    keys = [metric.key for metric in metrics if metric.better != "neither"]
    shown = next((each.intervals for each in every if each.intervals is not None), None)
    compared = [
        _Compared.of(
            {
                name: _with_intervals(each[split], shown)
                for name, each in by_method.items()
                if split in each
            },
            {each.method: each for each in published if each.split == split},
            keys,
            baselines,
        )
        for split in dict.fromkeys(scores.split for scores in every)
    ]
    above = dict.fromkeys(name for each in compared for name in each.published)
    rows = [
        [name, *(each.cell(name, metric) for each in compared for metric in metrics)]
        for name in (*above, *by_method)
    ]
    if above:
        rows.insert(len(above), [""] * len(rows[0]))
    families = [Group(family, len(list(several))) for family, several in groupby(metrics, _family)]
    splits = [
        Group(each.first.split.replace("_", " ").capitalize(), len(metrics)) for each in compared
    ]
    return Table(
        headings=["Method", *[metric.label for metric in metrics] * len(compared)],
        rows=rows,
        text_columns=frozenset({0}),
        # A single family needs no name.
        groups=[splits, families * len(compared)] if len(families) > 1 else [splits],
        caption=_caption(compared, metrics),
        notes=list(
            dict.fromkeys(
                note
                for each in compared
                for scores in each.scores.values()
                for note in _about(scores)
            )
        ),
        task=every[0].ground_truth.task,
    )


def methods_table(
    methods: Mapping[str, Mapping[str, float]],
    group: str,
    metrics: Sequence[Metric],
    caption: str,
) -> Table:
    """Return a table of methods' means by metric, the best shown of each in bold.

    Digits that are not shown do not count: of equal best cells, all are bold. The caption says what
    the numbers depend on, so that a reader can reproduce them.
    """
    columns = [_best_in_bold(metric, list(methods.values())) for metric in metrics]
    return Table(
        headings=["Method", *(metric.label for metric in metrics)],
        rows=[list(row) for row in zip(methods, *columns, strict=True)],
        text_columns=frozenset({0}),
        groups=[[Group(group, len(metrics))]],
        caption=caption,
    )


def _best_in_bold(metric: Metric, values: Sequence[Mapping[str, float]]) -> Sequence[str]:
    cells = [metric_cell(metric, it) for it in values]
    shown = [float(cell) for cell in cells if cell != MISSING]
    # One method is not the best of one.
    if metric.better == "neither" or len(shown) < 2:
        return cells
    best = max(shown) if metric.better == "higher" else min(shown)
    return [
        Number(cell, "bold") if cell != MISSING and float(cell) == best else cell for cell in cells
    ]


@dataclass(frozen=True, eq=False)
class _Compared:
    """The results on a split, and what is known of their differences."""

    scores: Mapping[str, Scored]
    published: Mapping[str, PublishedResult]
    leaders: Mapping[str, Sequence[str]]
    """The best and the second best by metric, as far as the data separate them."""
    marked: Mapping[str, "Comparison"]
    """The comparisons with the baselines, by their marks."""
    confidence: float | None
    """The confidence of the tests; None if nothing can be tested."""

    @classmethod
    def of(
        cls,
        scores: Mapping[str, Scored],
        published: Mapping[str, PublishedResult],
        keys: Sequence[str],
        baselines: Sequence[str],
    ) -> Self:
        """Compare the methods with each other, and with the baselines, by these metrics."""
        from reverie_eval.analysis import Comparison, check_scored_alike, leaders

        first = next(iter(scores.values()))
        for each in published.values():
            check_scored_alike(each, first)
        shown = first.intervals
        cluster = shown.cluster if shown else "target"
        if len(scores) < 2 or Intervals.why_not(first.ground_truth, cluster):
            return cls(scores, published, {}, {}, None)
        from reverie_eval.metrics.engine import IntervalEngine  # needs scipy

        confidence = shown.confidence if shown else IntervalEngine.of().confidence
        # Only what is shown is tested.
        tested = {
            name: replace(each, episodes={key: each.episodes[key] for key in keys if key in each})
            for name, each in scores.items()
        }
        return cls(
            scores,
            published,
            leaders(tested, keys, cluster, confidence=confidence),
            {
                mark: Comparison.of(tested, cluster, confidence=confidence, baseline=baseline)
                for mark, baseline in zip(_MARKS, baselines, strict=False)
                if baseline in tested
            },
            confidence,
        )

    @property
    def first(self) -> Scored:
        """Some of the scores: all are of one split."""
        return next(iter(self.scores.values()))

    def cell(self, name: str, metric: Metric) -> str:
        """Return the cell of a method, scored or published."""
        if name in self.published:
            return metric_cell(metric, self.published[name].scores)
        scores = self.scores.get(name)
        if scores is None or metric.key not in scores:
            return MISSING
        marks = [
            mark
            for mark, comparison in self.marked.items()
            # The baselines themselves are not marked: the table is about the others.
            if name not in {each.first for each in self.marked.values()}
            and metric.key in comparison[name]
            and comparison.is_significant(name, metric.key)
        ]
        value = metric.display(scores[metric.key])
        return Number(value, self._style(name, metric), "".join(marks), _interval(scores, metric))

    def _style(self, name: str, metric: Metric) -> Style:
        leading = self.leaders.get(metric.key, ())
        if name not in leading:
            return "plain"
        # Rounded, as papers print the others.
        value = metric.rounded(self.scores[name][metric.key])
        rivals = (each.scores.get(metric.key) for each in self.published.values())
        # Nobody leads who is not ahead of what is published, too.
        is_ahead = all(metric.is_better(value, rival) for rival in rivals if rival is not None)
        return _STYLES[leading.index(name)] if is_ahead else "plain"


def _interval(scores: Scored, metric: Metric) -> tuple[str, str] | None:
    """Return a mean's interval, by its ends.

    It need not be symmetric, and papers write a standard deviation after ±.
    """
    if scores.intervals is None or metric.key not in scores.intervals:
        return None
    interval = scores.intervals[metric.key]
    return metric.display(interval.low), metric.display(interval.high)


def _with_intervals(scores: Scored, shown: ClusterIntervals | None) -> Scored:
    """Return scores with intervals of the same kind as those that are shown, if any are."""
    own = scores.intervals
    if shown is None:
        return scores
    if own is None and isinstance(scores, Scores):
        return scores.with_intervals(shown.cluster, confidence=shown.confidence)
    if own is None or (own.cluster, own.confidence) != (shown.cluster, shown.confidence):
        raise ProtocolError(
            f"some intervals are {shown.label} over {shown.cluster}s and others are not; compute "
            "all of them alike"
        )
    return scores


def _metrics(every: Sequence[Scored]) -> Sequence[Metric]:
    """Return the columns as papers order them: navigation first, rates before lengths."""
    scored = {key for scores in every for key in scores}
    headline = every[0].ground_truth.task.headline_metrics(scored)
    return sorted(headline, key=lambda it: (_family(it) != "Navigation", it.better == "neither"))


def _family(metric: Metric) -> str:
    return "Navigation" if metric.needs <= _NAVIGATION else "Grounding"


def _by_split(name: str, scores: Scored | Sequence[Scored]) -> Mapping[str, Scored]:
    several = [scores] if isinstance(scores, Scored) else scores
    by_split = {each.split: each for each in several}
    if len(by_split) < len(several):
        raise ProtocolError(f"{name} has two scores of the same split; give each a name of its own")
    return by_split


def _check_names(
    names: Iterable[str], baselines: Sequence[str], published: Sequence[PublishedResult]
) -> None:
    known = list(names)
    for baseline in baselines:
        if baseline not in known:
            raise ProtocolError(f"no method is named {baseline!r}{did_you_mean(baseline, known)}")
    if len(baselines) > len(_MARKS):
        raise ProtocolError(
            f"{len(baselines)} baselines are given; there are marks for {len(_MARKS)}"
        )
    for each in published:
        if each.method in known:
            raise ProtocolError(f"{each.method} is both published and scored; rename one of them")


def _check_comparable(every: Sequence[Scored]) -> None:
    if not every:
        raise ProtocolError("a results table needs the scores of at least one method")
    scored_under = {
        (each.protocol.name, each.qualifier, each.ground_truth.header.dataset) for each in every
    }
    signatures = sorted({each.signature for each in every})
    # Two splits have two signatures, but not more.
    if len(scored_under) > 1 or len(signatures) > len({each.split for each in every}):
        raise ProtocolError(f"these scores are not comparable: {', '.join(signatures)}")


def _caption(compared: Sequence[_Compared], metrics: Sequence[Metric]) -> str:
    """Return a caption that stands alone: units, tests, intervals, sources, and signatures."""
    first = compared[0].first
    truth = first.ground_truth
    world = "the synthetic demo world" if truth.is_demo else truth.header.dataset
    # The headings have no units.
    lengths = [metric.label for metric in metrics if metric.unit == "metres"]
    unit = f"{', '.join(lengths)} in metres, all else in percent" if lengths else "In percent"
    parts = [dict(it.split(":", 1) for it in each.first.signature.split("|")) for each in compared]
    data = [
        f"{it['split']} {it['data']} ({it['n']} episodes"
        + (f" of subset {it['subset']})" if "subset" in it else ")")
        for it in parts
    ]
    protocol = " ".join(filter(None, (parts[0]["protocol"], first.qualifier)))
    shown = first.intervals
    sentences = [
        f"Results on {world}",
        unit,
        *_tests(compared),
        *([f"In parentheses: {shown.label} intervals over {_sampled(compared)}"] if shown else []),
        *_sources(compared),
        f"Scored by reverie-eval {parts[0]['version']}, protocol {protocol}; data: "
        + ", ".join(data),
    ]
    return " ".join(f"{each}." for each in sentences)


def _tests(compared: Sequence[_Compared]) -> Iterator[str]:
    """Say what is bold, underlined and marked, and by which test."""
    tested = next((each for each in compared if each.confidence is not None), None)
    if tested is None or tested.confidence is None:
        return
    sampled = _sampled(compared)
    test = "Student's t" if "runs" in sampled else "paired randomisation"
    rivals = ", and ahead of the published ones" if any(it.published for it in compared) else ""
    yield (
        f"Bold: significantly better than all others{rivals}; underlined: than all but the best "
        f"(p < {1 - tested.confidence:g}, {test} test over {sampled}, Holm's correction for all "
        "pairs in a column)"
    )
    for mark, comparison in tested.marked.items():
        several = f", Holm's correction for {len(comparison)} comparisons in a column"
        yield (
            f"{mark} differs significantly from {comparison.first} (the same test"
            f"{several if len(comparison) > 1 else ''})"
        )


def _sampled(compared: Sequence[_Compared]) -> str:
    """Return what tests and intervals take for a random choice."""
    shown = compared[0].first.intervals
    clusters = f"{shown.cluster if shown else 'target'}s"
    has_runs = any(not isinstance(it, Scores) for each in compared for it in each.scores.values())
    return f"runs and {clusters}" if has_runs else clusters


def _about(scores: Scored) -> Iterator[str]:
    yield scores.signature
    if scores.intervals is not None:
        yield f"{scores.split}: {scores.intervals.caption}"


def _sources(compared: Sequence[_Compared]) -> Iterator[str]:
    """Say where the published results are from."""
    papers: dict[str, list[str]] = {}
    for each in compared:
        for method, result in each.published.items():
            size = f", over {result.episodes:,} episodes" if result.episodes else ""
            papers.setdefault(f"{result.paper}{size}", []).append(method)
    if papers:
        texts = [f"{', '.join(dict.fromkeys(it))} ({paper})" for paper, it in papers.items()]
        yield f"Above the line, as published, without tests: {'; '.join(texts)}"
