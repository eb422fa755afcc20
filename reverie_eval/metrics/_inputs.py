"""What metrics are computed from: everything that an entry of the CATALOGUE can take.

:class:`reverie_eval.scoring.EpisodeTable` and its lookups provide it. Arrays of poses are flat with
``offsets`` (see :mod:`reverie_eval.arrays`).
"""

import typing
from typing import Literal

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
