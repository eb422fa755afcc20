"""Slices: the same scores over parts of the episodes, to see where a method is strong or weak.

Whatever a slice is cut by is known of the episode beforehand (its building, its target, its words),
or of the trajectory (jumps). Numbers are cut into ranges that are the same for every submission.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray
from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.intervals import FEW_CLUSTERS, clusters_of
from reverie_eval.metrics import units_of
from reverie_eval.wording import category_in_words
from reverie_eval.words import words_of

if TYPE_CHECKING:
    import pandas as pd

    from reverie_eval.scores import Scores

NO_CATEGORY = "not said"
"""The part of the episodes whose target the annotators call nothing."""
NO_LEVEL = "no number said"
"""The part of the episodes whose instruction names no level, or none by its number."""

_ORDINALS = {"first": 1, "second": 2, "third": 3, "fourth": 4, "fifth": 5}
_NUMBERS = {"one": 1, "two": 2, "three": 3, "four": 4, "five": 5}
_LEVEL = re.compile(
    rf"\b(?:level|floor)\s+(\d|{'|'.join(_NUMBERS)})\b"
    rf"|\b(?:(\d)(?:st|nd|rd|th)|({'|'.join(_ORDINALS)}))\s+(?:level|floor)\b"
)


@dataclass(frozen=True, slots=True)
class Slicing:
    """A way to cut the episodes into parts."""

    key: str
    meaning: str
    """What an episode's part is."""
    parts: "Callable[[Scores], Sequence[str]]"
    """The part of each episode."""
    order: Sequence[str] = ()
    """Of the parts; without it, the one with most episodes comes first."""


@dataclass(frozen=True, slots=True)
class _Ranges:
    """Ranges of numbers, in words; each begins with one of ``starts``, the first with less."""

    starts: Sequence[int]
    unit: str
    are_whole: bool = False
    """Whether the numbers are counts, from 1."""

    @property
    def labels(self) -> Sequence[str]:
        """The ranges' names, the lowest first."""
        between = [self._name(start, end) for start, end in pairwise(self.starts)]
        first, last = self.starts[0], self.starts[-1]
        lowest = self._name(1, first) if self.are_whole else f"below {first}"
        return [f"{name} {self.unit}".rstrip() for name in (lowest, *between, f"{last} or more")]

    def _name(self, start: int, end: int) -> str:
        last = end - 1 if self.are_whole else end
        return f"{start}" if last == start else f"{start} to {last}"

    def of(self, values: Array) -> Sequence[str]:
        """Name the range of each value; a value on a border is in the upper range."""
        labels = self.labels
        return [labels[number] for number in np.digitize(values, self.starts)]


_LENGTHS = _Ranges((6, 8, 10, 12, 15), "m")
_WORDS = _Ranges((12, 16, 20, 25), "words", are_whole=True)
_SIGHTS = _Ranges((2, 3, 4, 6), "", are_whole=True)
_LEVELS = (*(f"level {number}" for number in range(10)), NO_LEVEL)
_JUMPS = ("no jump", "jumps")


def _scan(scores: "Scores") -> Sequence[str]:
    graph = scores.ground_truth.graph
    return [graph.scan_of(start) for start in scores.ground_truth.episodes.start]


def _length(scores: "Scores") -> Sequence[str]:
    truth = scores.ground_truth
    return _LENGTHS.of(truth.graph.distance_between(truth.episodes.start, truth.secret.goal))


def _words(scores: "Scores") -> Sequence[str]:
    instructions = scores.ground_truth.episodes.instructions
    return _WORDS.of(np.array([len(words_of(instruction)) for instruction in instructions]))


def _category(scores: "Scores") -> Sequence[str]:
    truth = scores.ground_truth
    categories = [_category_named(name) for name in truth.secret.target_categories]
    return [categories[task] for task in truth.episodes.task]


def _category_named(name: str) -> str:
    return category_in_words(name).strip().lower() or NO_CATEGORY


def _level(scores: "Scores") -> Sequence[str]:
    return [level_named(text) for text in scores.ground_truth.episodes.instructions]


def level_named(instruction: str) -> str:
    """Return the level of the building that an instruction names by its number.

    The dataset has no levels of its own; annotators were shown one, and many wrote it down.

    >>> level_named("Go to the bathroom on level 2"), level_named("the first floor kitchen")
    ('level 2', 'level 1')
    >>> level_named("clean the floor")
    'no number said'
    """
    found = _LEVEL.search(instruction.lower())
    if found is None:
        return NO_LEVEL
    word = next(filter(None, found.groups()))
    return f"level {_ORDINALS.get(word) or _NUMBERS.get(word) or word}"


def _visibility(scores: "Scores") -> Sequence[str]:
    return _SIGHTS.of(_viewpoints_that_see(scores))


