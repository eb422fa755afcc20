"""Several runs of a method: each run, their mean, its interval, and the sources of its variance."""

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from reverie_eval.analysis import Runs
from reverie_eval.metrics import METRICS, Metric
from reverie_eval.reporting._results import results_table
from reverie_eval.reporting._table import Table, metric_cells

_DUE_TO_RUNS = (
    "due to runs: the part of the mean's variance that more runs would reduce; the rest is due to "
    "the choice of episodes"
)
_Row = tuple[str, Callable[[Metric], float], Callable[[Metric, float], str]]
"""A row's name, its value for a metric, and how the value is shown."""


def runs_table(runs: Runs) -> Table:
    """Return a row per run, and below them the mean, its interval and its variance."""
    metrics = runs.ground_truth.task.table_metrics(runs.keys())
    shown = [m for m in metrics if m.key in runs]
    each_run = [[name, *metric_cells(shown, scores)] for name, scores in runs.runs.items()]
    summary = [[name, *(text(m, value(m)) for m in shown)] for name, value, text in _rows(runs)]
    return Table(
        headings=["", *(m.heading for m in shown)],
        rows=[*each_run, [""] * (1 + len(shown)), *summary],
        text_columns=frozenset({0}),
        notes=[
            runs.signature,
            runs.intervals.caption,
            _DUE_TO_RUNS,
            f"ground truth: {runs.ground_truth.provenance}",
            *(f"note on {note}" for note in runs.notes),
        ],
        task=runs.ground_truth.task,
    )


def runs_csv(runs: Runs) -> str:
    """Return the same rows as CSV: every metric by its key, unrounded, and the signature."""
    keys = runs.ground_truth.task.metrics
    each_run = [
        [name, *(str(scores.get(key, "")) for key in keys), runs.signature]
        for name, scores in runs.runs.items()
    ]
    summary = [
        [
            name,
            *(str(value(METRICS[key])) if key in runs else "" for key in keys),
            runs.signature,
        ]
        for name, value, _ in _rows(runs)
    ]
    return Table(["run", *keys, "signature"], [*each_run, *summary]).to_csv()


RUNS_FORMATS: Mapping[str, Callable[[str, Runs], str]] = MappingProxyType(
    {
        "table": lambda _, runs: runs_table(runs).to_text(),
        "json": lambda _, runs: runs.to_report().model_dump_json(indent=2),
        "csv": lambda _, runs: runs_csv(runs),
        "markdown": lambda _, runs: runs_table(runs).to_markdown(),
        "latex": lambda name, runs: results_table({name: runs}).to_latex(),
    }
)
"""What ``--format`` offers for the runs of a method, given its name."""


def _rows(runs: Runs) -> Iterator[_Row]:
    """Yield the rows below those of the runs."""
    intervals, display = runs.intervals, Metric.display
    yield "mean", lambda metric: runs[metric.key], display
    yield f"{intervals.label} low", lambda metric: intervals[metric.key].low, display
    yield f"{intervals.label} high", lambda metric: intervals[metric.key].high, display
    yield "standard deviation", lambda metric: runs.deviation(metric.key), display
    yield "due to runs", lambda metric: intervals.run_shares[metric.key], _percent


def _percent(_: Metric, share: float) -> str:
    return f"{100 * share:.0f} %"
