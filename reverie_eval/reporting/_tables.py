"""Score tables as text: plain, Markdown, LaTeX, CSV and JSON, each with its signature.

A table has a row per protocol, and two more for the ends of confidence intervals where there are
any. With more than one row, a first column names them, and values that differ from the first
protocol's are marked.
"""

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, TextIO

from reverie_eval.metrics import CATALOGUE, Metric, table_metrics
from reverie_eval.reporting._latex import comments, escaped, table_row
from reverie_eval.scoring import Scores

if TYPE_CHECKING:
    from reverie_eval.schemas.report import ScoreReport


NOT_SCORED = "-"
MARK = "*"


@dataclass(frozen=True, slots=True)
class Table:
    """A score table in words, ready to be laid out."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    captions: Sequence[str]
    """What the numbers depend on; the signature comes first."""
    has_names: bool
    """Whether the first column names the rows."""


def table_of(results: Sequence[Scores]) -> Table:
    """Word a submission's scores, under one protocol or several."""
    first = results[0]
    metrics = table_metrics(first.keys())
    several = len(results) > 1
    has_names = several or first.intervals is not None
    named = [row for scores in results for row in _rows(scores, first, metrics)]
    marked = any(cell.endswith(MARK) for _, *cells in named for cell in cells)
    return Table(
        headings=["protocol" if several else ""] * has_names + [m.heading for m in metrics],
        rows=named if has_names else [cells for _, *cells in named],
        captions=[
            *([f"{MARK} differs from {_name(first)}", ""] if marked else []),
            *(scores.signature for scores in results),
            *([] if first.intervals is None else [first.intervals.caption]),
            f"ground truth: {first.ground_truth.provenance}",
            *(f"note: {note}" for note in first.notes),
        ],
        has_names=has_names,
    )


def table_of_report(report: "ScoreReport", provenance: str) -> Table:
    """Word a report as its scores were worded where it was made, with its notes."""
    metrics = table_metrics(report.scores)
    return Table(
        headings=[metric.heading for metric in metrics],
        rows=[[metric.display(report.scores[metric.key]) for metric in metrics]],
        captions=[
            report.signature,
            f"ground truth: {provenance}",
            *(f"note: {note}" for note in report.notes),
        ],
        has_names=False,
    )


def plain(results: Sequence[Scores]) -> str:
    """Aligned columns without decoration, for a pipe or a file."""
    return laid_out(table_of(results))


def laid_out(table: Table) -> str:
    """Lay out a table that is in words already, as :func:`plain` does."""
    cells = [table.headings, *table.rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(map(_justify(table), row, widths, range(len(row)))) for row in cells]
    return "\n".join([*(line.rstrip() for line in lines), "", *table.captions])


def markdown(results: Sequence[Scores]) -> str:
    """Render a GitHub-flavoured table with the captions below."""
    table = table_of(results)
    rule = [":---"] * table.has_names + ["---:"] * (len(table.headings) - table.has_names)
    lines = ["| " + " | ".join(row) + " |" for row in (table.headings, rule, *table.rows)]
    captions = [caption.replace(MARK, rf"\{MARK}") for caption in table.captions if caption]
    return "\n".join(lines).replace(f"{MARK} |", rf"\{MARK} |") + "\n\n" + "\n\n".join(captions)


def latex(results: Sequence[Scores]) -> str:
    r"""Render a ``tabular`` for the booktabs package, with the captions as comments."""
    table = table_of(results)
    columns = "l" * table.has_names + "r" * (len(table.headings) - table.has_names)
    headings, *rows = (table_row(map(escaped, row)) for row in (table.headings, *table.rows))
    lines = [
        *comments(table.captions),
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        headings,
        r"\midrule",
        *rows,
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines)


def csv_table(results: Sequence[Scores]) -> str:
    """One row per protocol of every metric by its key, unrounded, beside the signature."""
    import csv

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    has_intervals = results[0].intervals is not None
    ends = [f"{key}_{end}" for key in CATALOGUE for end in ("low", "high")] * has_intervals
    writer.writerow([*CATALOGUE, *ends, "signature"])
    for scores in results:
        flat = scores.to_dict()
        writer.writerow([*(flat.get(key, "") for key in (*CATALOGUE, *ends)), scores.signature])
    return text.getvalue().rstrip("\n")


def json_report(results: Sequence[Scores]) -> str:
    """Render the score report as JSON; of several, a list."""
    reports = [scores.to_report().model_dump_json(indent=2) for scores in results]
    return reports[0] if len(reports) == 1 else "[\n" + ",\n".join(reports) + "\n]"


def write_episodes(scores: Scores, file: TextIO) -> None:
    """Write the episode table as CSV: a row per episode, a column per metric, unrounded.

    With answers that are boxes, a last column says what became of each.
    """
    import csv

    columns = {key: column.tolist() for key, column in scores.episodes.items()}
    if scores.boxes is not None:
        columns["box_outcome"] = scores.box_outcomes
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["instr_id", *columns])
    writer.writerows(zip(scores.instr_ids, *columns.values(), strict=True))


def _rows(scores: Scores, first: Scores, metrics: Sequence[Metric]) -> Iterator[Sequence[str]]:
    """Word the means and, if there are any, their intervals, each row with its name."""
    yield [_name(scores), *(_cell(metric, scores, first) for metric in metrics)]
    if scores.intervals is None:
        return
    for end in ("low", "high"):
        bounds = [getattr(scores.intervals.get(metric.key), end, None) for metric in metrics]
        cells = map(_bound, metrics, bounds)
        yield [f"{scores.intervals.label} {end}", *cells]


def _bound(metric: Metric, bound: float | None) -> str:
    return NOT_SCORED if bound is None else metric.display(bound)


def _name(scores: Scores) -> str:
    return " ".join(filter(None, (scores.protocol.name, scores.qualifier)))


def _cell(metric: Metric, scores: Scores, first: Scores) -> str:
    if metric.key not in scores:
        return NOT_SCORED
    value, reference = metric.display(scores[metric.key]), metric.display(first[metric.key])
    return value if value == reference else value + MARK


def _justify(table: Table) -> Callable[[str, int, int], str]:
    """Names to the left, numbers to the right, with the decimal points in line."""
    marked = {
        column
        for column in range(len(table.headings))
        if any(row[column].endswith(MARK) for row in table.rows)
    }

    def justify(text: str, width: int, column: int) -> str:
        if column == 0 and table.has_names:
            return text.ljust(width)
        unmarked = column in marked and not text.endswith(MARK)
        return (text + " " if unmarked else text).rjust(width)

    return justify


FORMATS: Mapping[str, Callable[[Sequence[Scores]], str]] = MappingProxyType(
    {
        "table": plain,
        "json": json_report,
        "csv": csv_table,
        "markdown": markdown,
        "latex": latex,
    }
)
"""What ``--format`` offers."""
