"""A comparison as people read it: scores, differences, and a sentence for each."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict

from reverie_eval.analysis import Comparison, Difference, p_text
from reverie_eval.metrics import Metric
from reverie_eval.reporting._grids import Grid, aligned, show_grid
from reverie_eval.reporting._html_tables import table_html
from reverie_eval.reporting._latex import comments
from reverie_eval.reporting._results import results_table
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.scoring import Intervals
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from rich.console import Console


class ComparisonReport(BaseModel):
    """Several submissions, each but the first compared with the first."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True, extra="forbid")

    first: str
    """The name of the submission that the others are compared with."""
    submissions: dict[str, ScoreReport]
    """By name, including the first."""
    intervals: dict[str, str]
    """How the intervals of the differences were computed, by the names of the others."""
    differences: dict[str, dict[str, Difference]]
    """By the names of the others and the keys of the metrics."""
    sentences: dict[str, str]
    """Whether each of the others is better, in a sentence about the primary metric."""


def comparison_report(comparison: Comparison) -> ComparisonReport:
    """Return a comparison as a report for programs."""
    return ComparisonReport(
        first=comparison.first,
        submissions={name: each.to_report() for name, each in comparison.scores.items()},
        intervals={name: each.caption for name, each in comparison.intervals.items()},
        differences={name: dict(each) for name, each in comparison.items()},
        sentences={name: comparison.sentence(name) for name in comparison},
    )


_WON = (
    "episodes that only the one, or only the other, has; McNemar's test takes them for independent"
)


def comparison_text(comparison: Comparison) -> str:
    """Lay a comparison out in aligned columns, for a pipe or a file."""
    return "\n".join(
        [aligned(grid_of(comparison)), "", *sentences(comparison), "", *captions(comparison)]
    )


def show_comparison(comparison: Comparison, console: "Console") -> None:
    """Print a comparison on a terminal."""
    show_grid(grid_of(comparison), console)
    for sentence in sentences(comparison):
        console.print(sentence, style="bold", markup=False, highlight=False)
    console.print()
    for caption in captions(comparison):
        console.print(caption, style="dim", markup=False, highlight=False, soft_wrap=True)


def comparison_html(comparison: Comparison) -> str:
    """Show a comparison on a page or in a notebook: sentences, the table, captions below it."""
    from html import escape

    said = "<br>".join(map(escape, sentences(comparison)))
    return f"<p><strong>{said}</strong></p>{table_html(grid_of(comparison), captions(comparison))}"


def comparison_markdown(comparison: Comparison) -> str:
    """Show the scores as a paper does, and below them a sentence for each difference."""
    table = results_table(comparison.scores).markdown()
    return "\n\n".join([table, *sentences(comparison)])


def comparison_latex(comparison: Comparison) -> str:
    """Show the scores as a paper does; what else is known of them stands above as comments."""
    said = comments([*sentences(comparison), *captions(comparison)])
    return "\n".join([*said, results_table(comparison.scores).latex()])


def grid_of(comparison: Comparison) -> Grid:
    """Word the scores, a row each, and below them the differences from the first."""
    metrics = [
        metric
        for metric in comparison.scores[comparison.first].headline
        if all(metric.key in scores for scores in comparison.scores.values())
    ]
    scores = [
        [name, *(metric.display(scores[metric.key]) for metric in metrics)]
        for name, scores in comparison.scores.items()
    ]
    differences = [row for name in comparison for row in _rows(comparison, name, metrics)]
    headings = ["", *(metric.heading for metric in metrics)]
    return Grid(headings, [*scores, *differences], frozenset({0}))


def _rows(comparison: Comparison, name: str, metrics: Sequence[Metric]) -> Iterator[Sequence[str]]:
    """Word how one submission differs from the first, below an empty row."""
    label = comparison.intervals[name].label
    pairs = [(metric, comparison[name][metric.key]) for metric in metrics]
    yield [""] * (1 + len(metrics))
    yield [f"{name} - {comparison.first}", *(_signed(m, d.mean) for m, d in pairs)]
    yield [f"{label} low", *(_signed(m, d.interval.low) for m, d in pairs)]
    yield [f"{label} high", *(_signed(m, d.interval.high) for m, d in pairs)]
    yield ["p", *(p_text(d.p_value).removeprefix("p ").removeprefix("= ") for _, d in pairs)]
    yield ["won : lost", *(_won(m, d) for m, d in pairs)]
    yield ["McNemar's p", *(_mcnemar(d) for _, d in pairs)]


def _signed(metric: Metric, value: float) -> str:
    shown = metric.display(value)
    return shown if shown.startswith("-") else f"+{shown}"


def _won(metric: Metric, difference: Difference) -> str:
    return f"{difference.higher} : {difference.lower}" if metric.is_binary else "-"


def _mcnemar(difference: Difference) -> str:
    if difference.mcnemar_p is None:
        return "-"
    return p_text(difference.mcnemar_p).removeprefix("p ").removeprefix("= ")


def sentences(comparison: Comparison) -> Sequence[str]:
    """Say of each submission whether it is better than the first."""
    return [f"{comparison.sentence(name)}." for name in comparison]


def methods(comparison: Comparison) -> Sequence[str]:
    """Say how intervals, p-values and counts came about."""
    drawn = next(iter(comparison.intervals.values()))
    corrected = ", corrected by Holm's method" if len(comparison) > 1 else ""
    return [
        drawn.caption,
        f"p: paired randomisation test, {drawn.by}s swapped whole{corrected}{_least_p(drawn)}",
        f"won : lost: {_WON}",
    ]


def _least_p(drawn: Intervals) -> str:
    """Say how small a p-value can be, where that is not small: two of all swaps come as far."""
    least = 2.0 ** (1 - drawn.n_clusters)
    if least < 1 - drawn.confidence:
        return ""
    return f"; of {count_text(drawn.n_clusters, drawn.by)} it is about {least:.2g} at least"


def captions(comparison: Comparison) -> Sequence[str]:
    """Say what the numbers depend on."""
    first = comparison.scores[comparison.first]
    return [
        first.signature,
        *methods(comparison),
        f"ground truth: {first.ground_truth.provenance}",
        *(
            f"note on {name}: {note}"
            for name, each in comparison.scores.items()
            for note in each.notes
        ),
    ]
