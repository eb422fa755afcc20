"""Figures for notebooks, ``scores.plot.funnel()``; matplotlib is imported when one is drawn.

Every function draws on the given Axes, or on new ones, and returns them.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from reverie_eval.analysis import BudgetCurve, Comparison, GroupingKey
from reverie_eval.errors import ProtocolError, naming_missing_parts
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.charts import Chart, Histogram, WalkLengths, budget_chart
from reverie_eval.reporting.drawing import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    draw_lines,
)
from reverie_eval.scoring import Scored, Scores, check_same_signature
from reverie_eval.text import first_few

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SPLIT_COLOURS: Mapping[str, str] = MappingProxyType(
    {"train": BLUE, "val_seen": ORANGE, "val_unseen": GREEN, "test": PURPLE}
)
STYLE: Any = MappingProxyType(
    {
        "font.size": 11,
        "figure.constrained_layout.h_pad": 0.06,
        "figure.constrained_layout.w_pad": 0.06,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "text.color": INK,
        "text.parse_math": False,  # a name is shown as it is
        "savefig.dpi": 200,
        "svg.hashsalt": "reverie-eval",  # the same figure gives the same file
    }
)

_SHOWN_GROUPS = 15
_COLOURS = (ORANGE, BLUE, GREEN, VERMILION, PURPLE, SKY)


@dataclass(frozen=True)
class Plots:
    """Figures of a submission's scores, drawn on ``ax`` or, if it is not given, on new Axes.

    All methods raise ReverieEvalError if matplotlib is not installed.
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
                # Text stands in long bars and beside short ones.
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

    def breakdown(self, by: GroupingKey | str, ax: "Axes | None" = None) -> "Axes":
        """Draw success and the primary metric for groups of episodes, the largest groups first.

        The primary metric is the task's: RGSPL in REVERIE, or RGS or SPL if RGSPL is not scored.
        If it is a length, it is drawn alone. Its 95 % interval is computed over the targets of a
        group; groups of fewer than 5 targets have none.

        Parameters
        ----------
        by : str
            As for ``scores.breakdown``: ``scan``, ``category``, ``length`` ...
        ax : Axes, optional

        Raises
        ------
        ProtocolError
            If there is no such grouping.
        """
        table = self.scores.breakdown(by, intervals=True)
        # The largest ones: in small groups, scores are chance.
        shown = table.head(_SHOWN_GROUPS)
        metric = self.scores.ground_truth.task.primary_metric(self.scores)
        primary, scale = metric.key, metric.scale
        colours = (("success", ORANGE), (primary, BLUE))
        bars = [
            (key, colour)
            for key, colour in colours
            if key in shown and CATALOGUE[key].unit == metric.unit
        ]
        height = 0.8 / len(bars)
        rows = np.arange(len(shown))
        with styled_axes(ax) as axes:
            for number, (key, colour) in enumerate(bars):
                y = rows + height * (number - (len(bars) - 1) / 2)
                label = CATALOGUE[key].label
                axes.barh(y, scale * shown[key], height=0.9 * height, color=colour, label=label)
                if key != primary:
                    continue
                ends = scale * shown[[f"{key}_low", f"{key}_high"]].to_numpy()
                has_ends = ~np.isnan(ends).any(axis=1)
                if has_ends.any():
                    low, high = ends[has_ends].T
                    label = "95 % interval"
                    axes.hlines(y[has_ends], low, high, color=INK, linewidth=1.2, label=label)
            counts = shown["episodes"].items()
            axes.set_yticks(rows, [f"{group}  (n = {count:,})" for group, count in counts])
            axes.invert_yaxis()
            axes.tick_params(axis="y", length=0)
            axes.set_xlabel(metric.suffix)
            _explain_beside(axes)
            is_cut = len(table) > len(shown)
            rest = f": the {len(shown)} largest of {len(table)}" if is_cut else ""
            set_heading(axes, f"by {by}{rest}")
        return axes

    def distribution(self, metric: str, ax: "Axes | None" = None) -> "Axes":
        """Draw how a metric's values are distributed over the episodes.

        ``path_length`` is drawn against the shortest length, with a dot for each episode; every
        other metric is drawn as a histogram, box metrics over the predicted boxes.

        Raises
        ------
        KeyError
            If the metric is not scored.
        ProtocolError
            If it has no value in any episode, as errors of points in a file without any.
        """
        if metric == "path_length":
            return _plot_walks(WalkLengths.of(self.scores), ax)
        return _plot_histogram(Histogram.of({"": self.scores}, metric), ax)


