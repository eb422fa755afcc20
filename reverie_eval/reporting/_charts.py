"""The data of charts: the report draws them as SVG, notebooks with matplotlib."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from types import MappingProxyType
from typing import Self

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.metrics import METRICS, Metric
from reverie_eval.metrics._catalogue import Unit
from reverie_eval.scoring import Scores

_MOST_BARS = 60
_SHOWN_WALKS = 99
"""Percent of the walks that a chart shows: a few walks of hundreds of metres would squeeze all
others together."""
_MILLIMETRE = 1e-3


def round_numbers() -> Iterator[int]:
    """Count 1, 2, 5, 10, 20, 50, 100 and so on."""
    return (digit * 10**exponent for exponent in count() for digit in (1, 2, 5))


def bin_edges(values: FloatArray, most: int) -> FloatArray:
    """Divide the range of values into at most ``most`` bins, 1, 2, 5, 10, 20, 50 ... wide.

    >>> bin_edges(np.array([3.2, 5.0]), 3)
    array([3., 4., 5., 6.])
    """
    first, last = np.floor(values.min()), np.floor(values.max()) + 1
    width = next(width for width in round_numbers() if (last - first) / width <= most)
    return np.arange(np.floor(first / width) * width, last + width, width)


def count_edges(counts: FloatArray, most: int) -> FloatArray:
    """Divide a range of counts in the same way; a bin of a single count is centred on it.

    >>> count_edges(np.array([3.0, 5.0]), 3), count_edges(np.array([3.0, 5.0]), 2)
    (array([2.5, 3.5, 4.5, 5.5]), array([2., 4., 6.]))
    """
    edges = bin_edges(counts, most)
    return edges - 0.5 if edges[1] - edges[0] == 1 else edges


_PERCENT_EDGES = np.arange(0.0, 101.0, 10.0)
_TURN_EDGES = np.arange(0.0, 1.01, 0.1)
_EDGES: Mapping[Unit, Callable[[FloatArray, int], FloatArray]] = MappingProxyType(
    {
        "fraction": lambda *_: _PERCENT_EDGES,
        "metres": bin_edges,
        "count": count_edges,
        "turns": lambda *_: _TURN_EDGES,
    }
)


@dataclass(frozen=True, eq=False)
class Histogram:
    """How a metric's values are distributed, for one submission or several in the same bins."""

    metric: Metric
    edges: FloatArray
    """Shape (n_bins + 1,): in percent for fractions, otherwise in the metric's unit."""
    share: Mapping[str, FloatArray]
    """By submission, shape (n_bins,): percent of its values. A value on an edge counts in the bin
    above it; on the last edge, in the bin below."""
    values: Mapping[str, FloatArray]
    """By submission: all its values, in the metric's own unit."""
    noun: str
    """What the values belong to: episodes or boxes."""

    @classmethod
    def of(cls, scores: Mapping[str, Scores], key: str) -> Self:
        """Divide a metric's values into bins; for box metrics, those of predicted boxes only.

        ``scores`` are by the submissions' names. A metric that is not scored is a KeyError.
        """
        values = {name: each.episodes[key] for name, each in scores.items()}
        metric = METRICS[key]
        is_of_boxes = "box" in metric.needs
        if is_of_boxes:
            boxes = {name: each.boxes for name, each in scores.items() if each.boxes is not None}
            values |= {name: values[name][each.row] for name, each in boxes.items()}
        if metric.is_partial:
            values = {name: each[~np.isnan(each)] for name, each in values.items()}
        scale = 100 if metric.unit == "fraction" else 1
        shown = {name: scale * each for name, each in values.items()}
        edges = _EDGES[metric.unit](np.concatenate(list(shown.values())), _MOST_BARS)
        share = {
            name: 100 * np.histogram(each, edges)[0] / len(each) for name, each in shown.items()
        }
        return cls(metric, edges, share, values, "boxes" if is_of_boxes else "episodes")

    @property
    def label(self) -> str:
        """The metric's name with the unit of the edges."""
        unit = self.metric.suffix
        return f"{self.metric.name} ({unit})" if unit else self.metric.name


@dataclass(frozen=True, eq=False)
class Walks:
    """Walked and shortest length of every episode; all shapes are (n_episodes,)."""

    shortest: FloatArray
    """Metres."""
    walked: FloatArray
    """Metres."""
    is_success: BoolArray

    @classmethod
    def of(cls, scores: Scores) -> Self:
        """Take the lengths from a submission's scores."""
        episodes = scores.episodes
        is_success = episodes["success"] > 0
        return cls(episodes["shortest_length"], episodes["path_length"], is_success)

    @property
    def longest_shown(self) -> float:
        """The longest walk that a chart shows, in whole metres; nearly all walks are shorter."""
        nearly_all = float(np.percentile(self.walked, _SHOWN_WALKS))
        return float(np.ceil(max(nearly_all, float(self.shortest.max()), 1.0)))

    @property
    def is_shown(self) -> BoolArray:
        """Whether the walk is short enough for a chart."""
        return self.walked <= self.longest_shown

    @property
    def is_detour(self) -> BoolArray:
        """Whether the walk is longer than the shortest, by more than rounding."""
        return self.walked > self.shortest + _MILLIMETRE
