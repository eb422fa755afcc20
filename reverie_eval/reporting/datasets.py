"""The faults of a dataset's files and what they contain: as text, tables and figures."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter

from reverie_eval.arrays import FloatArray
from reverie_eval.dataset import (
    Count,
    DatasetDescription,
    Distribution,
    Finding,
    LintReport,
    LintSection,
    PaperComparison,
    SplitDescription,
    Spread,
    of_targets,
)
from reverie_eval.reporting.charts import bin_edges, count_edges
from reverie_eval.reporting.drawing import INK
from reverie_eval.reporting.figures import STYLE, split_colour, use_round_ticks
from reverie_eval.reporting.tables import Part, Printout, Table, cell_of
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COUNTED = ("", "code", "number", "of", "%", "description")
_MEASURED = ("code", "number", "min", "5 %", "median", "mean", "95 %", "max", "description")
_SHOWN_EXAMPLES = 3


def lint_printout(report: LintReport) -> Printout:
    """Return the report in each of its formats."""

    def parts() -> Sequence[Part]:
        sections = [
            Part(_section_tables(section), _title(section), section.note)
            for section in report.sections
        ]
        errors = [Part(note=error, style="red") for error in _errors(report)]
        style = "bold green" if report.sound else "bold red"
        return [*sections, *errors, Part(note=_verdict(report), style=style)]

    return Printout(parts, partial(_as_json, report))


def _title(section: LintSection) -> str:
    return f"{section.title} of {section.split}" if section.split else section.title


def _section_tables(section: LintSection) -> Sequence[Table]:
    """Return a table of a section's counts, and one of its measurements."""
    counts = [_count_row(count) for count in section.counts]
    spreads = [_spread_row(spread) for spread in section.spreads if spread.number]
    tables = [
        Table(_COUNTED, counts, frozenset({0, 1, len(_COUNTED) - 1})),
        Table(_MEASURED, spreads, frozenset({0, len(_MEASURED) - 1})),
    ]
    return [replace(table, narrow=table.stacked()) for table in tables if table.rows]


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
    return [spread.code, f"{spread.number:,}", *map(_three_digits, numbers), says]


def _three_digits(value: float) -> str:
    """Format a value with three digits, large ones as whole numbers."""
    # Three digits say enough; a count is exact.
    if value == round(value) or abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:#.3g}"


def _shown(found: Count) -> Sequence[str]:
    examples = found.examples[:_SHOWN_EXAMPLES]
    more = found.number - len(examples)
    return [*examples, f"and {more:,} more"] if more else examples


# Contents.


_SOURCE = "paper: Qi et al., REVERIE, CVPR 2020, section 3"
# Names for the splits that a number of the paper covers.
_GROUPS: Mapping[tuple[str, ...], str] = MappingProxyType(
    {
        (): "",
        ("val_seen", "val_unseen"): "val",
        ("train", "val_seen", "val_unseen", "test"): "all",
    }
)


def description_printout(description: DatasetDescription) -> Printout:
    """Return a description in each of its formats."""
    return Printout(
        lambda: [Part([table]) for table in _description_tables(description)],
        partial(_as_json, description),
    )


def _as_json(report: DatasetDescription | LintReport) -> str:
    adapter: TypeAdapter[Any] = TypeAdapter(type(report))
    return adapter.dump_json(report, indent=2).decode()


def _description_tables(description: DatasetDescription) -> Sequence[Table]:
    """Return the splits side by side, and the paper's numbers beside the dataset's, if any."""
    has_several = len(description.splits) > 1
    parts = {**description.splits, **({"total": description.total} if has_several else {})}
    rows = [(label, list(map(measure, parts.values())), text) for label, measure, text in _ROWS]
    if not description.paper:  # a task without target objects has no rows about them
        rows = [row for row in rows if any(value is not None for value in row[1])]
    splits = Table(
        headings=["", *parts],
        rows=[[label, *(cell_of(value, text) for value in values)] for label, values, text in rows],
        text_columns=frozenset({0}),
    )
    # Only REVERIE's paper counts what is counted here.
    if not description.paper:
        return [splits]
    paper = Table(
        headings=["", "splits", "dataset", "paper", ""],
        rows=[_compared(comparison) for comparison in description.paper],
        text_columns=frozenset({0, 1, 4}),
        notes=[_SOURCE, *(f"note: {note}" for note in description.notes)],
    )
    return [splits, paper]


