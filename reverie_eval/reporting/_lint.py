"""The report on the faults of a dataset's files, as text."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from reverie_eval.dataset import Count, Finding, LintReport, LintSection, Spread
from reverie_eval.reporting._table import Table, print_table
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from rich.console import Console


_COUNTED = ("", "code", "number", "of", "%", "description")
_MEASURED = ("code", "number", "min", "5 %", "median", "mean", "95 %", "max", "description")
_SHOWN_EXAMPLES = 3


def lint_text(report: LintReport) -> str:
    """Return the report in aligned columns, for a pipe or a file."""
    sections = [
        "\n".join(
            [
                _title(section),
                *(it.to_text() for it in _tables(section)),
                *filter(None, [section.note]),
            ]
        )
        for section in report.sections
    ]
    return "\n\n".join([*sections, *_errors(report), _verdict(report)])


def print_lint(console: "Console", report: LintReport) -> None:
    """Print the report on a terminal."""
    for section in report.sections:
        console.print(_title(section), style="bold", markup=False, highlight=False)
        for table in _tables(section):
            print_table(console, table, table.stacked())
        if section.note:
            console.print(f"{section.note}\n", style="dim", markup=False, highlight=False)
    for error in _errors(report):
        console.print(f"{error}\n", style="red", markup=False, highlight=False)
    style = "bold green" if report.sound else "bold red"
    console.print(_verdict(report), style=style, markup=False, highlight=False)


def _title(section: LintSection) -> str:
    return f"{section.title} of {section.split}" if section.split else section.title


def _tables(section: LintSection) -> Sequence[Table]:
    """Return a table of a section's counts, and one of its measurements."""
    counts = [_count_row(count) for count in section.counts]
    spreads = [_spread_row(spread) for spread in section.spreads if spread.number]
    tables = [
        Table(_COUNTED, counts, frozenset({0, 1, len(_COUNTED) - 1})),
        Table(_MEASURED, spreads, frozenset({0, len(_MEASURED) - 1})),
    ]
    return [table for table in tables if table.rows]


def _errors(report: LintReport) -> Iterator[str]:
    """Yield for every error what it means, what to do, and where it is."""
    for section in report.sections:
        for count in section.counts:
            if _is_there(count) and count.severity == "error":
                title = f"error {count.code}, {_title(section)}: {count.found}"
                examples = [f"  {line}" for line in _shown(count.found)]
                yield "\n".join([f"{title} {count.says}", count.advice, *examples])


def _verdict(report: LintReport) -> str:
    """Return whether the dataset is sound, in a line."""
    counts = [count for section in report.sections for count in section.counts]
    checks = count_text(sum(count.severity == "error" for count in counts), "check")
    errors = sum(_is_there(count) for count in counts if count.severity == "error")
    warnings = count_text(
        sum(_is_there(count) for count in counts if count.severity == "warning"), "warning"
    )
    if report.sound:
        return f"passed: {checks}, no errors, {warnings}"
    return f"failed: {errors} of {checks} found errors, {warnings}"


def _count_row(count: Finding) -> Sequence[str]:
    found = count.found
    of = "" if found.of is None else f"{found.of:,}"
    return [_mark(count), count.code, f"{found.number:,}", of, _share(found), count.says]


def _share(found: Count) -> str:
    if not found.of or not found.number:
        return ""
    share = f"{100 * found.number / found.of:.1f}"
    return "<0.1" if share == "0.0" else share


def _mark(count: Finding) -> str:
    if count.severity == "info":
        return ""
    return count.severity if _is_there(count) else "ok"


def _is_there(count: Finding) -> bool:
    return count.found.number > 0


def _spread_row(spread: Spread) -> Sequence[str]:
    low, few, median, many, high = (spread.percentiles[p] for p in ("0", "5", "50", "95", "100"))
    numbers = [low, few, median, spread.mean or 0.0, many, high]
    says = f"{spread.says}, {spread.unit}" if spread.unit else spread.says
    return [spread.code, f"{spread.number:,}", *map(_number, numbers), says]


def _number(value: float) -> str:
    """Format a value with three digits, large ones as whole numbers."""
    if value == round(value) or abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:#.3g}"


def _shown(found: Count) -> Sequence[str]:
    examples = found.examples[:_SHOWN_EXAMPLES]
    more = found.number - len(examples)
    return [*examples, f"and {more:,} more"] if more else examples
