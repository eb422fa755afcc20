"""Breakdowns: the same scores over groups of episodes, to see where a method is strong or weak.

Episodes are grouped by something known in advance (building, target, instruction), or by a
property of the trajectory (jumps). The ranges of numbers are fixed, so that breakdowns of several
submissions have the same rows.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray, with_object
from reverie_eval.errors import ProtocolError, naming_missing_parts
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import units_of
from reverie_eval.scoring import FEW_CLUSTERS, Scored, bounds_of, clusters_of
from reverie_eval.text import did_you_mean, first_few, tokenize

if TYPE_CHECKING:
    import pandas as pd

GroupingKey = Literal[
    "scan", "length", "words", "category", "level", "visibility", "jumps", "language"
]
"""The keys of ``GROUPINGS``."""
Grouped: TypeAlias = "GroupingKey | str | pd.Series[Any]"
"""What episodes are grouped by: a key of ``GROUPINGS``, or the group of each episode."""

NO_LEVEL = "no level"
"""The group of episodes whose instruction does not name a level."""

_ORDINALS = {"first": 1, "second": 2, "third": 3, "fourth": 4, "fifth": 5}
_NUMBERS = {"one": 1, "two": 2, "three": 3, "four": 4, "five": 5}
# Only numbers: which level "the top floor" is, depends on the building.
_LEVEL = re.compile(
    rf"\b(?:level|floor)\s+(\d|{'|'.join(_NUMBERS)})\b"
    rf"|\b(?:(\d)(?:st|nd|rd|th)|({'|'.join(_ORDINALS)}))\s+(?:level|floor)\b"
)


@dataclass(frozen=True, slots=True)
class Grouping:
    """A way to divide the episodes into groups."""

    key: str
    meaning: str
    """What episodes are grouped by."""
    groups: Callable[[Scored], Sequence[str]]
    """Returns the group of each episode."""
    order: Sequence[str] = ()
    """The groups in order; if empty, they are sorted by size, the largest first."""
    wider: Callable[[str], Sequence[str]] = lambda group: ()  # noqa: ARG005
    """Returns the other groups that the episodes of a group also belong to."""

    def __reduce__(self) -> tuple[Callable[[str], "Grouping"], tuple[str]]:
        """Let another process find it by its key: functions cannot all be sent."""
        return find_grouping, (self.key,)


@dataclass(frozen=True, slots=True)
class _Ranges:
    """Labelled ranges of numbers: one from each of ``starts``, and one below them all."""

    starts: Sequence[int]
    unit: str
    are_counts: bool = False
    """Whether the numbers are integers from 1."""

    @property
    def labels(self) -> Sequence[str]:
        """The labels, the lowest range first."""
        between = [self._label(start, end) for start, end in pairwise(self.starts)]
        first, last = self.starts[0], self.starts[-1]
        lowest = self._label(1, first) if self.are_counts else f"below {first}"
        return [f"{label} {self.unit}".rstrip() for label in (lowest, *between, f"{last} or more")]

    def _label(self, start: int, end: int) -> str:
        last = end - 1 if self.are_counts else end
        return f"{start}" if last == start else f"{start} to {last}"

    def of(self, values: Array) -> Sequence[str]:
        """Return the label of each value; a value on a boundary is in the upper range."""
        labels = self.labels
        return [labels[index] for index in np.digitize(values, self.starts)]


_LENGTHS = _Ranges((6, 8, 10, 12, 15), "m")
_WORDS = _Ranges((12, 16, 20, 25), "words", are_counts=True)
_VIEWPOINTS = _Ranges((2, 3, 4, 6), "", are_counts=True)
_LEVELS = (*(f"level {number}" for number in range(10)), NO_LEVEL)
_JUMPS = ("no jump", "jumps")
_ALL_LANGUAGES = "all"
# The slices that papers on RxR report, and the tags of its instructions.
_LANGUAGES = (_ALL_LANGUAGES, "en", "en-IN", "en-US", "hi", "hi-IN", "te", "te-IN")


def _by_length(scores: Scored) -> Sequence[str]:
    truth = scores.ground_truth
    goal = truth.require_solution().goal
    return _LENGTHS.of(truth.graph.distance_between(truth.episodes.start, goal))


def _by_words(scores: Scored) -> Sequence[str]:
    instructions = scores.ground_truth.episodes.instructions
    return _WORDS.of(np.array([len(tokenize(instruction)) for instruction in instructions]))


def level_in(instruction: str) -> str:
    """Return the level of the building that an instruction names.

    The dataset does not annotate levels, but annotators were shown them, and many wrote them down.

    >>> level_in("Go to the bathroom on level 2"), level_in("the first floor kitchen")
    ('level 2', 'level 1')
    >>> level_in("clean the floor")
    'no level'
    """
    match = _LEVEL.search(instruction.lower())
    if match is None:
        return NO_LEVEL
    word = next(filter(None, match.groups()))
    return f"level {_ORDINALS.get(word) or _NUMBERS.get(word) or word}"


def _by_visibility(scores: Scored) -> Sequence[str]:
    """Group by the number of viewpoints from which the target is visible."""
    truth = scores.ground_truth
    solution = truth.require_targets()
    scan = truth.graph.viewpoint_scan
    seen = with_object(scan[solution.candidate_viewpoint], solution.candidate_object)
    objects, counts = np.unique(seen, return_counts=True)
    targets = with_object(scan[truth.episodes.start], solution.target_object)
    # Every target is among the objects: the compiler rejects one that is not visible at its goal.
    return _VIEWPOINTS.of(counts[np.searchsorted(objects, targets)])


def _by_jumps(scores: Scored) -> Sequence[str]:
    if "jumps" not in scores:
        raise ProtocolError("this track ignores trajectories, so there are no jumps")
    return [_JUMPS[int(jumps > 0)] for jumps in scores.episodes["jumps"]]


def _by_language(scores: Scored) -> Sequence[str]:
    languages = scores.ground_truth.episodes.languages
    return languages or [_ALL_LANGUAGES] * len(scores.instr_ids)


def _wider_languages(tag: str) -> Sequence[str]:
    """Return what an ``en-US`` instruction is too: of English, and of all.

    >>> _wider_languages("en-US"), _wider_languages("all")
    (['all', 'en'], [])
    """
    return [] if tag == _ALL_LANGUAGES else [_ALL_LANGUAGES, tag.partition("-")[0]]


GROUPINGS: Mapping[str, Grouping] = MappingProxyType(
    {
        grouping.key: grouping
        for grouping in (
            Grouping("scan", "the building", lambda scores: scores.ground_truth.scans),
            Grouping("length", "the shortest length to the goal", _by_length, _LENGTHS.labels),
            Grouping("words", "the number of words in the instruction", _by_words, _WORDS.labels),
            Grouping(
                "category",
                "the annotated category of the target",
                lambda scores: scores.ground_truth.categories,
            ),
            Grouping(
                "level",
                "the level given in the instruction",
                lambda scores: list(map(level_in, scores.ground_truth.episodes.instructions)),
                _LEVELS,
            ),
            Grouping(
                "visibility",
                "the number of viewpoints from which the target is visible",
                _by_visibility,
                _VIEWPOINTS.labels,
            ),
            Grouping("jumps", "moves between unconnected viewpoints", _by_jumps, _JUMPS),
            Grouping(
                "language",
                "the language of the instruction",
                _by_language,
                _LANGUAGES,
                _wider_languages,
            ),
        )
    }
)
"""The groupings by key."""


def find_grouping(key: str) -> Grouping:
    """Return the grouping with a key.

    Raises
    ------
    ProtocolError
        If there is no such grouping.
    """
    if key not in GROUPINGS:
        raise ProtocolError(f"unknown grouping {key!r}{did_you_mean(key, GROUPINGS)}")
    return GROUPINGS[key]


def breakdown(
    scores: Scored,
    by: "Grouped | Sequence[Grouped]",
    *,
    intervals: bool = False,
    confidence: float | None = None,
) -> "pd.DataFrame":
    """Score each group of episodes separately; see :meth:`Scored.breakdown`."""
    with naming_missing_parts():
        import pandas as pd

    chosen = [by] if isinstance(by, str | pd.Series) else list(by)
    if not chosen:
        raise ProtocolError(f"break scores down by something, such as {first_few(GROUPINGS)}")
    keys = [metric.key for metric in scores.headline]
    values = pd.DataFrame({key: scores.episodes[key] for key in keys})
    # A row for each combination of groups that an episode is in: one, unless groups overlap.
    member = pd.DataFrame(index=values.index)
    groups = [_groups(scores, each) for each in chosen]
    for column, each in enumerate(groups):
        member = member.join(each.rename(column))
    row = member.index.to_numpy()
    grouped = values.iloc[row].groupby([member[column].array for column in member], observed=True)
    table = grouped.mean()
    if intervals:
        number = grouped.ngroup().to_numpy()
        rows = [row[number == group] for group in range(len(table))]
        table = table.assign(**_interval_columns(values, rows, scores.ground_truth, confidence))
    table.insert(0, "episodes", grouped.size())
    # Categories gave the groups their order; readers get the groups themselves.
    names = [column.name for column in groups]
    found = table.index.tolist()
    table.index = (
        pd.Index(found, name=names[0])
        if len(names) == 1
        else pd.MultiIndex.from_tuples(found, names=names)
    )
    ends = ("", "_low", "_high") if intervals else ("",)
    units = {f"{key}{end}": unit for key, unit in units_of(keys).items() for end in ends}
    table.attrs["units"] = {"episodes": "count", **units}
    return table


def _groups(scores: Scored, by: "Grouped") -> "pd.Series[Any]":
    """Return the groups of each row of episodes, as categories in their order."""
    import pandas as pd

    index = pd.Index(scores.instr_ids)
    if isinstance(by, pd.Series):
        known = by.dropna()
        wrong = [*known.index[known.index.duplicated()], *index.difference(known.index)]
        if wrong:
            raise ProtocolError(
                f"the Series does not have one group for each episode, such as {first_few(wrong)}; "
                "index it by instr_id, as scores.to_pandas() is"
            )
        groups = pd.Series(known.reindex(index).array, name=by.name or "group")
        return groups.astype("category")
    grouping = find_grouping(by)
    # An episode with a wider language has a row for each: explode repeats its index.
    narrow = pd.Series(grouping.groups(scores), name=by)
    groups = narrow.map(lambda group: [*grouping.wider(group), group]).explode()
    # The largest group first; equally large ones by name.
    order = (
        grouping.order
        or groups.value_counts()
        .sort_index()
        .sort_values(ascending=False, kind="stable")
        .index.tolist()
    )
    return groups.astype(pd.CategoricalDtype(list(order)))


def _interval_columns(
    values: "pd.DataFrame",
    groups: Sequence[IntArray],
    truth: GroundTruth,
    confidence: float | None,
) -> dict[str, FloatArray]:
    """Compute the intervals of groups, each given by the rows of its episodes."""
    # scipy is needed for intervals only.
    from reverie_eval.metrics.engine import IntervalEngine

    engine = IntervalEngine.of(confidence)
    cluster, table = clusters_of(truth, "target"), values.to_numpy()
    bounds = bounds_of(map(str, values), attrgetter("bounds"))
    ends = np.full((len(groups), 2, table.shape[1]), np.nan)
    for group, rows in enumerate(groups):
        # Of fewer clusters, an interval would say more about its method than about the group.
        if len(np.unique(cluster[rows])) >= FEW_CLUSTERS:
            ends[group] = engine.of_means(table[rows], cluster[rows], bounds).ends
    return {
        f"{key}_{name}": ends[:, end, column]
        for column, key in enumerate(values)
        for end, name in enumerate(("low", "high"))
    }
