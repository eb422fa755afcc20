"""Figures for notebooks, ``scores.plot.funnel()``; matplotlib is imported when one is drawn.

Every figure is drawn on the Axes that are given, or on new ones, and returns them.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.analysis import Episode
from reverie_eval.metrics import METRICS, primary_metric
from reverie_eval.reporting._charts import Histogram, Walks
from reverie_eval.reporting._figure_style import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    set_heading,
    styled_axes,
    use_round_ticks,
)
from reverie_eval.scoring import Scores

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SHOWN_GROUPS = 15


@dataclass(frozen=True)
class Plots:
    """The figures of a submission's scores; ``ax`` is where to draw, on new Axes if not given.

    All raise ReverieEvalError if matplotlib is not installed.
    """

    scores: Scores

    def funnel(self, ax: "Axes | None" = None) -> "Axes":
        """Draw how many episodes reached the goal, stopped there, and predicted the target.

        Percentages are of all episodes.

        Raises
        ------
        ProtocolError
            If the protocol or track scores no outcomes.
        """
        funnel = self.scores.failure_modes.funnel
        total = next(iter(funnel.values()))
        with styled_axes(ax) as axes:
            axes.barh(list(funnel), list(funnel.values()), height=0.7, color=BLUE)
            for row, count in enumerate(funnel.values()):
                has_room = count > total / 2
                axes.annotate(
                    f"{count:,}  ({100 * count / total:.1f} %)",
                    (count, row),
                    xytext=(-6 if has_room else 6, 0),
                    textcoords="offset points",
                    horizontalalignment="right" if has_room else "left",
                    verticalalignment="center",
                    color="white" if has_room else INK,
                )
            axes.invert_yaxis()
            axes.tick_params(axis="y", length=0)
            axes.set_xlim(0, total)
            axes.set_xlabel("episodes  (percent of all episodes)")
            use_round_ticks(axes)
            set_heading(axes, f"progress funnel on {self.scores.split}")
        return axes

    def breakdown(self, by: str, ax: "Axes | None" = None) -> "Axes":
        """Draw success and the primary metric for groups of episodes, the largest groups first.

        The primary metric is RGSPL; RGS or SPL where that is not scored. Its 95 % interval is
        computed over the targets of a group; groups of fewer than 5 targets have none.

        Parameters
        ----------
        by : str
            As for ``scores.breakdown``: ``scan``, ``category``, ``length`` ...
        ax : Axes, optional

        Raises
        ------
        ProtocolError
            If there is no such grouping.
        GroundTruthError
            If the ground truth was compiled without what the grouping needs.
        """
        table = self.scores.breakdown(by, intervals=True)
        shown = table.head(_SHOWN_GROUPS)
        primary = primary_metric(self.scores).key
        colours = (("success", ORANGE), (primary, BLUE))
        bars = [(key, colour) for key, colour in colours if key in shown]
        height = 0.8 / len(bars)
        rows = np.arange(len(shown))
        with styled_axes(ax) as axes:
            for number, (key, colour) in enumerate(bars):
                y = rows + height * (number - (len(bars) - 1) / 2)
                label = METRICS[key].label
                axes.barh(y, 100 * shown[key], height=0.9 * height, color=colour, label=label)
                if key != primary:
                    continue
                ends = 100 * shown[[f"{key}_low", f"{key}_high"]].to_numpy()
                has_ends = ~np.isnan(ends).any(axis=1)
                if has_ends.any():
                    low, high = ends[has_ends].T
                    label = "95 % interval"
                    axes.hlines(y[has_ends], low, high, color=INK, linewidth=1.2, label=label)
            counts = shown["episodes"].items()
            axes.set_yticks(rows, [f"{group}  (n = {count:,})" for group, count in counts])
            axes.invert_yaxis()
            axes.tick_params(axis="y", length=0)
            axes.set_xlabel("%")
            _explain_beside(axes)
            is_cut = len(table) > len(shown)
            rest = f": the {len(shown)} largest of {len(table)}" if is_cut else ""
            set_heading(axes, f"by {by}{rest}")
        return axes

    def distribution(self, metric: str, ax: "Axes | None" = None) -> "Axes":
        """Draw how a metric's values are distributed over the episodes.

        ``path_length`` is drawn over the shortest length, a dot for each episode; every other
        metric as a histogram, box metrics over the predicted boxes.

        Raises
        ------
        KeyError
            If the metric is not scored.
        """
        if metric == "path_length":
            return _plot_walks(Walks.of(self.scores), ax)
        return _plot_histogram(Histogram.of({"": self.scores}, metric), ax)


def plot_episode(episode: Episode, ax: "Axes | None" = None) -> "Axes":
    """Draw an episode on its scan's navigation graph; see :meth:`Episode.plot`."""
    with styled_axes(ax) as axes:
        from reverie_eval.reporting._map_figure import draw_map
        from reverie_eval.reporting._maps import EpisodeMap

        draw_map(EpisodeMap.of({"": episode}), axes)
    return axes


def _plot_histogram(histogram: Histogram, ax: "Axes | None") -> "Axes":
    edges, metric, values = histogram.edges, histogram.metric, histogram.values[""]
    with styled_axes(ax) as axes:
        share, width = histogram.share[""], np.diff(edges)
        axes.bar(edges[:-1], share, width, align="edge", color=BLUE, edgecolor="white")
        axes.set_xlim(edges[0], edges[-1])
        if metric.unit == "count":
            use_round_ticks(axes)
        axes.set_xlabel(histogram.label)
        axes.set_ylabel(f"share of {histogram.noun} (%)")
        mean = metric.display(float(np.mean(values)))
        of = f"{len(values):,} {histogram.noun}"
        set_heading(axes, f"{metric.heading}: mean {mean} of {of}")
    return axes


def _plot_walks(walks: Walks, ax: "Axes | None") -> "Axes":
    parts = (
        ("stopped elsewhere", GREY, ~walks.is_success),
        ("stopped at the goal", BLUE, walks.is_success),
    )
    end = float(walks.shortest.max())
    with styled_axes(ax) as axes:
        for label, colour, part in parts:
            dots = walks.shortest[part], walks.walked[part]
            axes.scatter(*dots, s=9, alpha=0.6, color=colour, label=label)
        axes.plot([0, end], [0, end], color=INK, linestyle="--", linewidth=1.2, label="shortest")
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("shortest length (m)")
        axes.set_ylabel("walked length (m)")
        _explain_beside(axes)
        set_heading(axes, f"a dot for each of {len(walks.walked):,} episodes")
    return axes


def _explain_beside(axes: "Axes") -> None:
    """Put the legend to the right of the axes, where it covers nothing."""
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
