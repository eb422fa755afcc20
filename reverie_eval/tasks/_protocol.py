"""Protocols: the rules that published evaluators score by, as data.

A protocol's numbers never change once it is released; a correction is a new protocol. Thresholds
that protocols share are defined with the arithmetic that uses them, in :mod:`reverie_eval.metrics`.
"""

from dataclasses import dataclass
from typing import Literal

from reverie_eval.metrics import Need

DEFAULT_PROTOCOL = "official-v1"
"""Every task has a protocol of this name: the rules of the dataset's own authors."""

KnownSplit = Literal["train", "val_seen", "val_unseen", "val_unseen_house", "test"]
"""Splits of the tasks of this package, for editors to complete; others have other names."""
KnownProtocol = Literal[
    "official-v1",
    "paper",
    "paper-3m",
    "challenge-2022",
    "airbert",
    "duet",
    "hamt",
    "scalevln",
    "hm3d",
    "r2r-style",
    "official-planner",
    "official-player",
    "navillm",
    "navrag",
    "mapgpt",
]
"""Protocols of the tasks of this package, by all their names, for editors to complete."""
GoalRule = Literal[
    "visible",
    "visible and near the object",
    "at most 3 m from the object",
    "near the path's end",
    "at most 3 m from the path's end",
    "at a goal viewpoint",
    "near the path's end, which a stop at a goal viewpoint becomes",
]
TO_REGION = "planner's path or to the goal region"
"""The reference of protocols that score by the planner's path if it ends at a goal viewpoint, and
otherwise by the shortest route to one: that of fewest moves, to the first of several [1]_.

References
----------
.. [1] ``tasks/datasets/cvdn.py`` lines 28-36 of zd11024/NaviLLM at a221f42.
"""
Grounding = Literal["anywhere", "only with success", "not scored"]
HopReading = Literal["first viewpoint", "every viewpoint", "rejected", "no evaluator"]
"""How a published evaluator reads a nested hop with several viewpoints."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """The rules that a published evaluator scores by."""

    name: str
    summary: str
    source: str
    # The defaults are the rules of the dataset's own script; protocols list only what differs.
    goal: GoalRule = "visible"
    """Which viewpoints are goals: those from which the target is visible; those from which it is
    visible with its centre at most 3 m from the camera; those with its centre at most 3 m from the
    camera in a straight line, visible or not; those less than 3 m along the graph from
    the path's end, or at most 3 m; those that the task annotates as goals; or those less than 3 m
    from the path's end, except that an annotated goal becomes the goal if the agent stops there."""
    spl_numerator: Literal["shortest", "annotated", "nearest goal"] = "shortest"
    """The length in SPL's numerator: of the shortest route, of the annotated path, or of the
    shortest route to the nearest annotated goal."""
    spl_floor: float = 0.0
    """Smallest denominator of SPL, metres."""
    rgspl_floor: float = 0.0
    """Smallest denominator of RGSPL, metres."""
    grounding: Grounding = "anywhere"
    """Where a correct answer counts: wherever the agent stops, or only with success."""
    text_ids_count: bool = True
    """Whether an object id written as text can be correct."""
    reference: str = ""
    """The annotated path to score by, among the task's further paths or ``TO_REGION``; empty for
    its own."""
    repeated_outlines: Literal["first", "last"] = "first"
    """Which outline of the target counts, where a goal viewpoint has several."""
    point_errors: Literal["detections", "where the target is seen"] = "detections"
    """Which stops have a point error."""
    measures: frozenset[Need] = frozenset()
    """What the annotations let the protocol measure besides walks and answers."""
    scored_instructions: int | None = None
    """How many instructions of each path are scored, if not all of them."""
    rejects_jumps: bool = False
    """Whether the published evaluator stops at a move between unconnected viewpoints. It is not a
    rule of the scores, which count such moves."""
    nested_hops: HopReading = "first viewpoint"
    """How the published evaluator reads nested hops. It is not a rule of the scores, which count
    every viewpoint under all protocols."""
