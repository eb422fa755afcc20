"""The episode table: facts, judged by a protocol."""

from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property, wraps

import numpy as np

from reverie_eval import metrics
from reverie_eval.arrays import Array, BoolArray, FloatArray, frozen
from reverie_eval.facts import Facts
from reverie_eval.metrics import BOX_METRICS, CATALOGUE
from reverie_eval.protocol import (
    IOU_THRESHOLD,
    LOOSE_IOU_THRESHOLD,
    STRICT_IOU_THRESHOLD,
    SUCCESS_DISTANCE,
    Protocol,
)


def _column(method: "Callable[[EpisodeTable], Array]") -> "cached_property[Array]":
    """Compute a column once, as read-only floats."""

    @wraps(method)
    def column(table: "EpisodeTable") -> Array:
        return frozen(method(table).astype(np.float64))

    return cached_property(column)


_GROUNDING_METRICS = BOX_METRICS | {"rgs", "rgspl"}


class EpisodeTable(Mapping[str, Array]):
    """A column of one value per episode for every metric that the protocol scores.

    Keys and order are the CATALOGUE's; each key is a property below of the same name, computed
    when it is first asked for.
    """

    def __init__(
        self, facts: Facts, protocol: Protocol, scored: Collection[str] = CATALOGUE
    ) -> None:
        self._facts = facts
        self._protocol = protocol
        unscored = frozenset() if facts.has_boxes else BOX_METRICS
        if protocol.grounding == "not scored":
            unscored = _GROUNDING_METRICS
        self._keys = tuple(key for key in CATALOGUE if key in scored and key not in unscored)

    def __getitem__(self, key: str) -> Array:
        if key not in self._keys:
            raise KeyError(f"{key} is not scored; {', '.join(self._keys)} are")
        column: Array = getattr(self, key)
        return column

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    @_column
    def path_length(self) -> Array:
        return metrics.path_length(self._facts.leg_length, self._facts.offsets)

    @_column
    def success(self) -> Array:
        return self._succeeded

    @_column
    def oracle_success(self) -> Array:
        return metrics.oracle_success(self.at_goal, self._facts.offsets)

    @_column
    def spl(self) -> Array:
        length, floor = self._reference_length, self._protocol.spl_floor
        return metrics.spl(self._succeeded, self.path_length, length, floor)

    @_column
    def rgs(self) -> Array:
        return self._grounded

    @_column
    def rgspl(self) -> Array:
        length, floor = self._reference_length, self._protocol.rgspl_floor
        return metrics.spl(self._grounded, self.path_length, length, floor)

    @_column
    def iou(self) -> Array:
        return self._of_boxes(self._facts.boxes.overlap.iou())

    @_column
    def iou_25(self) -> Array:
        return self._of_boxes(self._facts.boxes.overlap.reaches(LOOSE_IOU_THRESHOLD))

    @_column
    def iou_50(self) -> Array:
        return self._of_boxes(self._facts.boxes.overlap.reaches(IOU_THRESHOLD))

    @_column
    def iou_75(self) -> Array:
        return self._of_boxes(self._facts.boxes.overlap.reaches(STRICT_IOU_THRESHOLD))

    @_column
    def navigation_error(self) -> Array:
        return metrics.navigation_error(self._facts.goal_distance, self._facts.offsets)

    @_column
    def oracle_error(self) -> Array:
        return metrics.oracle_error(self._facts.goal_distance, self._facts.offsets)

    @_column
    def dtw(self) -> Array:
        facts = self._facts
        return metrics.dtw(facts.pose_to_node, facts.n_poses, facts.n_nodes)

    @_column
    def ndtw(self) -> Array:
        return metrics.ndtw(self.dtw, self._facts.n_nodes)

    @_column
    def sdtw(self) -> Array:
        return metrics.sdtw(self.ndtw, self._succeeded)

    @_column
    def cls(self) -> Array:
        facts = self._facts
        return metrics.cls(
            facts.pose_to_node,
            facts.n_poses,
            facts.n_nodes,
            self.path_length,
            facts.annotated_length,
        )

    @_column
    def shortest_length(self) -> Array:
        return self._facts.shortest_length

    @_column
    def steps(self) -> Array:
        return metrics.steps(self._facts.offsets)

    @_column
    def jumps(self) -> Array:
        return metrics.jumps(self._facts.is_jump, self._facts.offsets)

    @cached_property
    def at_goal(self) -> BoolArray:
        """Whether each pose is at a viewpoint that counts as success."""
        match self._protocol.goal:
            case "visible":
                return self._facts.sees_target
            case "visible and near the object":
                return self._facts.sees_target_near
            case "near the path's end":
                return np.less(self._facts.goal_distance, SUCCESS_DISTANCE)

    @cached_property
    def _succeeded(self) -> BoolArray:
        return metrics.success(self.at_goal, self._facts.offsets)

    @cached_property
    def _grounded(self) -> BoolArray:
        right = metrics.candidate_match(self._facts.predicted_object, self._facts.target_object)
        if not self._protocol.text_ids_count:
            right &= ~self._facts.answer_is_text
        if self._facts.has_boxes:
            right[self._facts.boxes.row] = self._facts.boxes.is_right
        if self._protocol.grounding == "only with success":
            right &= self._succeeded
        return right

    def _of_boxes(self, values: Array) -> FloatArray:
        """Spread values of box answers over all episodes; 0 where the answer is no box."""
        column = np.zeros(len(self._facts.predicted_object))
        column[self._facts.boxes.row] = values
        return column

    @property
    def _reference_length(self) -> FloatArray:
        """The length that success is weighted with."""
        if self._protocol.spl_numerator == "annotated":
            return self._facts.annotated_length
        return self._facts.shortest_length