def _viewpoints_that_see(scores: "Scores") -> IntArray:
    """Count the viewpoints from which each episode's target is visible."""
    truth, answers = scores.ground_truth, scores.ground_truth.secret
    scan = truth.graph.viewpoint_scan.astype(np.int64)
    seen = (scan[answers.candidate_viewpoint] << 32) | answers.candidate_object
    objects, counts = np.unique(seen, return_counts=True)
    targets = (scan[truth.episodes.start] << 32) | answers.target_object
    sights: IntArray = counts[np.searchsorted(objects, targets)]
    return sights


def _jumps(scores: "Scores") -> Sequence[str]:
    if "jumps" not in scores:
        raise ProtocolError("this track does not look at trajectories, and so at no jumps")
    return [_JUMPS[int(jumps > 0)] for jumps in scores.episodes["jumps"]]


SLICINGS: Mapping[str, Slicing] = MappingProxyType(
    {
        slicing.key: slicing
        for slicing in (
            Slicing("scan", "the building", _scan),
            Slicing("length", "the shortest length to the goal", _length, _LENGTHS.labels),
            Slicing("words", "the words of the instruction", _words, _WORDS.labels),
            Slicing("category", "what the annotators call the target", _category),
            Slicing("level", "the level that the instruction names", _level, _LEVELS),
            Slicing(
                "visibility",
                "the number of viewpoints that see the target",
                _visibility,
                _SIGHTS.labels,
            ),
            Slicing("jumps", "moves of the trajectory that no edge joins", _jumps, _JUMPS),
        )
    }
)
"""The ways to cut, by key."""


def slicing_named(key: str) -> Slicing:
    """Return a way to cut.

    Raises
    ------
    ProtocolError
        If there is none of that name.
    """
    if key not in SLICINGS:
        raise ProtocolError(
            f"episodes are not cut by {key!r}; choose one of: {', '.join(SLICINGS)}"
        )
    return SLICINGS[key]


def breakdown(scores: "Scores", by: str, *, intervals: bool = False) -> "pd.DataFrame":
    """Score each part of the episodes for itself.

    Parameters
    ----------
    by : str
        A key of ``SLICINGS``.
    intervals : bool
        Whether to add the ends of a 95 % interval for every metric, ``spl_low`` and ``spl_high``:
        as ``scores.with_intervals()`` draws it, over the targets of the part. Missing where these
        are fewer than 5.

    Returns
    -------
    DataFrame
        A row per part that has episodes, with their number and the mean of every headline metric,
        in the metrics' own units, which ``attrs["units"]`` names by column.

    Raises
    ------
    ProtocolError
        If there is no such way to cut, or the track does not score what it needs.
    GroundTruthError
        If the ground truth was compiled without what it needs.
    """
    import pandas as pd

    slicing = slicing_named(by)
    keys = [metric.key for metric in scores.headline]
    values = pd.DataFrame({key: scores.episodes[key] for key in keys})
    parts = np.array(slicing.parts(scores))
    grouped = values.groupby(parts)
    table = grouped.mean()
    if intervals:
        rows = [np.flatnonzero(parts == part) for part in table.index]
        table = table.assign(**_interval_columns(values, rows, scores.ground_truth))
    table.insert(0, "episodes", grouped.size())
    table = table.rename_axis(index=by)
    ends = ("", "_low", "_high") if intervals else ("",)
    units = {f"{key}{end}": unit for key, unit in units_of(keys).items() for end in ends}
    table.attrs["units"] = {"episodes": "count", **units}
    if slicing.order:
        return table.reindex([part for part in slicing.order if part in table.index])
    return table.sort_values("episodes", ascending=False, kind="stable")


def _interval_columns(
    values: "pd.DataFrame", parts: Sequence[IntArray], truth: GroundTruth
) -> dict[str, FloatArray]:
    """Draw the intervals of parts, given by the rows of their episodes."""
    cluster = clusters_of(truth, "target")
    table = values.to_numpy()
    bounds = np.stack([_bounds(table[rows], cluster[rows]) for rows in parts])
    return {
        f"{key}_{end}": bounds[:, row, column]
        for column, key in enumerate(values)
        for row, end in enumerate(("low", "high"))
    }


def _bounds(values: FloatArray, cluster: IntArray) -> FloatArray:
    """Return the ends of the intervals of a part, shape (2, n_metrics)."""
    from reverie_eval.metrics.uncertainty import bootstrap_means, interval

    n_clusters = len(np.unique(cluster))
    if n_clusters < FEW_CLUSTERS:
        return np.full((2, values.shape[1]), np.nan)
    return interval(bootstrap_means(values, cluster), n_clusters)
