"""Figures of a submission's scores, for notebooks and slides. Needs matplotlib."""

import numpy as np
from matplotlib.axes import Axes

from reverie_eval.arrays import Array
from reverie_eval.metrics import CATALOGUE, primary_metric
from reverie_eval.reporting._distributions import histogram_of
from reverie_eval.reporting._figure_style import INK, count_in_round_steps
from reverie_eval.scoring import Scores

BLUE, ORANGE, GREY = "#0072B2", "#E69F00", "#B3BAC4"
"""The first two from the palette of Okabe and Ito, "Color Universal Design", 2008."""
_SHOWN_PARTS = 15


def draw_funnel(scores: Scores, axes: Axes) -> None:
    """Draw how many episodes came how far, a bar for each stage."""
    funnel = scores.failure_modes.funnel
    counts = list(funnel.values())
    total = counts[0]
    axes.barh(list(funnel), counts, height=0.7, color=BLUE)
    for row, count in enumerate(counts):
        share = f"{count:,}  ({100 * count / total:.1f} %)"
        _label(axes, count, row, share, inside=count > total / 2)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0, total)
    axes.set_xlabel("episodes  (percent of all episodes)")
    count_in_round_steps(axes)
    _title(axes, f"how far the agent comes on {scores.split}")


def draw_slices(scores: Scores, by: str, axes: Axes) -> None:
    """Draw success and what ranks of each part, with its number of episodes and an interval."""
    table = scores.breakdown(by, intervals=True)
    shown = table.head(_SHOWN_PARTS)
    ranks = primary_metric(scores).key
    colours = {key: colour for key, colour in (("success", ORANGE), (ranks, BLUE)) if key in shown}
    height = 0.8 / len(colours)
    rows = np.arange(len(shown))
    for number, (key, colour) in enumerate(colours.items()):
        place = rows + height * (number - (len(colours) - 1) / 2)
        label = CATALOGUE[key].label
        axes.barh(place, 100 * shown[key], height=0.9 * height, color=colour, label=label)
        if key == ranks:
            _draw_intervals(100 * shown[[f"{key}_low", f"{key}_high"]].to_numpy(), place, axes)
    names = [f"{part}  (n = {count:,})" for part, count in shown["episodes"].items()]
    axes.set_yticks(rows, names)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("%")
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    left_out = f": the {len(shown)} largest of {len(table)}" if len(table) > len(shown) else ""
    _title(axes, f"by {by}{left_out}")


def _draw_intervals(bounds: Array, place: Array, axes: Axes) -> None:
    """Draw low and high of every bar that has them."""
    is_drawn = ~np.isnan(bounds).any(axis=1)
    if is_drawn.any():
        low, high = bounds[is_drawn].T
        axes.hlines(place[is_drawn], low, high, color=INK, linewidth=1.2, label="95 % interval")


def draw_distribution(scores: Scores, key: str, axes: Axes) -> None:
    """Draw a metric's values as bars, and walked lengths over the shortest."""
    if key == "path_length":
        _draw_walks(scores, axes)
        return
    histogram = histogram_of({"": scores}, key)
    edges, share = histogram.edges, histogram.share[""]
    axes.bar(edges[:-1], share, np.diff(edges), align="edge", color=BLUE, edgecolor="white")
    axes.set_xlim(edges[0], edges[-1])
    if histogram.metric.unit == "count":
        count_in_round_steps(axes)
    axes.set_xlabel(histogram.label)
    axes.set_ylabel(f"share of {histogram.nouns} (%)")
    metric = histogram.metric
    mean = metric.display(float(np.mean(histogram.values[""])))
    _title(axes, f"{metric.heading}: mean {mean} of {histogram.count:,} {histogram.nouns}")


def _draw_walks(scores: Scores, axes: Axes) -> None:
    walked, shortest = scores.episodes["path_length"], scores.episodes["shortest_length"]
    succeeded = scores.episodes["success"] > 0
    kinds = (("stopped elsewhere", GREY, ~succeeded), ("stopped at the goal", BLUE, succeeded))
    for label, colour, part in kinds:
        axes.scatter(shortest[part], walked[part], s=9, alpha=0.6, color=colour, label=label)
    end = float(shortest.max())
    axes.plot([0, end], [0, end], color=INK, linestyle="--", linewidth=1.2, label="shortest")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("shortest length (m)")
    axes.set_ylabel("walked length (m)")
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    _title(axes, f"a dot for each of {len(walked):,} episodes")


def _label(axes: Axes, length: float, row: int, text: str, *, inside: bool) -> None:
    axes.annotate(
        text,
        (length, row),
        xytext=(-6 if inside else 6, 0),
        textcoords="offset points",
        horizontalalignment="right" if inside else "left",
        verticalalignment="center",
        color="white" if inside else INK,
    )


def _title(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontweight="bold", fontsize="medium")
