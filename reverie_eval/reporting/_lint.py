"""The report on a dataset's files as people read it."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from reverie_eval.dataset import Finding, Found, LintReport, LintSection, Spread
from reverie_eval.reporting._grids import Grid, aligned, rich_table
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from rich.console import Console


_COUNTED = ("", "code", "number", "of", "%", "what")
_MEASURED = ("code", "number", "min", "5 %", "median", "mean", "95 %", "max", "what")
_SHOWN_EXAMPLES = 3


def lint_text(report: LintReport) -> str:
    """Write the report in aligned columns, for a pipe or a file."""
    sections = [
        "\n".join([title_of(section), *map(aligned, grids_of(section)), *_note(section)])
        for section in report.sections
    ]
    return "\n\n".join([*sections, *errors_of(report), verdict_of(report)])


def show_lint(report: LintReport, console: "Console") -> None:
    """Print the report on a terminal."""
    for section in report.sections:
        console.print(title_of(section), style="bold", markup=False, highlight=False)
        for grid in grids_of(section):
            console.print(rich_table(grid))
        for note in _note(section):
            console.print(f"{note}\n", style="dim", markup=False, highlight=False)
    for error in errors_of(report):
        console.print(f"{error}\n", style="red", markup=False, highlight=False)
    style = "bold green" if report.sound else "bold red"
    console.print(verdict_of(report), style=style, markup=False, highlight=False)


def title_of(section: LintSection) -> str:
    """Return a section's heading."""
    return f"{section.title} of {section.split}" if section.split else section.title


def grids_of(section: LintSection) -> Sequence[Grid]:
    """Word a section: what was counted, and what was measured."""
    counts = [_count_row(count) for count in section.counts]
    spreads = [_spread_row(spread) for spread in section.spreads if spread.number]
    grids = [
        Grid(_COUNTED, counts, frozenset({0, 1, len(_COUNTED) - 1})),
        Grid(_MEASURED, spreads, frozenset({0, len(_MEASURED) - 1})),
    ]
    return [grid for grid in grids if grid.rows]


def errors_of(report: LintReport) -> Iterator[str]:
    """Say of every error what it means, what to do, and where."""
    for section in report.sections:
        for count in section.counts:
            if _is_there(count) and count.severity == "error":
                title = f"error {count.code}, {title_of(section)}: {_words(count.found)}"
                examples = [f"  {line}" for line in _shown(count.found)]
                yield "\n".join([f"{title} {count.says}", count.advice, *examples])


def verdict_of(report: LintReport) -> str:
    """Say in a line whether the dataset is sound."""
    counts = [count for section in report.sections for count in section.counts]
    checks = count_text(sum(count.severity == "error" for count in counts), "check")
    errors = sum(_is_there(count) for count in counts if count.severity == "error")
    warnings = count_text(
        sum(_is_there(count) for count in counts if count.severity == "warning"), "warning"
    )
    if report.sound:
        return f"sound: {checks} found no error, {warnings}"
    return f"not sound: {errors} of {checks} found an error, {warnings}"


def _note(section: LintSection) -> Sequence[str]:
    return [section.note] if section.note else []


def _count_row(count: Finding) -> Sequence[str]:
    found = count.found
    of = "" if found.of is None else f"{found.of:,}"
    return [_mark(count), count.code, f"{found.number:,}", of, _share(found), count.says]


def _share(found: Found) -> str:
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
    """Word a value to three digits, large ones to the whole."""
    if value == round(value) or abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:#.3g}"


def _words(found: Found) -> str:
    return f"{found.number:,}" if found.of is None else f"{found.number:,} of {found.of:,}"


def _shown(found: Found) -> Sequence[str]:
    examples = found.examples[:_SHOWN_EXAMPLES]
    more = found.number - len(examples)
    return [*examples, f"and {more:,} more"] if more else examples
