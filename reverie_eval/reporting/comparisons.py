"""Comparisons of submissions, and with published means: scores, differences, and a sentence."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from pydantic import Field

from reverie_eval.analysis import (
    SMALLEST_SHOWN_P,
    Against,
    Comparison,
    CostDifference,
    Difference,
    DifferenceOfMeans,
    logged,
    p_text,
)
from reverie_eval.errors import ProtocolError
from reverie_eval.logs import COSTS, cost_number, cost_text, mean_costs
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.results import results_table
from reverie_eval.reporting.scores import table_of_scores
from reverie_eval.reporting.tables import MISSING, Printout, Table, metric_cells
from reverie_eval.schemas.report import Report, RunsReport, ScoreReport
from reverie_eval.scoring import Intervals, Scores
from reverie_eval.tasks import Task
from reverie_eval.text import count_text

_Cell = Callable[[Metric, Difference | DifferenceOfMeans], str]
"""What makes a cell about the difference in a metric."""


class ComparisonReport(Report):
    """Several submissions, the others compared with the first."""

    first: str
    """The name of the submission that the others are compared with."""
    submissions: dict[str, ScoreReport | RunsReport]
    """The report of every submission, the first among them, by name."""
    intervals: dict[str, str]
    """How the intervals of the differences were computed, by the names of the others."""
    differences: dict[str, dict[str, Difference]]
    """The difference of each other submission from the first, by its name and the metric's key."""
    sentences: dict[str, str]
    """Whether each of the others is better, in a sentence about the primary metric."""
    costs: dict[str, dict[str, CostDifference]] = Field({}, exclude_if=lambda costs: not costs)
    """What an episode cost in the runs that have a log, by the names of the others and by cost."""


def comparison_report(comparison: Comparison) -> ComparisonReport:
    """Return a comparison as a report for programs."""
    return ComparisonReport(
        first=comparison.first,
        submissions={name: each.to_report() for name, each in comparison.scores.items()},
        intervals={name: each.caption for name, each in comparison.intervals.items()},
        differences={name: dict(each) for name, each in comparison.items()},
        sentences={name: comparison.sentence(name) for name in comparison},
        costs={name: dict(each) for name, each in comparison.costs.items()},
    )


class AgainstReport(Report):
    """A submission, or several runs, compared with published means."""

    submission: ScoreReport | RunsReport
    published: dict[str, float]
    """The published means by metric, in the units of the scores."""
    name: str
    """The method and its paper, or ``the published mean``."""
    episodes: int
    """The number of episodes that the published means are over."""
    differences: dict[str, DifferenceOfMeans]
    """By metric: the submission's mean minus the published one, on other episodes of the kind."""
    on_split: dict[str, DifferenceOfMeans]
    """By metric: that on all episodes of the split itself; empty if both means are over all of
    these."""
    intervals: str
    """How the intervals were computed."""
    assumptions: list[str]
    """What could not be checked."""
    sentence: str
    """Whether the submission is better, in a sentence about one metric."""


def against_report(compared: Against) -> AgainstReport:
    """Return a comparison with published means as a report for programs."""
    return AgainstReport(
        submission=compared.scored.to_report(),
        published=dict(compared.published),
        name=compared.name,
        episodes=compared.n_published,
        differences=dict(compared),
        on_split=dict(compared.on_split),
        intervals=compared.intervals.caption,
        assumptions=list(compared.assumptions),
        sentence=compared.sentence,
    )


def against_printout(compared: Against, name: str) -> Printout:
    """Return a comparison with published means in each format; ``name`` is the submission's."""
    return Printout.of_table(
        lambda: against_table(compared, name),
        json=lambda: compared.to_report().model_dump_json(indent=2),
        csv=lambda: against_table(compared, name).to_csv(),
    )


def against_table(compared: Against, name: str = "these scores") -> Table:
    """Return the scores, the published means, and the differences with their intervals."""
    metrics = [CATALOGUE[key] for key in compared]
    rows = [
        [name, *metric_cells(metrics, compared.scored)],
        ["published", *metric_cells(metrics, compared.published)],
        [""] * (1 + len(metrics)),
        ["difference", *(signed(metric, compared[metric.key].mean) for metric in metrics)],
        *_rows_against(compared, compared, metrics, ""),
        *_rows_against(compared, compared.on_split, metrics, f" on {compared.scored.split}"),
    ]
    return table_of_scores(
        compared.scored,
        [""],
        metrics,
        rows,
        about=[compared.scored.signature, compared.intervals.caption, *compared.assumptions],
        notes=[f"note on {name}: {note}" for note in compared.scored.notes],
        findings=[f"{compared.sentence}."],
    )


