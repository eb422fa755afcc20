"""The catalogue of metrics: one entry each, which the scorer, tables, pages and docs all read.

To add a metric, write an entry: ``compute`` takes its values from :class:`Inputs`.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from types import MappingProxyType

from reverie_eval.arrays import Array, IntArray
from reverie_eval.metrics import _grounding as grounding
from reverie_eval.metrics import _navigation as navigation
from reverie_eval.metrics._metric import Inputs, Metric, Need, Unit

_TRAJECTORY: frozenset[Need] = frozenset({"trajectory"})
_ANSWER: frozenset[Need] = frozenset({"answer"})
_OUTLINE: frozenset[Need] = frozenset({"trajectory", "outline"})
_BOX: frozenset[Need] = frozenset({"answer", "box"})
# The goal rule is among them because some protocols count an answer only with success.
_ANSWER_FIELDS = frozenset({"grounding", "goal", "text_ids_count"})


def _boxes(at: Inputs) -> tuple[grounding.Overlap, IntArray, int]:
    """Return what the metrics of boxes are computed from."""
    return at.lookups.box_overlap, at.lookups.box_row, at.lookups.n_episodes


def _iou_reaches(threshold: float, at: Inputs) -> Array:
    return grounding.iou_reaches(threshold, *_boxes(at))


def _point_error(error: Callable[[Array, Array], Array], at: Inputs) -> Array:
    return error(at.lookups.point, at.outline)


# A metric in [0, 1] of which more is better, as most of them are.
_fraction = partial(Metric, unit="fraction", better="higher")

# Tables, pages and exports keep this order.
_METRICS = (
    Metric(
        key="path_length",
        label="TL",
        name="trajectory length",
        definition="metres along the navigation graph, summed from pose to pose",
        unit="metres",
        # A short walk may be one that never set out.
        better="neither",
        compute=lambda at: navigation.path_length(at.lookups.leg_length, at.lookups.offsets),
    ),
    _fraction(
        key="success",
        label="SR",
        name="success rate",
        definition="the target object is visible where the agent stops",
        of_goal="{goal} where the agent stops",
        protocol_fields=frozenset({"goal"}),
        compute=lambda at: navigation.success(at.at_goal, at.lookups.offsets),
        is_binary=True,
    ),
    _fraction(
        key="oracle_success",
        label="OSR",
        name="oracle success rate",
        definition="the target object is visible from any viewpoint of the trajectory",
        of_goal="{goal} from any viewpoint of the trajectory",
        protocol_fields=frozenset({"goal"}),
        compute=lambda at: navigation.oracle_success(at.oracle_at_goal, at.lookups.offsets),
        is_binary=True,
    ),
    _fraction(
        key="spl",
        label="SPL",
        name="success weighted by path length",
        definition="success, times the shortest length divided by the larger of walked and "
        "shortest length",
        protocol_fields=frozenset({"goal", "spl_numerator", "spl_floor"}),
        compute=lambda at: navigation.spl(
            at.metric("success"),
            at.metric("path_length"),
            at.reference_length,
            at.protocol.spl_floor,
        ),
    ),
    _fraction(
        key="rgs",
        label="RGS",
        name="remote grounding success",
        definition="the predicted object is the target object, or the predicted box matches it",
        # Not of a trajectory: the grounding track has none.
        needs=_ANSWER,
        protocol_fields=_ANSWER_FIELDS,
        compute=lambda at: grounding.remote_grounding_success(
            at.is_answer_correct, at.metric("success"), at.needs_success
        ),
        is_binary=True,
    ),
    _fraction(
        key="rgspl",
        label="RGSPL",
        name="remote grounding success weighted by path length",
        definition="remote grounding success, weighted as SPL is; the benchmark's primary metric",
        needs=_TRAJECTORY | _ANSWER,
        protocol_fields=_ANSWER_FIELDS | {"spl_numerator", "rgspl_floor"},
        compute=lambda at: navigation.spl(
            at.metric("rgs"), at.metric("path_length"), at.reference_length, at.protocol.rgspl_floor
        ),
    ),
    _fraction(
        key="iou",
        label="IoU",
        name="intersection over union",
        definition="intersection over union of the predicted box and the target's in the same "
        "view; 0 without a predicted box",
        needs=_BOX,
        protocol_fields=frozenset({"grounding"}),
        compute=lambda at: grounding.iou(*_boxes(at)),
    ),
    *(
        _fraction(
            key=f"iou_{100 * threshold:.0f}",  # iou_25, iou_50, iou_75
            label=f"IoU>={threshold:g}".replace("0.", "."),
            name=f"boxes with an IoU of at least {threshold:g}",
            definition=f"the answer is a box with an IoU of at least {threshold:g}{use}",
            needs=_BOX,
            protocol_fields=frozenset({"grounding"}),
            compute=partial(_iou_reaches, threshold),
            is_binary=True,
        )
        for threshold, use in (
            (grounding.LOOSE_IOU_THRESHOLD, ""),
            (grounding.IOU_THRESHOLD, ", the benchmark's threshold"),
            (grounding.STRICT_IOU_THRESHOLD, ""),
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
        # Along the graph: in a straight line, the room next door is near.
        compute=lambda at: navigation.navigation_error(
            at.lookups.goal_distance, at.lookups.offsets
        ),
    ),
    Metric(
        key="oracle_error",
        label="ONE",
        name="oracle navigation error",
        definition="metres along the navigation graph from the trajectory's closest viewpoint to "
        "the end of the annotated path",
        unit="metres",
        better="lower",
        compute=lambda at: navigation.oracle_error(at.lookups.oracle_distance, at.lookups.offsets),
    ),
    Metric(
        key="dtw",
        label="DTW",
        name="dynamic time warping",
        definition="smallest total distance of an in-order alignment of trajectory and annotated "
        "path",
        unit="metres",
        better="lower",
        # As a table, because each pose is measured from each node.
        compute=lambda at: navigation.dtw(
            at.lookups.pose_to_node, at.lookups.n_poses, at.lookups.n_nodes
        ),
    ),
    _fraction(
        key="ndtw",
        label="nDTW",
        name="normalised dynamic time warping",
        definition="exp(-DTW / (3 m x nodes of the annotated path))",
        compute=lambda at: navigation.ndtw(at.metric("dtw"), at.lookups.n_nodes),
    ),
    _fraction(
        key="sdtw",
        label="SDTW",
        name="success weighted by normalised dynamic time warping",
        definition="nDTW if the episode is a success, else 0",
        protocol_fields=frozenset({"goal"}),
        compute=lambda at: navigation.sdtw(at.metric("ndtw"), at.metric("success")),
    ),
    _fraction(
        key="cls",
        label="CLS",
        name="coverage weighted by length score",
        definition="how closely the trajectory covers the annotated path, times how well the "
        "lengths agree",
        compute=lambda at: navigation.cls(
            at.lookups.pose_to_node,
            at.lookups.n_poses,
            at.lookups.n_nodes,
            at.metric("path_length"),
            at.lookups.annotated_length,
        ),
    ),
    Metric(
        key="shortest_length",
        label="S",
        name="shortest length",
        definition="metres of the shortest route from the start to the end of the annotated path",
        unit="metres",
        better="neither",
        compute=lambda at: at.lookups.shortest_length,
    ),
    Metric(
        key="steps",
        label="steps",
        name="steps",
        definition="poses after the first",
        unit="count",
        better="neither",
        compute=lambda at: navigation.steps(at.lookups.offsets),
    ),
    Metric(
        key="jumps",
        label="jumps",
        name="jumps",
        definition="moves between unconnected viewpoints, counted at shortest-path distance",
        unit="count",
        better="lower",
        compute=lambda at: navigation.jumps(at.lookups.is_jump, at.lookups.offsets),
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
        compute=lambda at: at.lookups.start_to_goals - at.lookups.stop_to_goals,
        is_signed=True,
    ),
    _fraction(
        key="oracle_path_success",
        label="OPSR",
        name="oracle path success rate",
        definition="a viewpoint of the trajectory is less than 3 m from the end of the planner's "
        "path",
        needs=_TRAJECTORY | {"planner's path"},
        compute=lambda at: navigation.oracle_path_success(
            at.lookups.planner_distance, at.lookups.offsets
        ),
        is_binary=True,
    ),
    _fraction(
        key="detection_success",
        label="DSR",
        name="detection success rate",
        definition="the predicted point is inside the target's outline as seen from the stop",
        needs=_OUTLINE,
        protocol_fields=frozenset({"repeated_outlines"}),
        compute=lambda at: grounding.detection_success(at.lookups.point, at.outline),
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
        compute=lambda at: navigation.spl(
            at.metric("detection_success"),
            at.metric("path_length"),
            at.reference_length,
            at.protocol.spl_floor,
        ),
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
            compute=partial(_point_error, error),
            is_partial=True,
        )
        for what, label, distance, error in (
            ("heading", "HE", "distance in heading", grounding.heading_error),
            ("elevation", "EE", "distance in elevation", grounding.elevation_error),
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
        compute=lambda at: grounding.point_error(
            at.metric("heading_error"),
            at.metric("elevation_error"),
            at.metric("detection_success"),
            at.protocol.point_errors,
        ),
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
