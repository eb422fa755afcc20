"""A metric, and what its values are computed from.

:class:`reverie_eval.scoring.EpisodeTable` and its lookups provide its inputs. Arrays of poses are
flat with ``offsets`` (see :mod:`reverie_eval.arrays`).
"""

import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from math import isfinite
from types import MappingProxyType
from typing import Literal

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.metrics._grounding import Overlap


class LookedUp(typing.Protocol):
    """What the ground truth says about poses and episodes, whatever the protocol."""

    n_episodes: int
    offsets: IntArray
    """Shape (n_episodes + 1,): where each episode's poses begin."""

    @property
    def n_poses(self) -> IntArray:
        """Shape (n_episodes,): poses of the trajectory."""

    @property
    def n_nodes(self) -> IntArray:
        """Shape (n_episodes,): nodes of the annotated path."""

    @property
    def leg_length(self) -> FloatArray:
        """Shape (n_poses,): metres from the episode's previous pose; 0 for its first pose."""

    @property
    def is_jump(self) -> BoolArray:
        """Shape (n_poses,): whether the pose is at a viewpoint unconnected to the previous one."""

    @property
    def goal_distance(self) -> FloatArray:
        """Shape (n_poses,): metres to the end of the annotated path."""

    @property
    def oracle_distance(self) -> FloatArray:
        """Shape (n_poses,): the metres among which an oracle takes the smallest of an episode."""

    @property
    def planner_distance(self) -> FloatArray:
        """Shape (n_poses,): metres to the end of the planner's path."""

    @property
    def pose_to_node(self) -> FloatArray:
        """Metres from poses to path nodes: one table per episode, as path fidelity takes them."""

    @property
    def shortest_length(self) -> FloatArray:
        """Shape (n_episodes,): metres from the start to the end of the annotated path."""

    @property
    def annotated_length(self) -> FloatArray:
        """Shape (n_episodes,): metres along the annotated path."""

    @property
    def start_to_goals(self) -> FloatArray:
        """Shape (n_episodes,): metres from the start to the nearest annotated goal."""

    @property
    def stop_to_goals(self) -> FloatArray:
        """Shape (n_episodes,): metres from the stop to the nearest annotated goal."""

    @property
    def point(self) -> FloatArray:
        """Shape (n_episodes, 2): the predicted point, turns; NaN where there is none."""

    @property
    def box_overlap(self) -> Overlap:
        """The overlap of each predicted box with the target's."""

    @property
    def box_row(self) -> IntArray:
        """Shape (n_boxes,): the episode of each predicted box."""


class ProtocolFields(typing.Protocol):
    """The fields of a :class:`reverie_eval.tasks.Protocol` that single metrics need."""

    @property
    def spl_floor(self) -> float:
        """Smallest denominator of SPL, metres."""

    @property
    def rgspl_floor(self) -> float:
        """Smallest denominator of RGSPL, metres."""

    @property
    def point_errors(self) -> Literal["detections", "where the target is seen"]:
        """Which stops have a point error."""


class Inputs(typing.Protocol):
    """Everything that a metric can be computed from, under a protocol."""

    @property
    def lookups(self) -> LookedUp:
        """What does not depend on the protocol."""

    @property
    def protocol(self) -> ProtocolFields:
        """The protocol itself."""

    @property
    def at_goal(self) -> BoolArray:
        """Shape (n_poses,): whether each pose is at a goal viewpoint of its episode."""

    @property
    def oracle_at_goal(self) -> BoolArray:
        """Shape (n_poses,): the same for an oracle, which stops where the trajectory is best."""

    @property
    def reference_length(self) -> FloatArray:
        """Shape (n_episodes,): metres with which SPL compares the walked length."""

    @property
    def is_answer_correct(self) -> BoolArray:
        """Shape (n_episodes,): whether the answer is correct, wherever the agent stopped."""

    @property
    def needs_success(self) -> bool:
        """Whether a correct answer counts only with success."""

    @property
    def outline(self) -> FloatArray:
        """Shape (n_episodes, 5, 2): the target as seen from the stop, turns; NaN if not visible."""

    def metric(self, key: str) -> Array:
        """Shape (n_episodes,): another metric by its key, in the type that its function returns."""