def _rows_against(
    compared: Against,
    differences: Mapping[str, DifferenceOfMeans],
    metrics: Sequence[Metric],
    where: str,
) -> Iterator[Sequence[str]]:
    if not differences:
        return
    for title, cell in _cells_of_interval(compared.intervals.label).items():
        yield [f"{title}{where}", *(cell(metric, differences[metric.key]) for metric in metrics)]


def _cells_of_interval(label: str) -> Mapping[str, _Cell]:
    """Return the titles of the rows on how sure a difference is, and what makes their cells."""
    return {
        f"{label} low": lambda metric, found: signed(metric, found.interval.low),
        f"{label} high": lambda metric, found: signed(metric, found.interval.high),
        "p": lambda _, found: _p_cell(found.p_value),
    }


_WON = (
    "won : lost: episodes that only one submission got right; McNemar's test treats them as "
    "independent"
)


def comparison_printout(comparison: Comparison) -> Printout:
    """Return a comparison in each format; papers get the scores, with the differences as notes."""

    def paper() -> Table:
        # A paper's table has no room for differences; as notes, they become comments of its LaTeX.
        notes = [*sentences(comparison), *comparison_table(comparison).notes]
        return replace(results_table(comparison.scores), notes=notes)

    def table() -> Table:
        narrow = _ranked_table(comparison, is_narrow=True) if len(comparison) > 1 else None
        return replace(comparison_table(comparison), narrow=narrow)

    return Printout.of_table(
        table,
        json=lambda: comparison.to_report().model_dump_json(indent=2),
        csv=lambda: comparison.to_pandas().to_csv().removesuffix("\n"),
        papers={"markdown": paper, "latex": paper},
    )


def comparison_table(comparison: Comparison) -> Table:
    """Return two submissions' scores and differences, or a row for each of several submissions."""
    return _pair_table(comparison) if len(comparison) == 1 else _ranked_table(comparison)


def _pair_table(comparison: Comparison) -> Table:
    """Return the scores, a row per submission, and below them the differences from the first."""
    metrics = _headline(comparison)
    scores = [[name, *metric_cells(metrics, each)] for name, each in comparison.scores.items()]
    differences = [row for name in comparison for row in _rows(comparison, name, metrics)]
    return _table(comparison, metrics, [*scores, *differences])


def _ranked_table(comparison: Comparison, *, is_narrow: bool = False) -> Table:
    """Return a row per submission, best first: scores, and the difference in the primary metric.

    The narrow table has no other metrics.
    """
    primary = _ranking_metric(comparison)
    shown = [primary] if is_narrow else _headline(comparison)
    # Those without the metric come last; `sorted` keeps the order of equal scores.
    ranked = sorted(
        comparison.scores.items(), key=lambda each: -each[1].get(primary.key, -math.inf)
    )
    rows = [
        [name, *metric_cells(shown, scores), *_difference_cells(comparison, name, primary)]
        for name, scores in ranked
    ]
    return _table(comparison, shown, rows, ("diff.", "low", "high", "p", "verdict"))


def _table(
    comparison: Comparison,
    metrics: Sequence[Metric],
    rows: Sequence[Sequence[str]],
    further: Sequence[str] = (),
) -> Table:
    first = comparison.scores[comparison.first]
    return table_of_scores(
        first,
        [""],
        metrics,
        rows,
        further=further,
        about=[first.signature, *procedures(comparison)],
        notes=[
            *(
                f"note on {name}: {note}"
                for name, each in comparison.scores.items()
                for note in each.notes
            ),
            *cost_notes(comparison),
        ],
        findings=_findings(comparison),
    )


def cost_table(runs: Mapping[str, Scores]) -> Table:
    """Return what an episode cost on average, a row per run."""
    means = {name: mean_costs(run.costs) for name, run in runs.items()}
    keys = [key for key in COSTS if not all(np.isnan(it.costs[key]).all() for it in runs.values())]
    rows = [
        [name, *("unknown" if it is None else cost_number(it) for it in map(mean.get, keys))]
        for name, mean in means.items()
    ]
    return Table(["", *(COSTS[key] for key in keys)], rows, frozenset({0}))


def cost_notes(comparison: Comparison) -> Iterator[str]:
    """Say how costs differ from the first's, and how surely each run is on the Pareto front."""
    for name, differences in comparison.costs.items():
        parts = [
            f"{'+' * (it.mean > 0)}{cost_text(key, it.mean)} ({cost_number(it.interval.low)} to "
            f"{cost_number(it.interval.high)})"
            for key, it in differences.items()
        ]
        yield f"cost per episode, {name} - {comparison.first}: {', '.join(parts)}"
    if len(logged(comparison.scores)) > 1:
        try:
            yield repr(comparison.front())
        except ProtocolError as error:
            yield f"no Pareto front: {error}"


def _task(comparison: Comparison) -> Task:
    return comparison.scores[comparison.first].ground_truth.task


def _headline(comparison: Comparison) -> Sequence[Metric]:
    scored = {key for scores in comparison.scores.values() for key in scores}
    return _task(comparison).headline_metrics(scored)


