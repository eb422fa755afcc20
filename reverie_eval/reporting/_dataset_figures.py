"""A dataset's description as figures, for slides and papers. Needs matplotlib."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reverie_eval.arrays import FloatArray
from reverie_eval.dataset import DatasetDescription, Distribution, SplitDescription
from reverie_eval.reporting._charts import bin_edges, count_edges
from reverie_eval.reporting._description import GOAL_BOXES, GOAL_OBJECTS, PATH_LENGTH, PATH_STEPS
from reverie_eval.reporting._figure_style import INK, STYLE, split_colour, use_round_ticks
from reverie_eval.text import count_text

_FORMATS = ("svg", "png")
_SHOWN_CATEGORIES = 15
_MOST_BARS = 80
"""Bars in a row of histograms, at most."""


class _Quantity(NamedTuple):
    """What a column of histograms shows."""

    name: str
    """As in ``DatasetDescription.paper``, if the paper gives its mean."""
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
    ``words`` if no split has answers. Returns the files that were written.
    """
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
) -> Figure | None:
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
    figure = Figure(figsize=(8, 1.3 + 1.5 * len(splits)), layout="constrained")
    grid = figure.subplots(len(splits), len(quantities), sharex="col", sharey="col", squeeze=False)
    for column, quantity, all_axes in zip(columns, quantities, grid.T, strict=True):
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


def _draw_histogram(axes: Axes, values: Distribution, edges: FloatArray, colour: str) -> None:
    """Draw the shares of the values and their mean."""
    share = np.full_like(values.values, 100 / len(values.values))
    axes.hist(values.values, edges.tolist(), weights=share, color=colour, rwidth=0.9)
    axes.axvline(values.mean, color=INK, linestyle="--", linewidth=1.2, label="mean")


def _draw_categories(description: DatasetDescription) -> Figure | None:
    """Draw the most frequent categories of target objects, each a bar with a piece per split."""
    total = description.total.answers
    if total is None or not total.category_counts:
        return None
    names = list(total.category_counts)[:_SHOWN_CATEGORIES]
    figure = Figure(figsize=(8, 1.5 + 0.3 * len(names)), layout="constrained")
    axes = figure.subplots()
    drawn = np.zeros(len(names))
    for split, described in description.splits.items():
        if described.answers is not None:
            counts = np.array([described.answers.category_counts.get(name, 0) for name in names])
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
