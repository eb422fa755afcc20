"""The catalogue of metrics: one entry each, which the scorer, tables, pages and docs all read.

To add a metric, write its function in this package and an entry here. ``inputs`` names the
function's arguments in order. Each is a property of :class:`reverie_eval.scoring.EpisodeTable`,
:class:`reverie_eval.scoring.Lookups` or :class:`reverie_eval.scoring.Protocol`, or the key of
another metric.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Literal

import numpy as np

from reverie_eval.arrays import Array
from reverie_eval.metrics._grounding import (
    IOU_THRESHOLD,
    LOOSE_IOU_THRESHOLD,
    STRICT_IOU_THRESHOLD,
    detection_success,
    elevation_error,
    heading_error,
    iou,
    iou_reaches,
    point_error,
    remote_grounding_success,
)
from reverie_eval.metrics._navigation import (
    cls,
    dtw,
    jumps,
    navigation_error,
    ndtw,
    oracle_error,
    oracle_path_success,
    oracle_success,
    path_length,
    sdtw,
    spl,
    steps,
    success,
)

Unit = Literal["fraction", "metres", "count", "turns"]
Direction = Literal["higher", "lower", "neither"]
Need = Literal["trajectory", "answer", "box", "goal region", "planner's path", "outline"]

_SUFFIXES: Mapping[Unit, str] = MappingProxyType(
    {"fraction": "%", "metres": "m", "count": "", "turns": "turns"}
)
_TRAJECTORY: frozenset[Need] = frozenset({"trajectory"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """A metric: its names, its meaning, and how it is computed.

    Values lie in ``[0, upper_bound]``, or in ``[-upper_bound, upper_bound]`` if it is signed.
    """

    key: str
    label: str
    name: str
    definition: str
    unit: Unit
    better: Direction
    needs: frozenset[Need] = _TRAJECTORY
    """What a submission must contain for the metric to be scored, by default a trajectory."""
    protocol_fields: frozenset[str] = frozenset()
    """Fields of the protocol that the value depends on, directly or through another metric."""
    compute: Callable[..., Array]
    inputs: tuple[str, ...]
    """The arguments of ``compute``, in order."""
    is_binary: bool = False
    """Whether every value is 0 or 1."""
    of_goal: str = ""
    """The definition, with ``{goal}`` in place of the success rule, if that depends on the task."""
    is_signed: bool = False
    """Whether values can be negative."""
    is_partial: bool = False
    """Whether only some episodes have a value and the others are NaN; the mean is over those that
    have one, and there are no intervals."""

    @property
    def upper_bound(self) -> float:
        """The largest value an episode can have."""
        return 1.0 if self.unit == "fraction" else float("inf")

    @property
    def suffix(self) -> str:
        """The unit that :meth:`display` uses: ``%``; empty for counts."""
        return _SUFFIXES[self.unit]

    @property
    def lower_bound(self) -> float:
        """The smallest value an episode can have."""
        return -self.upper_bound if self.is_signed else 0.0

    @property
    def bounds(self) -> tuple[float, float]:
        """The smallest and the largest value an episode can have."""
        return self.lower_bound, self.upper_bound

    @property
    def difference_bounds(self) -> tuple[float, float]:
        """The smallest and the largest difference of two values; infinite unless both are bounded.

        >>> CATALOGUE["success"].difference_bounds, CATALOGUE["path_length"].difference_bounds
        ((-1.0, 1.0), (-inf, inf))
        """
        largest = self.upper_bound - self.lower_bound
        return -largest, largest

    @property
    def heading(self) -> str:
        """The label with that unit: ``SR %``."""
        return f"{self.label} {self.suffix}".rstrip()

    def for_goal(self, goal: str) -> "Metric":
        """Return the metric with the success rule filled into its definition."""
        return replace(self, definition=self.of_goal.format(goal=goal)) if self.of_goal else self

    def mean(self, values: Array) -> float:
        """Return the mean over episodes; NaN for a partial metric if no episode has a value."""
        if not self.is_partial:
            return float(values.mean())
        values = values[~np.isnan(values)]
        return float(values.mean()) if values.size else float("nan")

    def rounded(self, value: float) -> float:
        """Round to the digits that :meth:`display` shows.

        >>> CATALOGUE["success"].rounded(0.54532677), CATALOGUE["path_length"].rounded(9.4734)
        (0.5453, 9.47)
        """
        return round(value, 4 if self.unit == "fraction" else 2)

    def display(self, value: float) -> str:
        """Format a value for people: fractions as percentages, two decimals.

        >>> CATALOGUE["success"].display(0.54532677)
        '54.53'
        """
        text = f"{100 * value if self.unit == 'fraction' else value:.2f}"
        return "0.00" if text == "-0.00" else text

    def display_one(self, value: float) -> str:
        """Format the value of a single episode: a binary one as yes or no.

        >>> CATALOGUE["success"].display_one(1.0), CATALOGUE["spl"].display_one(0.5)
        ('yes', '50.00')
        """
        if self.is_binary:
            return "yes" if value else "no"
        return self.display(value)


_ANSWER: frozenset[Need] = frozenset({"answer"})
_OUTLINE: frozenset[Need] = frozenset({"trajectory", "outline"})
_BOX: frozenset[Need] = frozenset({"answer", "box"})
# The goal rule is among them because some protocols count an answer only with success.
_ANSWER_FIELDS = frozenset({"grounding", "goal", "text_ids_count"})
_BOX_INPUTS = ("box_overlap", "box_row", "n_episodes")

_fraction = partial(Metric, unit="fraction", better="higher")
"""A metric in [0, 1] of which more is better, as most of them are."""

_METRICS = (
    Metric(
        key="path_length",
        label="TL",
        name="trajectory length",
        definition="metres along the navigation graph, summed from pose to pose",
        unit="metres",
        better="neither",
        compute=path_length,
        inputs=("leg_length", "offsets"),
    ),
    _fraction(
        key="success",
        label="SR",
        name="success rate",
        definition="the target object is visible where the agent stops",
        of_goal="{goal} where the agent stops",
        protocol_fields=frozenset({"goal"}),
        compute=success,
        inputs=("at_goal", "offsets"),
        is_binary=True,
    ),
    _fraction(
        key="oracle_success",
        label="OSR",
        name="oracle success rate",
        definition="the target object is visible from any viewpoint of the trajectory",
        of_goal="{goal} from any viewpoint of the trajectory",
        protocol_fields=frozenset({"goal"}),
        compute=oracle_success,
        inputs=("oracle_at_goal", "offsets"),
        is_binary=True,
    ),
    _fraction(
        key="spl",
        label="SPL",
        name="success weighted by path length",
        definition="success, times the shortest length divided by the larger of walked and "
        "shortest length",
        protocol_fields=frozenset({"goal", "spl_numerator", "spl_floor"}),
        compute=spl,
        inputs=("success", "path_length", "reference_length", "spl_floor"),
    ),
    _fraction(
        key="rgs",
        label="RGS",
        name="remote grounding success",
        definition="the predicted object is the target object, or the predicted box matches it",
        needs=_ANSWER,
        protocol_fields=_ANSWER_FIELDS,
        compute=remote_grounding_success,
        inputs=("is_answer_correct", "success", "needs_success"),
        is_binary=True,
    ),
    _fraction(
        key="rgspl",
        label="RGSPL",
        name="remote grounding success weighted by path length",
        definition="remote grounding success, weighted as SPL is; the benchmark's primary metric",
        needs=_TRAJECTORY | _ANSWER,
        protocol_fields=_ANSWER_FIELDS | {"spl_numerator", "rgspl_floor"},
        compute=spl,
        inputs=("rgs", "path_length", "reference_length", "rgspl_floor"),
    ),
    _fraction(
        key="iou",
        label="IoU",
        name="intersection over union",
        definition="intersection over union of the predicted box and the target's in the same "
        "view; 0 without a predicted box",
        needs=_BOX,
        protocol_fields=frozenset({"grounding"}),
        compute=iou,
        inputs=_BOX_INPUTS,
    ),
    *(
        _fraction(
            key=f"iou_{100 * threshold:.0f}",  # iou_25, iou_50, iou_75
            label=f"IoU>={threshold:g}".replace("0.", "."),
            name=f"boxes with an IoU of at least {threshold:g}",
            definition=f"the answer is a box with an IoU of at least {threshold:g}{remark}",
            needs=_BOX,
            protocol_fields=frozenset({"grounding"}),
            compute=partial(iou_reaches, threshold),
            inputs=_BOX_INPUTS,
            is_binary=True,
        )
        for threshold, remark in (
            (LOOSE_IOU_THRESHOLD, ""),
            (IOU_THRESHOLD, ", the benchmark's threshold"),
            (STRICT_IOU_THRESHOLD, ""),
        )
    ),
    Metric(
        key="navigation_error",
        label="NE",
        name="navigation error",
        definition="metres along the navigation graph from the stop to the end of the annotated "
        "path",
        unit="metres",
        better="lower",
        compute=navigation_error,
        inputs=("goal_distance", "offsets"),
    ),
    Metric(
        key="oracle_error",
        label="ONE",
        name="oracle navigation error",
        definition="metres along the navigation graph from the trajectory's closest viewpoint to "
        "the end of the annotated path",
        unit="metres",
        better="lower",
        compute=oracle_error,
        inputs=("oracle_distance", "offsets"),
    ),
    Metric(
        key="dtw",
        label="DTW",
        name="dynamic time warping",
        definition="smallest total distance of an in-order alignment of trajectory and annotated "
        "path",
        unit="metres",
        better="lower",
        compute=dtw,
        inputs=("pose_to_node", "n_poses", "n_nodes"),
    ),
    _fraction(
        key="ndtw",
        label="nDTW",
        name="normalised dynamic time warping",
        definition="exp(-DTW / (3 m x nodes of the annotated path))",
        compute=ndtw,
        inputs=("dtw", "n_nodes"),
    ),
    _fraction(
        key="sdtw",
        label="SDTW",
        name="success weighted by normalised dynamic time warping",
        definition="nDTW if the episode is a success, else 0",
        protocol_fields=frozenset({"goal"}),
        compute=sdtw,
        inputs=("ndtw", "success"),
    ),
    _fraction(
        key="cls",
        label="CLS",
        name="coverage weighted by length score",
        definition="how closely the trajectory covers the annotated path, times how well the "
        "lengths agree",
        compute=cls,
        inputs=("pose_to_node", "n_poses", "n_nodes", "path_length", "annotated_length"),
    ),
    Metric(
        key="shortest_length",
        label="S",
        name="shortest length",
        definition="metres of the shortest route from the start to the end of the annotated path",
        unit="metres",
        better="neither",
        compute=np.asarray,
        inputs=("shortest_length",),
    ),
    Metric(
        key="steps",
        label="steps",
        name="steps",
        definition="poses after the first",
        unit="count",
        better="neither",
        compute=steps,
        inputs=("offsets",),
    ),
    Metric(
        key="jumps",
        label="jumps",
        name="jumps",
        definition="moves between unconnected viewpoints, counted at shortest-path distance",
        unit="count",
        better="lower",
        compute=jumps,
        inputs=("is_jump", "offsets"),
    ),
    # The further metrics of other tasks.
    Metric(
        key="goal_progress",
        label="GP",
        name="goal progress",
        definition="metres by which the stop is nearer to the goal region than the start",
        unit="metres",
        better="higher",
        needs=_TRAJECTORY | {"goal region"},
        compute=np.subtract,
        inputs=("start_to_goals", "stop_to_goals"),
        is_signed=True,
    ),
    _fraction(
        key="oracle_path_success",
        label="OPSR",
        name="oracle path success rate",
        definition="a viewpoint of the trajectory is less than 3 m from the end of the planner's "
        "path",
        needs=_TRAJECTORY | {"planner's path"},
        compute=oracle_path_success,
        inputs=("planner_distance", "offsets"),
        is_binary=True,
    ),
    _fraction(
        key="detection_success",
        label="DSR",
        name="detection success rate",
        definition="the predicted point is inside the target's outline as seen from the stop",
        needs=_OUTLINE,
        protocol_fields=frozenset({"repeated_outlines"}),
        compute=detection_success,
        inputs=("point", "outline"),
        is_binary=True,
    ),
    _fraction(
        key="sfpl",
        label="SFPL",
        name="success rate of finding weighted by path length",
        definition="detection success, weighted as SPL is",
        needs=_OUTLINE,
        # The goal is among them because some protocols move it, and the shortest length with it.
        protocol_fields=frozenset({"repeated_outlines", "goal", "spl_numerator", "spl_floor"}),
        compute=spl,
        inputs=("detection_success", "path_length", "reference_length", "spl_floor"),
    ),
    *(
        Metric(
            key=f"{what}_error",
            label=label,
            name=f"{what} error",
            definition=f"{distance} of the predicted point from the target's centre, over episodes "
            "whose target is visible from the stop",
            unit="turns",
            better="lower",
            needs=_OUTLINE,
            protocol_fields=frozenset({"repeated_outlines"}),
            compute=compute,
            inputs=("point", "outline"),
            is_partial=True,
        )
        for what, label, distance, compute in (
            ("heading", "HE", "distance in heading", heading_error),
            ("elevation", "EE", "distance in elevation", elevation_error),
        )
    ),
    Metric(
        key="point_error",
        label="PE",
        name="point error",
        definition="distance of the predicted point from the target's centre, over detections or "
        "over episodes whose target is visible from the stop, depending on the protocol",
        unit="turns",
        better="lower",
        needs=_OUTLINE,
        protocol_fields=frozenset({"repeated_outlines", "point_errors"}),
        compute=point_error,
        inputs=("heading_error", "elevation_error", "detection_success", "point_errors"),
        is_partial=True,
    ),
)

CATALOGUE: Mapping[str, Metric] = MappingProxyType({metric.key: metric for metric in _METRICS})
"""Every metric of every task by its key, in the order in which tables show them: those of REVERIE,
then further ones."""
PRIMARY_METRIC = "rgspl"
"""The metric that REVERIE ranks by, as its challenges of 2020 to 2022 did."""


def units_of(keys: Iterable[str]) -> dict[str, Unit]:
    """Return the unit of each metric, for the ``attrs`` of data frames.

    >>> units_of(["path_length", "success"])
    {'path_length': 'metres', 'success': 'fraction'}
    """
    return {key: CATALOGUE[key].unit for key in keys}
