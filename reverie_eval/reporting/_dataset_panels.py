"""Distributions as panels: a row for each split, a column for each quantity. Needs matplotlib."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reverie_eval.arrays import FloatArray
from reverie_eval.dataset import (
    AnswerDescription,
    DatasetDescription,
    Distribution,
    SplitDescription,
)
from reverie_eval.reporting._bins import bin_edges, count_edges
from reverie_eval.reporting._figure_style import INK, colour_of, count_in_round_steps
from reverie_eval.text import count_text

_MOST_BARS = 80
"""In a row of panels."""


class Quantity(NamedTuple):
    """What a column of panels shows the distribution of."""

    name: str
    """As the paper's mean of it is called in a description, if it has one."""
    label: str
    noun: str
    """What each value belongs to."""
    values: Callable[[SplitDescription], Distribution | None]
    edges: Callable[[FloatArray, int], FloatArray] = count_edges
    """How values are divided into so many bars at most."""


def _of_answers(
    values: Callable[[AnswerDescription], Distribution],
) -> Callable[[SplitDescription], Distribution | None]:
    return lambda part: None if part.answers is None else values(part.answers)


WORDS = (
    Quantity(
        "words per instruction", "words per instruction", "instruction", lambda part: part.words
    ),
)
GOALS = (
    Quantity(
        "objects at the goal",
        "visible objects at the goal",
        "task",
        _of_answers(lambda answers: answers.goal_objects),
    ),
    Quantity(
        "boxes at the goal",
        "boxes at the goal, in all views",
        "task",
        _of_answers(lambda answers: answers.goal_boxes),
    ),
)
PATHS = (
    Quantity(
        "path steps",
        "steps of the annotated path",
        "task",
        _of_answers(lambda answers: answers.path_steps),
    ),
    Quantity(
        "path length",
        "length of the annotated path (m)",
        "task",
        _of_answers(lambda answers: answers.path_length),
        bin_edges,
    ),
)


def draw_distributions(
    description: DatasetDescription, quantities: Sequence[Quantity]
) -> Figure | None:
    """Draw a row of panels for each split that has the quantities, a column for each of them."""
    columns = [
        {split: values for split, part in description.splits.items() if (values := of(part))}
        for of in (quantity.values for quantity in quantities)
    ]
    splits = list(columns[0])
    if not splits:
        return None
    figure = Figure(figsize=(8, 1.3 + 1.5 * len(splits)), layout="constrained")
    grid = figure.subplots(len(splits), len(quantities), sharex="col", sharey="col", squeeze=False)
    for column, quantity, panels in zip(columns, quantities, grid.T, strict=True):
        together = np.concatenate([each.values for each in column.values()])
        edges = quantity.edges(together, _MOST_BARS // len(quantities))
        for split, axes in zip(splits, panels, strict=True):
            _draw_distribution(axes, column[split], edges, colour_of(split))
            number = count_text(len(column[split].values), quantity.noun)
            mean = f"mean {column[split].mean:.1f} of {number}"
            axes.set_title(mean, loc="right", fontsize="medium")
            _draw_paper(axes, quantity, description)
        panels[-1].set_xlabel(quantity.label)
        count_in_round_steps(panels[-1])
    for split, axes in zip(splits, grid[:, 0], strict=True):
        axes.set_title(split, loc="left", fontweight="bold")
    figure.supylabel(f"share of {quantities[0].noun}s (%)", fontsize="medium")
    lines, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower right", ncols=2, frameon=False)
    return figure


def _draw_distribution(axes: Axes, values: Distribution, edges: FloatArray, colour: str) -> None:
    """Draw a histogram with its mean."""
    share = np.full_like(values.values, 100 / len(values.values))
    axes.hist(values.values, edges.tolist(), weights=share, color=colour, rwidth=0.9)
    axes.axvline(values.mean, color=INK, linestyle="--", linewidth=1.2, label="mean")


def _draw_paper(axes: Axes, quantity: Quantity, description: DatasetDescription) -> None:
    """Draw the paper's mean, if it gives one."""
    for comparison in description.paper:
        if comparison.quantity == quantity.name:
            label = "mean of all splits in the paper"
            axes.axvline(comparison.paper, color=INK, linestyle=":", linewidth=1.2, label=label)
