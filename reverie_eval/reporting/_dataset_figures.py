"""A dataset's description as figures, for slides and papers. Needs matplotlib."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from reverie_eval.dataset import DatasetDescription
from reverie_eval.reporting._dataset_panels import GOALS, PATHS, WORDS, draw_distributions
from reverie_eval.reporting._figure_style import STYLE, colour_of, count_in_round_steps

_FORMATS = ("svg", "png")
_SHOWN_CATEGORIES = 15


def write_figures(description: DatasetDescription, folder: Path) -> Sequence[Path]:
    """Draw the figures into a folder, which is made if it is not there.

    ``words``, ``categories``, ``goals`` and ``paths``, each as SVG and as PNG. Where no split names
    its targets, only the first.

    Returns
    -------
    sequence of Path
        The files that were written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(dict(STYLE)):
        figures = {
            "words": draw_distributions(description, WORDS),
            "categories": _categories(description),
            "goals": draw_distributions(description, GOALS),
            "paths": draw_distributions(description, PATHS),
        }
        return [
            _save(figure, folder / f"{name}.{suffix}")
            for name, figure in figures.items()
            if figure is not None
            for suffix in _FORMATS
        ]


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
    return path


def _categories(description: DatasetDescription) -> Figure | None:
    """Draw the most frequent categories of target objects, each a bar with a piece per split."""
    total = description.total.answers
    if total is None or not total.category_counts:
        return None
    names = list(total.category_counts)[:_SHOWN_CATEGORIES]
    figure = Figure(figsize=(8, 1.5 + 0.3 * len(names)), layout="constrained")
    axes = figure.subplots()
    drawn = np.zeros(len(names))
    for split, part in description.splits.items():
        if part.answers is not None:
            counts = np.array([part.answers.category_counts.get(name, 0) for name in names])
            axes.barh(names, counts, left=drawn, height=0.75, color=colour_of(split), label=split)
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
    count_in_round_steps(axes)
    axes.set_title(
        f"target categories: the {len(names)} most frequent of {total.target_categories:,}",
        loc="left",
        fontweight="bold",
    )
    figure.legend(loc="outside lower right", ncols=len(description.splits), frameon=False)
    return figure