def _ranking_metric(comparison: Comparison) -> Metric:
    return _task(comparison).primary_metric(comparison.scores[comparison.first])


def _difference_cells(comparison: Comparison, name: str, metric: Metric) -> Sequence[str]:
    """Return the difference from the first in a metric, its interval, p and verdict."""
    if name == comparison.first:
        return [*[MISSING] * 4, "baseline"]
    # A file without answers is compared in navigation alone.
    if metric.key not in comparison[name]:
        return [MISSING] * 5
    found = comparison[name][metric.key]
    values = (found.mean, found.interval.low, found.interval.high)
    shown = (signed(metric, value) for value in values)
    verdict = comparison.verdict(name)
    return [*shown, _p_cell(found.p_value), "n.s." if verdict == "not significant" else verdict]


def _findings(comparison: Comparison) -> Sequence[str]:
    """Return a sentence about the other submission or, for several, what the columns mean."""
    if len(comparison) == 1:
        return sentences(comparison)
    metric, label = _ranking_metric(comparison), next(iter(comparison.intervals.values())).label
    not_in_table = [
        f"{comparison.sentence(name)}." for name in comparison if metric.key not in comparison[name]
    ]
    columns = (
        f"diff.: {metric.label} minus that of {comparison.first}; low, high: its {label} interval; "
        "n.s.: no significant difference."
    )
    return [columns, *not_in_table]


def sentences(comparison: Comparison) -> Sequence[str]:
    """Say for each other submission whether it is better than the first."""
    return [f"{comparison.sentence(name)}." for name in comparison]


def procedures(comparison: Comparison) -> Sequence[str]:
    """Return how intervals, p-values and counts were computed."""
    resampled = next(iter(comparison.intervals.values()))
    corrected = ", corrected by Holm's method" if len(comparison) > 1 else ""
    if comparison.pairs and len(comparison) > 1:
        corrected += f" for all {comparison.pairs:,} pairs, among which the best was chosen"
    # Runs are tested by Student's t, files by swaps.
    if not isinstance(resampled, Intervals):
        lone = [name for name, each in comparison.scores.items() if isinstance(each, Scores)]
        fixed = f"; {', '.join(lone)}: one run, without variance between runs" if lone else ""
        captions = dict.fromkeys(each.caption for each in comparison.intervals.values())
        return [*captions, f"p: Student's t test with the same variances{corrected}{fixed}"]
    swaps = f"{comparison.swaps:,} random swaps of whole {resampled.cluster}s"
    test = f"p: paired randomisation test by {swaps}, seed {resampled.seed}"
    return [
        resampled.caption,
        f"{test}{corrected}{_smallest_p(comparison)}",
        *([_WON] if len(comparison) == 1 else []),
    ]


def _rows(comparison: Comparison, name: str, metrics: Sequence[Metric]) -> Iterator[Sequence[str]]:
    """Yield the rows on how one submission differs from the first, below an empty row."""
    rows: dict[str, Callable[[Metric, Difference], str]] = {
        f"{name} - {comparison.first}": lambda metric, found: signed(metric, found.mean),
        **_cells_of_interval(comparison.intervals[name].label),
    }
    # Of means over runs, no episode is simply right or wrong.
    if isinstance(comparison.intervals[name], Intervals):
        rows |= {
            "won : lost": _won_and_lost,
            "McNemar's p": lambda _, found: _p_cell(found.mcnemar_p),
        }
    pairs = [(metric, comparison[name].get(metric.key)) for metric in metrics]
    yield [""] * (1 + len(metrics))
    for title, cell in rows.items():
        yield [title, *(MISSING if found is None else cell(m, found) for m, found in pairs)]


def _won_and_lost(metric: Metric, found: Difference) -> str:
    return f"{found.higher} : {found.lower}" if metric.is_binary else MISSING


def signed(metric: Metric, value: float) -> str:
    """Format a difference with its sign; one that rounds to 0 has none."""
    text = metric.display(value)
    # Asked of the text: a small difference may be shown as 0.00.
    return text if float(text) <= 0 else f"+{text}"


def _p_cell(p_value: float | None) -> str:
    if p_value is None:
        return MISSING
    return p_text(p_value).removeprefix("p ").removeprefix("= ")


def _smallest_p(comparison: Comparison) -> str:
    """Return a warning if even the largest difference could not have the smallest shown p-value."""
    if comparison.smallest_p < SMALLEST_SHOWN_P:
        return ""
    resampled = next(iter(comparison.intervals.values()))
    clusters = count_text(resampled.n_clusters, resampled.cluster)
    n_comparisons = comparison.pairs or len(comparison)
    among = f" and {n_comparisons:,} comparisons" if n_comparisons > 1 else ""
    return f"; with {clusters}{among}, p is at least about {comparison.smallest_p:.2g}"
