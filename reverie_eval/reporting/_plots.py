"""Figures of scores, for notebooks: ``scores.plot.funnel()``. matplotlib is imported when drawing.

Every figure is drawn on Axes that are given, or on new ones, and returns them.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from reverie_eval.analysis import Episode
from reverie_eval.errors import ReverieEvalError
from reverie_eval.scoring import Scores

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Plots:
    """What can be drawn of scores; ``ax`` is where, on new Axes if not given.

    All raise ReverieEvalError if matplotlib is not installed.
    """

    scores: Scores

    def funnel(self, ax: "Axes | None" = None) -> "Axes":
        """Draw how many episodes came how far: to the goal, to a stop there, to the answer.

        Percentages are of all episodes.

        Raises
        ------
        ProtocolError
            If the protocol or track scores no outcomes.
        """
        _demand_matplotlib()
        from reverie_eval.reporting._score_figures import draw_funnel

        return _drawn(lambda axes: draw_funnel(self.scores, axes), ax)

    def slices(self, by: str, ax: "Axes | None" = None) -> "Axes":
        """Draw success and what ranks over parts of the episodes, the latter with an interval.

        What ranks is RGSPL, and where that is not scored RGS, or SPL. Its 95 % interval is over the
        part's targets; parts of fewer than 5 have none.

        Parameters
        ----------
        by : str
            A key of ``slices.SLICINGS``: ``scan``, ``category``, ``length`` ...
        ax : Axes, optional

        Raises
        ------
        ProtocolError
            If there is no such way to cut.
        GroundTruthError
            If the ground truth was compiled without what it needs.
        """
        _demand_matplotlib()
        from reverie_eval.reporting._score_figures import draw_slices

        return _drawn(lambda axes: draw_slices(self.scores, by, axes), ax)

    def distribution(self, metric: str, ax: "Axes | None" = None) -> "Axes":
        """Draw how a metric's values are distributed.

        ``path_length`` is drawn over the shortest length, a dot for each episode; all others as
        bars, box metrics over the answers that are boxes.

        Raises
        ------
        KeyError
            If the metric is not scored.
        """
        _demand_matplotlib()
        from reverie_eval.reporting._score_figures import draw_distribution

        return _drawn(lambda axes: draw_distribution(self.scores, metric, axes), ax)


def plot_episode(episode: Episode, ax: "Axes | None" = None) -> "Axes":
    """Draw an episode on its scan's navigation graph; see :meth:`Episode.plot`."""
    _demand_matplotlib()
    from reverie_eval.reporting._map_figure import draw_map
    from reverie_eval.reporting._maps import EpisodeMap

    return _drawn(lambda axes: draw_map(EpisodeMap.of({"": episode}), axes), ax)


def _demand_matplotlib() -> None:
    try:
        import matplotlib as mpl  # noqa: F401  # whether it is there is all that matters
    except ModuleNotFoundError as error:
        raise ReverieEvalError(
            "figures need matplotlib; install it with: pip install 'reverie-eval[figures]'"
        ) from error


def _drawn(draw: "Callable[[Axes], None]", ax: "Axes | None") -> "Axes":
    """Draw in the style of all figures; new Axes are pyplot's, which notebooks show."""
    import matplotlib as mpl
    from matplotlib import pyplot as plt

    from reverie_eval.reporting._figure_style import STYLE

    plt.install_repl_displayhook()  # a notebook's, which would be taken back below if set there
    with mpl.rc_context(dict(STYLE)):
        axes = plt.subplots(figsize=(7, 4.2), layout="constrained")[1] if ax is None else ax
        draw(axes)
    return axes
