"""How a metric's values are distributed over the episodes: bars as data, whoever draws them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.metrics._catalogue import Unit
from reverie_eval.reporting._bins import bin_edges, count_edges
from reverie_eval.scoring import Scores

_MOST_BARS = 60
_PERCENT_EDGES = np.arange(0.0, 101.0, 10.0)
_EDGES: Mapping[Unit, Callable[[FloatArray, int], FloatArray]] = MappingProxyType(
    {"fraction": lambda *_: _PERCENT_EDGES, "metres": bin_edges, "count": count_edges}
)
"""How values are divided into so many bars at most."""


@dataclass(frozen=True, eq=False)
class Histogram:
    """Shares of values between edges, in percent, for one submission or several."""

    metric: Metric
    edges: FloatArray
    """Shape (n_bars + 1,): in percent for fractions, else in the metric's unit."""
    share: Mapping[str, FloatArray]
    """Shape (n_bars,) each, by the submissions' names: percent of its values; a value on an edge
    is counted above it, on the last edge below it."""
    values: Mapping[str, FloatArray]
    """Of all the share is of, in the metric's own unit."""
    nouns: str
    """What the values belong to: episodes, or boxes."""

    @property
    def count(self) -> int:
        """How many values the first submission has."""
        return len(next(iter(self.values.values())))

    @property
    def label(self) -> str:
        """What the values are, with their unit."""
        unit = {"fraction": " (%)", "metres": " (m)", "count": ""}[self.metric.unit]
        return f"{self.metric.name}{unit}"


def histogram_of(scores: Mapping[str, Scores], key: str) -> Histogram:
    """Divide a metric's values into bars.

    What is scored of boxes only is taken of the answers that are boxes.

    Parameters
    ----------
    scores : mapping of Scores
        By name; bars are the same for all.
    key : str
        A metric's.

    Raises
    ------
    KeyError
        If it is not scored.
    """
    values = {name: _values(each, key) for name, each in scores.items()}
    metric = CATALOGUE[key]
    is_share = metric.unit == "fraction"
    shown = {name: (100 if is_share else 1) * each for name, each in values.items()}
    together = np.concatenate(list(shown.values()))
    edges = _EDGES[metric.unit](together, _MOST_BARS)
    return Histogram(
        metric=metric,
        edges=edges,
        share={
            name: 100 * np.histogram(each, edges)[0] / len(each) for name, each in shown.items()
        },
        values=values,
        nouns="boxes" if "box" in CATALOGUE[key].needs else "episodes",
    )


def _values(scores: Scores, key: str) -> FloatArray:
    column = scores.episodes[key]
    if "box" in CATALOGUE[key].needs and scores.boxes is not None:
        return column[scores.boxes.row]
    return column
