"""Scores as a table, in each of the formats of ``--format``, and the values of every episode."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, TextIO

from reverie_eval.metrics import CATALOGUE, Metric, table_metrics
from reverie_eval.reporting._table import MARK, MISSING, Table, print_table
from reverie_eval.scoring import Scores

if TYPE_CHECKING:
    from rich.console import Console


def score_table(results: Sequence[Scores]) -> Table:
    """Return a submission's scores, a row per protocol, and two more for interval bounds.

    With more than one row, a first column names them, and values that differ from the first
    protocol's are marked.
    """
    first = results[0]
    metrics = table_metrics(first.keys())
    has_several = len(results) > 1
    has_names = has_several or first.intervals is not None
    named = [row for scores in results for row in _rows(scores, first, metrics)]
    is_marked = any(cell.endswith(MARK) for _, *cells in named for cell in cells)
    return Table(
        headings=["protocol" if has_several else ""] * has_names + [m.heading for m in metrics],
        rows=named if has_names else [cells for _, *cells in named],
        text_columns=frozenset({0} if has_names else ()),
        notes=[
            *([f"{MARK} differs from {_name(first)}", ""] if is_marked else []),
            *(scores.signature for scores in results),
            *([] if first.intervals is None else [first.intervals.caption]),
            f"ground truth: {first.ground_truth.provenance}",
            *(f"note: {note}" for note in _notes(results)),
        ],
    )


def print_scores(console: "Console", results: Sequence[Scores]) -> None:
    """Print the score table on a terminal, with the metrics below each other if it is narrow."""
    table = score_table(results)
    print_table(console, table, table.stacked())


def scores_csv(results: Sequence[Scores]) -> str:
    """Return a row per protocol: every metric by its key, unrounded, and the signature."""
    has_intervals = results[0].intervals is not None
    bounds = [f"{key}_{end}" for key in CATALOGUE for end in ("low", "high")] * has_intervals
    keys = [*CATALOGUE, *bounds]
    values = [(scores.to_dict(), scores.signature) for scores in results]
    rows = [[*(str(row.get(key, "")) for key in keys), signature] for row, signature in values]
    return Table([*keys, "signature"], rows).to_csv()


def scores_json(results: Sequence[Scores]) -> str:
    """Return the score report as JSON; with several results, a list of reports."""
    reports = [scores.to_report().model_dump_json(indent=2) for scores in results]
    return reports[0] if len(reports) == 1 else "[\n" + ",\n".join(reports) + "\n]"


FORMATS: Mapping[str, Callable[[Sequence[Scores]], str]] = MappingProxyType(
    {
        "table": lambda results: score_table(results).to_text(),
        "json": scores_json,
        "csv": scores_csv,
        "markdown": lambda results: score_table(results).to_markdown(),
        "latex": lambda results: score_table(results).to_latex(),
    }
)
"""What ``--format`` offers."""


def write_episodes(scores: Scores, file: TextIO) -> None:
    """Write the episode table as CSV: a row per episode, a column per metric, unrounded.

    If answers are boxes, a last column gives the outcome of each.
    """
    import csv

    columns = {key: column.tolist() for key, column in scores.episodes.items()}
    if scores.boxes is not None:
        columns["box_outcome"] = scores.box_outcomes
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["instr_id", *columns])
    writer.writerows(zip(scores.instr_ids, *columns.values(), strict=True))


def episode_table(scores: Scores) -> Table:
    """Return the score table's metrics for every episode, a row each."""
    metrics = [metric for metric in table_metrics(scores.keys()) if metric.key in scores]
    columns = [map(metric.display, scores.episodes[metric.key].tolist()) for metric in metrics]
    return Table(
        headings=["instr_id", *(metric.heading for metric in metrics)],
        rows=list(zip(scores.instr_ids, *columns, strict=True)),
        text_columns=frozenset({0}),
        notes=[scores.signature],
    )


def episodes_json(scores: Scores) -> str:
    """Return every metric of every episode as JSON, unrounded, with the signature."""
    import json

    columns = {key: column.tolist() for key, column in scores.episodes.items()}
    episodes = [
        dict(zip(("instr_id", *columns), row, strict=True))
        for row in zip(scores.instr_ids, *columns.values(), strict=True)
    ]
    return json.dumps({"signature": scores.signature, "episodes": episodes}, indent=1)


def _rows(scores: Scores, first: Scores, metrics: Sequence[Metric]) -> Iterator[Sequence[str]]:
    """Yield the named row of the means and, if there are intervals, those of their bounds."""
    yield [_name(scores), *(_mean(metric, scores, first) for metric in metrics)]
    if scores.intervals is None:
        return
    for end in ("low", "high"):
        bounds = [getattr(scores.intervals.get(metric.key), end, None) for metric in metrics]
        cells = [
            MISSING if bound is None else metric.display(bound)
            for metric, bound in zip(metrics, bounds, strict=True)
        ]
        yield [f"{scores.intervals.label} {end}", *cells]


def _mean(metric: Metric, scores: Scores, first: Scores) -> str:
    if metric.key not in scores:
        return MISSING
    value, reference = metric.display(scores[metric.key]), metric.display(first[metric.key])
    return value if value == reference else value + MARK


def _notes(results: Sequence[Scores]) -> Iterable[str]:
    """Return the notes on every protocol once; those on another reading would be ambiguous."""
    alike = (scores for scores in results if scores.qualifier == results[0].qualifier)
    return dict.fromkeys(note for scores in alike for note in scores.notes)


def _name(scores: Scores) -> str:
    return " ".join(filter(None, (scores.protocol.name, scores.qualifier)))
