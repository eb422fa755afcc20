"""The catalogue of metrics: what the command line, the notebook and the docs all read."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Unit = Literal["fraction", "metres", "count"]
Direction = Literal["higher", "lower", "neither"]

_SUFFIXES: Mapping[Unit, str] = MappingProxyType({"fraction": "%", "metres": "m", "count": ""})


@dataclass(frozen=True, slots=True)
class Metric:
    """What a metric is called, measured in, and means; values lie in ``[0, upper_bound]``."""

    key: str
    label: str
    name: str
    unit: Unit
    better: Direction
    definition: str
    headline: bool = False
    """Whether every score table shows it; JSON, CSV and the notebook give all of them."""

    @property
    def upper_bound(self) -> float:
        """The largest value an episode can have."""
        return 1.0 if self.unit == "fraction" else float("inf")

    @property
    def heading(self) -> str:
        """The label with the unit that :meth:`display` uses: ``SR %``."""
        return f"{self.label} {_SUFFIXES[self.unit]}".rstrip()

    def rounded(self, value: float) -> float:
        """Round to the digits that :meth:`display` shows.

        >>> CATALOGUE["success"].rounded(0.54532677), CATALOGUE["path_length"].rounded(9.4734)
        (0.5453, 9.47)
        """
        return round(value, 4 if self.unit == "fraction" else 2)

    def display(self, value: float) -> str:
        """Write a value for people: fractions in percent, two decimals.

        >>> CATALOGUE["success"].display(0.54532677)
        '54.53'
        """
        return f"{100 * value if self.unit == 'fraction' else value:.2f}"


_METRICS = (
    Metric(
        "path_length",
        "TL",
        "trajectory length",
        "metres",
        "neither",
        "metres along the navigation graph from pose to pose",
        headline=True,
    ),
    Metric(
        "success",
        "SR",
        "success rate",
        "fraction",
        "higher",
        "the target object is visible where the agent stops",
        headline=True,
    ),
    Metric(
        "oracle_success",
        "OSR",
        "oracle success rate",
        "fraction",
        "higher",
        "the target object is visible from any viewpoint of the trajectory",
        headline=True,
    ),
    Metric(
        "spl",
        "SPL",
        "success weighted by path length",
        "fraction",
        "higher",
        "success, times the shortest length over the larger of walked and shortest length",
        headline=True,
    ),
    Metric(
        "rgs",
        "RGS",
        "remote grounding success",
        "fraction",
        "higher",
        "the object that the agent names is the target object, or the box that it draws matches",
        headline=True,
    ),
    Metric(
        "rgspl",
        "RGSPL",
        "remote grounding success weighted by path length",
        "fraction",
        "higher",
        "remote grounding success, weighted as SPL is; the benchmark's primary metric",
        headline=True,
    ),
    Metric(
        "iou",
        "IoU",
        "intersection over union",
        "fraction",
        "higher",
        "of the answer's box with the target's in the same view; 0 where the answer is no box",
    ),
    Metric(
        "iou_25",
        "IoU>=.25",
        "boxes with an IoU of at least one quarter",
        "fraction",
        "higher",
        "the answer is a box whose IoU is at least 0.25",
    ),
    Metric(
        "iou_50",
        "IoU>=.5",
        "boxes with an IoU of at least one half",
        "fraction",
        "higher",
        "the answer is a box whose IoU is at least 0.5, the benchmark's threshold",
    ),
    Metric(
        "iou_75",
        "IoU>=.75",
        "boxes with an IoU of at least three quarters",
        "fraction",
        "higher",
        "the answer is a box whose IoU is at least 0.75",
    ),
    Metric(
        "navigation_error",
        "NE",
        "navigation error",
        "metres",
        "lower",
        "metres along the navigation graph from the stop to the end of the annotated path",
    ),
    Metric(
        "oracle_error",
        "ONE",
        "oracle navigation error",
        "metres",
        "lower",
        "metres from the trajectory's nearest viewpoint to the end of the annotated path",
    ),
    Metric(
        "dtw",
        "DTW",
        "dynamic time warping",
        "metres",
        "lower",
        "least total distance of an alignment of trajectory and annotated path in order",
    ),
    Metric(
        "ndtw",
        "nDTW",
        "normalised dynamic time warping",
        "fraction",
        "higher",
        "exp(-DTW / (3 m x nodes of the annotated path))",
    ),
    Metric(
        "sdtw",
        "SDTW",
        "success weighted by normalised dynamic time warping",
        "fraction",
        "higher",
        "nDTW of successful episodes, 0 of others",
    ),
    Metric(
        "cls",
        "CLS",
        "coverage weighted by length score",
        "fraction",
        "higher",
        "how near the trajectory comes to the annotated path, times how well the lengths agree",
    ),
    Metric(
        "shortest_length",
        "S",
        "shortest length",
        "metres",
        "neither",
        "metres of the shortest route from the start to the end of the annotated path",
    ),
    Metric(
        "steps",
        "steps",
        "steps",
        "count",
        "neither",
        "poses after the first one",
    ),
    Metric(
        "jumps",
        "jumps",
        "jumps",
        "count",
        "lower",
        "moves between viewpoints that no edge joins, priced at their shortest distance",
    ),
)

CATALOGUE: Mapping[str, Metric] = MappingProxyType({metric.key: metric for metric in _METRICS})
"""Every metric by its key, in the order in which tables show them."""

BOX_METRICS = frozenset({"iou", "iou_25", "iou_50", "iou_75"})
"""What is scored only where some answers are boxes."""

BINARY_METRICS = frozenset({"success", "oracle_success", "rgs", "iou_25", "iou_50", "iou_75"})
"""What an episode has or has not: values are 0 and 1."""

PRIMARY_METRIC = "rgspl"
"""What the benchmark ranks by (REVERIE challenge rules, 2020 to 2022)."""


def table_metrics(scored: Collection[str]) -> Sequence[Metric]:
    """Return what a score table shows: the headline, and what is scored of boxes if any are."""
    shown = (metric for metric in CATALOGUE.values() if metric.key in scored)
    return [metric for metric in shown if metric.headline or metric.key in BOX_METRICS]


def primary_of(scored: Collection[str]) -> Metric:
    """Return what decides which is better: RGSPL, and where that is not scored RGS, or SPL."""
    return CATALOGUE[next(key for key in (PRIMARY_METRIC, "rgs", "spl") if key in scored)]


def units_of(keys: Iterable[str]) -> dict[str, Unit]:
    """Return what metrics are measured in, as data frames carry it.

    >>> units_of(["path_length", "success"])
    {'path_length': 'metres', 'success': 'fraction'}
    """
    return {key: CATALOGUE[key].unit for key in keys}