Unit = Literal["fraction", "metres", "count", "turns"]
Direction = Literal["higher", "lower", "neither"]
Need = Literal["trajectory", "answer", "box", "goal region", "planner's path", "outline"]

_PER_CENT = 100
_SUFFIXES: Mapping[Unit, str] = MappingProxyType(
    {"fraction": "%", "metres": "m", "count": "", "turns": "turns"}
)


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
    needs: frozenset[Need] = frozenset({"trajectory"})
    """What a submission must contain for the metric to be scored, by default a trajectory."""
    protocol_fields: frozenset[str] = frozenset()
    """Fields of the protocol that the value depends on, directly or through another metric."""
    compute: Callable[[Inputs], Array]
    """Return a value per episode."""
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
    def scale(self) -> int:
        """What values are multiplied by where they are shown: fractions are percentages there."""
        return 100 if self.unit == "fraction" else 1

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

        >>> from reverie_eval.metrics import CATALOGUE
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
        # Not nanmean, which warns where no episode has a value.
        values = values[~np.isnan(values)]
        return float(values.mean()) if values.size else float("nan")

    def is_better(self, value: float, other: float) -> bool:
        """Return whether a value is better than another; never, if neither direction is better."""
        if self.better == "neither":
            return False
        return value > other if self.better == "higher" else value < other

    def rounded(self, value: float) -> float:
        """Round to the digits that :meth:`display` shows.

        >>> from reverie_eval.metrics import CATALOGUE
        >>> CATALOGUE["success"].rounded(0.54532677), CATALOGUE["path_length"].rounded(9.4734)
        (0.5453, 9.47)
        """
        return round(value, 4 if self.unit == "fraction" else 2)

    def display(self, value: float) -> str:
        """Format a value for people: fractions as percentages, two decimals.

        >>> from reverie_eval.metrics import CATALOGUE
        >>> CATALOGUE["success"].display(0.54532677)
        '54.53'
        """
        text = f"{self.scale * value:.2f}"
        # A value that rounds to 0 has no sign.
        return "0.00" if text == "-0.00" else text

    def display_one(self, value: float) -> str:
        """Format the value of a single episode: a binary one as yes or no.

        >>> from reverie_eval.metrics import CATALOGUE
        >>> CATALOGUE["success"].display_one(1.0), CATALOGUE["spl"].display_one(0.5)
        ('yes', '50.00')
        """
        if self.is_binary:
            return "yes" if value else "no"
        return self.display(value)


def printed_value(
    metric: Metric, text: str, rates: Literal["percent", "fraction"] = "percent"
) -> float:
    """Return a value as printed in a table, converted to a fraction or metres.

    Raises
    ------
    ValueError
        If it is not a number, or is out of the metric's bounds.

    Examples
    --------
    >>> from reverie_eval.metrics import CATALOGUE
    >>> printed_value(CATALOGUE["success"], "52.51 %")
    0.5251
    """
    is_percent = metric.unit == "fraction" and rates == "percent"
    try:
        # Decimal divides exactly; in binary, 0.07 is not 7 / 100.
        number = Decimal(text.removesuffix("%").strip())
        value = float(number / _PER_CENT if is_percent else number)
    except ArithmeticError:
        raise ValueError(f"{metric.label}: {text!r} is not a number") from None
    if not isfinite(value) or not metric.lower_bound <= value <= metric.upper_bound:
        most = _PER_CENT if is_percent else 1
        expected = f"from 0 to {most}" if metric.unit == "fraction" else "0 or more"
        raise ValueError(f"{metric.heading}: {text} is not {expected}")
    return value