def _compared(comparison: PaperComparison) -> Sequence[str]:
    missing = [split for split in comparison.splits if split not in comparison.covered]
    partly = comparison.covered and missing
    return [
        comparison.quantity,
        _GROUPS.get(tuple(comparison.splits), ", ".join(comparison.splits)),
        cell_of(comparison.here, _number),
        _number(comparison.paper),
        f"without {', '.join(missing)}" if partly else "",
    ]


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.1f}"


def _mean(values: Distribution) -> str:
    return f"{values.mean:.1f}"


def _range(values: Distribution) -> str:
    ends = (values.minimum, values.maximum)
    return "-".join(f"{end:.0f}" if end.is_integer() else f"{end:.1f}" for end in ends)


_RANGE = "    range"
GOAL_OBJECTS = of_targets(lambda targets: targets.goal_objects)
GOAL_BOXES = of_targets(lambda targets: targets.goal_boxes)
PATH_STEPS = of_targets(lambda targets: targets.path_steps)
PATH_LENGTH = of_targets(lambda targets: targets.path_length)
# The rows of the table of splits: label, value, and how it is shown.
_ROWS: Sequence[tuple[str, Callable[[SplitDescription], Any], Callable[[Any], str]]] = (
    ("items", lambda part: part.items, _number),
    ("instructions", lambda part: part.instructions, _number),
    ("scans", lambda part: part.scans, _number),
    ("viewpoints in scans", lambda part: part.viewpoints, _number),
    ("words per instruction", lambda part: part.words, _mean),
    (_RANGE, lambda part: part.words, _range),
    ("distinct words", lambda part: part.vocabulary, _number),
    ("frequent words", lambda part: part.frequent_vocabulary, _number),
    ("target objects", of_targets(lambda targets: targets.target_objects), _number),
    ("target categories", of_targets(lambda targets: targets.target_categories), _number),
    ("objects at the goal", GOAL_OBJECTS, _mean),
    (_RANGE, GOAL_OBJECTS, _range),
    ("boxes at the goal", GOAL_BOXES, _mean),
    (_RANGE, GOAL_BOXES, _range),
    ("path steps", PATH_STEPS, _mean),
    (_RANGE, PATH_STEPS, _range),
    ("path length (m)", PATH_LENGTH, _mean),
    (_RANGE, PATH_LENGTH, _range),
)


# Figures.


_FORMATS = ("svg", "png")
_SHOWN_CATEGORIES = 15
# Bars in a row of histograms, at most.
_MOST_BARS = 80


class _Quantity(NamedTuple):
    """What a column of histograms shows."""

    name: str
    """The quantity's name in ``DatasetDescription.paper``, if the paper gives its mean."""
    label: str
    noun: str
    """What each value belongs to."""
    values: Callable[[SplitDescription], Distribution | None]
    edges: Callable[[FloatArray, int], FloatArray] = count_edges
    """Divides the values into at most the given number of bins."""


_WORDS = (
    _Quantity(
        "words per instruction", "words per instruction", "instruction", lambda split: split.words
    ),
)
_GOALS = (
    _Quantity("objects at the goal", "visible objects at the goal", "item", GOAL_OBJECTS),
    _Quantity("boxes at the goal", "boxes at the goal, in all views", "item", GOAL_BOXES),
)
_PATHS = (
    _Quantity("path steps", "steps of the annotated path", "item", PATH_STEPS),
    _Quantity("path length", "length of the annotated path (m)", "item", PATH_LENGTH, bin_edges),
)