def plot_curve(
    scores: Mapping[float, Scored],
    metrics: Sequence[str] | None = None,
    ax: "Axes | None" = None,
) -> "Axes":
    """Draw scores over the steps of a training run, with their intervals if they have any.

    Parameters
    ----------
    scores : mapping of Scores or Runs
        By the number of the epoch, iteration or checkpoint, in any order.
    metrics : sequence of str, optional
        Metrics of one unit; if not given, the primary metric, with success if both are fractions.
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Raises
    ------
    ProtocolError
        If there are no scores, they are not comparable, a step is not a number, or metrics have
        different units.
    KeyError
        If a metric is not scored.
    ReverieEvalError
        If matplotlib is not installed.
    """
    steps = _sorted_steps(scores)
    first = scores[steps[0]]
    primary = first.ground_truth.task.primary_metric(first)
    keys = [key for key in ("success", primary.key) if key in first]
    chosen = metrics or [key for key in keys if CATALOGUE[key].unit == primary.unit]
    means = {key: np.array([scores[step][key] for step in steps]) for key in chosen}
    unit, *others = dict.fromkeys(CATALOGUE[key].suffix for key in means)
    if others:
        raise ProtocolError(f"{first_few(means)} have different units; draw each in its own figure")
    with styled_axes(ax) as axes:
        for (key, values), colour in zip(means.items(), cycle(_COLOURS), strict=False):
            metric = CATALOGUE[key]
            shown = metric.scale * values
            axes.plot(steps, shown, marker="o", color=colour, label=metric.label)
            intervals = [scores[step].intervals for step in steps]
            ends = [
                (metric.scale * each[key].low, metric.scale * each[key].high)
                for each in intervals
                if each
            ]
            # A band with gaps would look as if it covered the steps between.
            if len(ends) == len(steps):
                label = f"{intervals[0].label} interval" if intervals[0] else ""
                axes.fill_between(steps, *np.transpose(ends), color=colour, alpha=0.2, label=label)
        if all(float(step).is_integer() for step in steps):
            use_round_ticks(axes)
        axes.set_xlabel("step")
        axes.set_ylabel(unit)
        _explain_beside(axes)
        set_heading(axes, f"{len(steps)} checkpoints on {first.split}")
    return axes


def _sorted_steps(scores: Mapping[float, Scored]) -> Sequence[float]:
    """Return the steps of comparable scores, ascending."""
    if not scores:
        raise ProtocolError("there are no scores to draw")
    for step in scores:
        if not isinstance(step, Real):
            raise ProtocolError(f"steps are numbers, such as epochs; got {step!r}")
    check_same_signature(scores.values())
    return sorted(scores)


def plot_comparison(comparison: Comparison, ax: "Axes | None" = None) -> "Axes":
    """Draw the differences from the first submission; see :meth:`Comparison.plot`."""
    first = comparison.scores[comparison.first]
    # Fractions alone: beside metres, their differences would be flat.
    metrics = [
        metric
        for metric in first.ground_truth.task.table_metrics(first.keys())
        if metric.unit == "fraction" and any(metric.key in each for each in comparison.values())
    ]
    height = 0.8 / len(comparison)
    with styled_axes(ax) as axes:
        for number, (name, colour) in enumerate(zip(comparison, cycle(_COLOURS), strict=False)):
            shown = [metric for metric in metrics if metric.key in comparison[name]]
            found = [comparison[name][metric.key] for metric in shown]
            rows = np.array([metrics.index(metric) for metric in shown])
            y = rows + height * (number - (len(comparison) - 1) / 2)
            low = [100 * each.interval.low for each in found]
            high = [100 * each.interval.high for each in found]
            axes.hlines(y, low, high, color=colour, linewidth=2)
            axes.plot([100 * each.mean for each in found], y, "o", color=colour, label=name)
        axes.axvline(0, color=INK, linestyle="--", linewidth=1.2)
        axes.set_yticks(range(len(metrics)), [metric.label for metric in metrics])
        axes.invert_yaxis()
        axes.tick_params(axis="y", length=0)
        label = comparison.intervals[next(iter(comparison))].label
        axes.set_xlabel(f"difference in percentage points, with {label} interval")
        _explain_beside(axes)
        set_heading(axes, f"compared with {comparison.first}")
    return axes


