"""Methods of scores, comparisons and episodes beyond their data: figures, maps, tables, reports.

Their packages are below analysis and reporting and cannot import them, so the methods are attached
here when ``reverie_eval`` is imported. Heavy packages are imported when a method is called.
"""

from typing import TYPE_CHECKING

from reverie_eval.analysis import (
    Comparison,
    Episode,
    Gallery,
    Runs,
    breakdown,
    episode,
    gallery,
)
from reverie_eval.scoring import Scores

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from reverie_eval.reporting.comparisons import ComparisonReport
    from reverie_eval.reporting.figures import Plots


def _plots(scores: Scores) -> "Plots":
    """Figures of these scores, ``scores.plot.funnel()``; they need matplotlib."""
    from reverie_eval.reporting.figures import Plots

    return Plots(scores)


def _scores_html(scores: Scores) -> str:
    """Show the score table in a notebook."""
    from reverie_eval.reporting.scores import score_table

    return score_table([scores]).to_html()


def _runs_html(runs: Runs) -> str:
    """Show the runs and their mean in a notebook."""
    from reverie_eval.reporting.scores import runs_table

    return runs_table(runs).to_html()


def _comparison_report(comparison: Comparison) -> "ComparisonReport":
    """Return the comparison report, which ``--format json`` prints."""
    from reverie_eval.reporting.comparisons import comparison_report

    return comparison_report(comparison)


def _comparison_html(comparison: Comparison) -> str:
    """Show the comparison in a notebook."""
    from reverie_eval.reporting.comparisons import comparison_html

    return comparison_html(comparison)


def _plot_comparison(comparison: Comparison, ax: "Axes | None" = None) -> "Axes":
    """Draw the differences from the first submission, with their intervals. Needs matplotlib.

    Every metric of the score table that is a fraction has a row.

    Parameters
    ----------
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Raises
    ------
    ReverieEvalError
        If matplotlib is not installed.
    """
    from reverie_eval.reporting.figures import plot_comparison

    return plot_comparison(comparison, ax)


def _gallery_html(shown: Gallery) -> str:
    """Show near misses in a notebook, each with its map and answer."""
    from reverie_eval.reporting.map_svg import gallery_html

    return gallery_html(shown)


def _plot_episode(shown: Episode, ax: "Axes | None" = None) -> "Axes":
    """Draw the episode on its scan's navigation graph, seen from above. Needs matplotlib.

    Parameters
    ----------
    ax : Axes, optional
        Where to draw; a new figure if not given.

    Raises
    ------
    ReverieEvalError
        If matplotlib is not installed.
    """
    from reverie_eval.reporting.figures import plot_episode

    return plot_episode(shown, ax)


def _episode_html(shown: Episode) -> str:
    """Show the map of the episode in a notebook, with its instruction and outcome."""
    from reverie_eval.reporting.map_svg import episode_html

    return episode_html(shown)


def attach_methods() -> None:
    """Attach the methods to their classes."""
    Scores.breakdown = breakdown
    Scores.episode = episode
    Scores.gallery = gallery
    Scores.plot = property(_plots)
    Scores._repr_html_ = _scores_html
    Runs._repr_html_ = _runs_html
    Comparison.to_report = _comparison_report
    Comparison.plot = _plot_comparison
    Comparison._repr_html_ = _comparison_html
    Gallery._repr_html_ = _gallery_html
    Episode.plot = _plot_episode
    Episode._repr_html_ = _episode_html