def write_figures(description: DatasetDescription, folder: Path) -> Sequence[Path]:
    """Draw the figures into a folder, which is created if it does not exist.

    Writes ``words``, ``categories``, ``goals`` and ``paths``, each as SVG and as PNG; only
    ``words`` if no split has targets. Returns the files that were written.
    """
    import matplotlib as mpl

    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(dict(STYLE)):
        figures = {
            "words": _draw_histograms(description, _WORDS),
            "categories": _draw_categories(description),
            "goals": _draw_histograms(description, _GOALS),
            "paths": _draw_histograms(description, _PATHS),
        }
        written = []
        drawn = {name: figure for name, figure in figures.items() if figure is not None}
        for name, figure in drawn.items():
            for suffix in _FORMATS:
                path = folder / f"{name}.{suffix}"
                # Without a date the same description gives the same file.
                figure.savefig(path, metadata={"Date": None} if suffix == "svg" else None)
                written.append(path)
        return written


def _draw_histograms(
    description: DatasetDescription, quantities: Sequence[_Quantity]
) -> "Figure | None":
    """Draw a row of histograms for each split that has the values, a column per quantity."""
    columns = [
        {
            split: values
            for split, described in description.splits.items()
            if (values := quantity.values(described))
        }
        for quantity in quantities
    ]
    splits = list(columns[0])
    if not splits:
        return None
    figure = _figure(1.3 + 1.5 * len(splits))
    grid = figure.subplots(len(splits), len(quantities), sharex="col", sharey="col", squeeze=False)
    for column, quantity, all_axes in zip(columns, quantities, grid.T, strict=True):
        # All splits in the same bins, or their heights could not be compared.
        together = np.concatenate([each.values for each in column.values()])
        edges = quantity.edges(together, _MOST_BARS // len(quantities))
        paper = [each.paper for each in description.paper if each.quantity == quantity.name]
        for split, axes in zip(splits, all_axes, strict=True):
            _draw_histogram(axes, column[split], edges, split_colour(split))
            for mean in paper:
                label = "mean of all splits in the paper"
                axes.axvline(mean, color=INK, linestyle=":", linewidth=1.2, label=label)
            number = count_text(len(column[split].values), quantity.noun)
            heading = f"mean {column[split].mean:.1f} of {number}"
            axes.set_title(heading, loc="right", fontsize="medium")
        all_axes[-1].set_xlabel(quantity.label)
        use_round_ticks(all_axes[-1])
    for split, axes in zip(splits, grid[:, 0], strict=True):
        axes.set_title(split, loc="left", fontweight="bold")
    figure.supylabel(f"share of {quantities[0].noun}s (%)", fontsize="medium")
    lines, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower right", ncols=2, frameon=False)
    return figure


def _figure(height: float) -> "Figure":
    """Return a figure as wide as a page, of a height in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(8, height), layout="constrained")


def _draw_histogram(axes: "Axes", values: Distribution, edges: FloatArray, colour: str) -> None:
    """Draw the shares of the values and their mean."""
    share = np.full_like(values.values, 100 / len(values.values))
    axes.hist(values.values, edges.tolist(), weights=share, color=colour, rwidth=0.9)
    axes.axvline(values.mean, color=INK, linestyle="--", linewidth=1.2, label="mean")


def _draw_categories(description: DatasetDescription) -> "Figure | None":
    """Draw the most frequent categories of target objects, each a bar with a piece per split."""
    total = description.total.targets
    if total is None or not total.category_counts:
        return None
    names = list(total.category_counts)[:_SHOWN_CATEGORIES]
    figure = _figure(1.5 + 0.3 * len(names))
    axes = figure.subplots()
    drawn = np.zeros(len(names))
    for split, described in description.splits.items():
        if described.targets is not None:
            counts = np.array([described.targets.category_counts.get(name, 0) for name in names])
            colour = split_colour(split)
            axes.barh(names, counts, left=drawn, height=0.75, color=colour, label=split)
            drawn += counts
    for row, number in enumerate(drawn):
        axes.annotate(
            f"{number:.0f}",
            (number, row),
            xytext=(4, 0),
            textcoords="offset points",
            verticalalignment="center",
        )
    axes.invert_yaxis()
    axes.margins(x=0.08, y=0.01)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("target objects")
    use_round_ticks(axes)
    axes.set_title(
        f"target categories: the {len(names)} most frequent of {total.target_categories:,}",
        loc="left",
        fontweight="bold",
    )
    figure.legend(loc="outside lower right", ncols=len(description.splits), frameon=False)
    return figure