def plot_budgets(curves: Mapping[str, BudgetCurve], ax: "Axes | None" = None) -> "Axes":
    """Draw what share of the episodes runs solved within a budget, with intervals.

    Parameters
    ----------
    curves : mapping of BudgetCurve
        By the names of the runs, for the same cost and metric.
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Raises
    ------
    ReverieEvalError
        If matplotlib is not installed.
    """
    with styled_axes(ax) as axes:
        _draw_chart(budget_chart(curves), axes)
        if any(curves):
            _explain_beside(axes)
        first = next(iter(curves.values()))
        set_heading(axes, f"solved within a budget, with {first.label} intervals")
    return axes


def _plot_histogram(histogram: Histogram, ax: "Axes | None") -> "Axes":
    metric, values = histogram.metric, histogram.values[""]
    with styled_axes(ax) as axes:
        _draw_chart(histogram.chart([""]), axes)
        mean = metric.display(float(np.mean(values)))
        of = f"{len(values):,} {histogram.noun}"
        set_heading(axes, f"{metric.heading}: mean {mean} of {of}")
    return axes


def _plot_walks(walks: WalkLengths, ax: "Axes | None") -> "Axes":
    with styled_axes(ax) as axes:
        _draw_chart(walks.chart(float(np.ceil(walks.walked.max())) or 1.0), axes)
        _explain_beside(axes)
        set_heading(axes, f"a dot for each of {len(walks.walked):,} episodes")
    return axes


def _draw_chart(chart: Chart, axes: "Axes") -> None:
    """Draw a chart on its axes, with the ticks that its SVG has."""
    draw_lines(chart.lines, axes, chart.key)
    axes.set_xlim(chart.low, chart.high)
    axes.set_ylim(0, chart.top)
    axes.set_xticks(chart.x_ticks)
    axes.set_yticks(chart.y_ticks)
    axes.set_xlabel(chart.x_label)
    axes.set_ylabel(chart.y_label)


def _explain_beside(axes: "Axes") -> None:
    """Put the legend to the right of the axes, where it covers nothing."""
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


# Style.


def split_colour(split: str) -> str:
    """Return the colour of a split, the same in every figure."""
    return _SPLIT_COLOURS.get(split, SKY)


def check_figure_name(file: str | Path) -> None:
    """Raise ProtocolError if a name does not end in .svg, .pdf or .png."""
    if Path(file).suffix not in (".svg", ".pdf", ".png"):
        raise ProtocolError(f"{file}: expected a name that ends in .svg, .pdf or .png")


def check_matplotlib() -> None:
    """Raise MissingPartError if matplotlib is not installed."""
    with naming_missing_parts():
        import matplotlib as mpl  # noqa: F401


@contextmanager
def styled_axes(ax: "Axes | None") -> Iterator["Axes"]:
    """Draw on the given Axes in our style, or on new ones of pyplot, which notebooks show."""
    check_matplotlib()
    import matplotlib as mpl
    from matplotlib import pyplot as plt

    plt.install_repl_displayhook()  # if first done in the context, leaving it would undo it
    with mpl.rc_context(dict(STYLE)):
        yield plt.subplots(figsize=(7, 4.2), layout="constrained")[1] if ax is None else ax


def use_round_ticks(axes: "Axes") -> None:
    """Mark whole numbers below the axes, in steps of 1, 2, 5, 10, 20, 50 and so on."""
    from matplotlib.ticker import MaxNLocator

    whole = MaxNLocator(integer=True, steps=[1, 2, 5, 10], min_n_ticks=1)
    axes.xaxis.set_major_locator(whole)


def set_heading(axes: "Axes", heading: str) -> None:
    """Set the heading of a figure, on the left above the axes."""
    axes.set_title(heading, loc="left", fontweight="bold", fontsize="medium")
