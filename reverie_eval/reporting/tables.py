"""Score tables as text: plain, Markdown, LaTeX, CSV and JSON, each with its signature."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TextIO

from reverie_eval.scores import Scores


def plain(scores: Scores) -> str:
    """Aligned columns without decoration, for a pipe or a file."""
    cells = list(zip(*_headings_and_values(scores), strict=True))
    widths = [max(map(len, column)) for column in cells]
    rows = [
        "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
        for row in _headings_and_values(scores)
    ]
    return "\n".join([*rows, "", *captions(scores)])


def markdown(scores: Scores) -> str:
    """Render a GitHub-flavoured table with the captions below."""
    headings, values = _headings_and_values(scores)
    rows = [headings, ["---:"] * len(headings), values]
    table = ["| " + " | ".join(row) + " |" for row in rows]
    signature, *others = captions(scores)
    return "\n\n".join(["\n".join(table), f"`{signature}`", *others])


def latex(scores: Scores) -> str:
    r"""Render a ``tabular`` for the booktabs package, with the captions as comments."""
    headings, values = _headings_and_values(scores)
    lines = [
        *(f"% {caption}" for caption in captions(scores)),
        rf"\begin{{tabular}}{{{'r' * len(headings)}}}",
        r"\toprule",
        " & ".join(headings).replace("%", r"\%") + r" \\",
        r"\midrule",
        " & ".join(values) + r" \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines)


def csv_table(scores: Scores) -> str:
    """One row of every metric by its key, unrounded, beside the signature."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*scores, "signature"])
    writer.writerow([*scores.values(), scores.signature])
    return text.getvalue().rstrip("\n")


def json_report(scores: Scores) -> str:
    """Render the score report, the very JSON that the server replies."""
    return scores.to_report().model_dump_json(indent=2)


def write_episodes(scores: Scores, file: TextIO) -> None:
    """Write the episode table as CSV: a row per episode, a column per metric, unrounded."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["instr_id", *scores.episodes])
    columns = [column.tolist() for column in scores.episodes.values()]
    writer.writerows(zip(scores.instr_ids, *columns, strict=True))


def captions(scores: Scores) -> Sequence[str]:
    """Say what the numbers depend on; the signature comes first."""
    notes = [f"note: {note}" for note in scores.notes]
    return [scores.signature, f"ground truth: {scores.ground_truth.provenance}", *notes]


def _headings_and_values(scores: Scores) -> tuple[list[str], list[str]]:
    return (
        [metric.heading for metric in scores.headline],
        [metric.display(scores[metric.key]) for metric in scores.headline],
    )


FORMATS: Mapping[str, Callable[[Scores], str]] = MappingProxyType(
    {
        "table": plain,
        "json": json_report,
        "csv": csv_table,
        "markdown": markdown,
        "latex": latex,
    }
)
"""What ``--format`` offers."""
