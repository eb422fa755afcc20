"""What the ground truth says about a submission's poses, episodes and boxes, before any protocol.

A predicted box is compared with the target's annotated box in the same view at the viewpoint where
the agent stops. It is wrong if that view does not show the target.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from reverie_eval.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    in_parts,
    last_of,
    offsets_of,
    row_of,
    take_rows,
)
from reverie_eval.geometry import HEIGHT, WIDTH, is_on_grid, polygon_overlap, warp
from reverie_eval.ground_truth import GroundTruth, NavigationGraph, Solution
from reverie_eval.metrics import (
    CATALOGUE,
    IOU_THRESHOLD,
    SUCCESS_DISTANCE,
    Overlap,
    box_match,
    box_overlap,
    path_length,
)
from reverie_eval.submissions import BoxAnswers, SubmissionColumns
from reverie_eval.tasks import GoalRule
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from reverie_eval.schemas.report import BoxReport

BOX_OUTCOMES = ("correct", "low IoU", "wrong view", "target not visible")
"""The outcomes of a predicted box."""


@dataclass(frozen=True, eq=False)
class BoxScores:
    """The predicted boxes of a submission, scored; one row each."""

    row: IntArray
    """Shape (n_boxes,): the episode, ascending."""
    overlap: Overlap
    """The overlap with the target's box; the intersection is 0 if the view does not show the
    target."""
    whole_image: Overlap
    """The overlap of a box around the whole image of that view."""
    is_visible: BoolArray
    """Shape (n_boxes,): whether the target is visible where the agent stops."""
    is_in_view: BoolArray
    """Shape (n_boxes,): whether the view of the predicted box shows the target."""
    is_ambiguous: BoolArray
    """Shape (n_boxes,): whether another object's box in that view overlaps the target's by an IoU
    of at least one half, so that a box around the wrong object counts as correct."""

    @cached_property
    def is_correct(self) -> BoolArray:
        """Shape (n_boxes,): whether the IoU is at least one half."""
        return self.overlap.reaches(IOU_THRESHOLD)

    @cached_property
    def outcome(self) -> IntArray:
        """Shape (n_boxes,): index into ``BOX_OUTCOMES``."""
        conditions = [self.is_correct, self.is_in_view, self.is_visible]
        # The first that holds decides, so the order is that of BOX_OUTCOMES.
        return np.asarray(np.select(conditions, [0, 1, 2], default=3))

    @property
    def misses(self) -> Mapping[str, int]:
        """Number of wrong boxes by reason."""
        counts = np.bincount(self.outcome, minlength=len(BOX_OUTCOMES)).tolist()
        return dict(zip(BOX_OUTCOMES[1:], counts[1:], strict=True))

    @property
    def mean_iou(self) -> float:
        """Mean IoU over the boxes; that of a view without the target is 0."""
        return float(self.overlap.iou().mean())

    @property
    def whole_image_share(self) -> float:
        """Share of boxes that would be correct if each were the whole image."""
        return float(self.whole_image.reaches(IOU_THRESHOLD).mean())

    @property
    def ambiguous_share(self) -> float:
        """Share of ambiguous views among those that show the target; 0 if there are none."""
        # Nothing is ambiguous where nothing is in view: 0 / 1.
        return float(self.is_ambiguous.sum() / max(self.is_in_view.sum(), 1))

    @property
    def note(self) -> str:
        """What a reader of scores with boxes should know of them, a sentence."""
        percent = CATALOGUE["iou"].display
        misses = ", ".join(f"{count:,} {reason}" for reason, count in self.misses.items())
        return (
            f"{count_text(len(self), 'box', 'boxes')} predicted, {self.is_correct.sum():,} correct "
            f"(misses: {misses}), mean IoU {percent(self.mean_iou)} %; a box around the whole "
            f"image would be correct in {percent(self.whole_image_share)} %; "
            f"{percent(self.ambiguous_share)} % of the views that show the target are ambiguous"
        )

    def to_report(self) -> "BoxReport":
        """Return what the score report says of the boxes."""
        from reverie_eval.schemas.report import BoxReport

        return BoxReport(
            answers=len(self),
            correct=int(self.is_correct.sum()),
            mean_iou=self.mean_iou,
            whole_image=self.whole_image_share,
            ambiguous_views=self.ambiguous_share,
            misses=dict(self.misses),
        )

    def __len__(self) -> int:
        return len(self.row)


class Lookups:
    """Distances, visibility and lengths of poses (flat, with ``offsets``) and of episodes.

    Each is computed on first access, and reused by other metrics and protocols.

    Raises
    ------
    GroundTruthError
        If the ground truth is a public bundle, which has no solution.
    """

    def __init__(self, submission: SubmissionColumns, ground_truth: GroundTruth) -> None:
        self.offsets = submission.offsets
        self.n_episodes = len(submission.predicted_object)
        self.has_boxes = len(submission.boxes.row) > 0
        """Whether any answer is a box."""
        self._solution = ground_truth.require_solution()
        self.target_object = self._solution.target_object
        """Shape (n_episodes,): object id."""
        self.submission = submission
        self.ground_truth = ground_truth
        self._graph = ground_truth.graph
        self._at_goal: dict[GoalRule, BoolArray] = {}

    def at_goal(self, rule: GoalRule) -> BoolArray:
        """Shape (n_poses,): whether each pose is at a goal viewpoint of its episode."""
        if rule not in self._at_goal:
            at_goal = partial(is_goal, rule, self.ground_truth)
            viewpoint = self.submission.viewpoint
            self._at_goal[rule] = in_parts(at_goal, self._episode, viewpoint)
        return self._at_goal[rule]

    @cached_property
    def leg_length(self) -> FloatArray:
        """Shape (n_poses,): metres from the episode's previous pose; 0 for its first pose."""
        viewpoint = self.submission.viewpoint
        previous = _previous(viewpoint, self.offsets)
        return in_parts(self._graph.distance_between, previous, viewpoint)

    @cached_property
    def is_jump(self) -> BoolArray:
        """Shape (n_poses,): whether the pose is at a viewpoint unconnected to the previous one."""
        return find_jumps(self.submission, self._graph)

    @cached_property
    def goal_distance(self) -> FloatArray:
        """Shape (n_poses,): metres to the end of the annotated path."""
        goal = self._solution.goal[self._episode]
        return self._graph.distance_between(self.submission.viewpoint, goal)

    @cached_property
    def oracle_distance(self) -> FloatArray:
        """Shape (n_poses,): the metres among which an oracle takes the smallest of an episode."""
        return self.goal_distance

    def oracle_at_goal(self, rule: GoalRule) -> BoolArray:
        """Shape (n_poses,): whether a stop at each pose would be a success of an oracle."""
        return self.at_goal(rule)

    def measured_by(self, rule: GoalRule) -> "Lookups":
        """Return the lookups with the goals that a rule sets."""
        moves = rule == "near the path's end, which a stop at a goal viewpoint becomes"
        return self._with_moved_goals if moves else self

    @cached_property
    def _with_moved_goals(self) -> "_MovedGoals":
        return _MovedGoals(self)

    @cached_property
    def point(self) -> FloatArray:
        """Shape (n_episodes, 2): the predicted point, turns; NaN where there is none."""
        point = self.submission.point
        return np.full((self.n_episodes, 2), np.nan) if point is None else point

    def outline(self, which: Literal["first", "last"]) -> FloatArray:
        """Shape (n_episodes, 5, 2): the target as seen from the stop, turns; NaN if not visible."""
        items = self.ground_truth.episodes.item
        return self._solution.outlines(items, self.submission.stop, which)

    @cached_property
    def boxes(self) -> BoxScores:
        """The scores of the predicted boxes."""
        boxes, stop = self.submission.boxes, self.submission.stop
        return score_boxes(boxes, stop, self.target_object, self._solution)

    @property
    def box_overlap(self) -> Overlap:
        """The overlap of each predicted box with the target's."""
        return self.boxes.overlap

    @property
    def box_row(self) -> IntArray:
        """Shape (n_boxes,): the episode of each predicted box."""
        return self.boxes.row

    @cached_property
    def shortest_length(self) -> FloatArray:
        """Shape (n_episodes,): metres from the start to the end of the annotated path."""
        start = self.ground_truth.episodes.start
        return self._graph.distance_between(start, self._solution.goal)

    @cached_property
    def start_to_goals(self) -> FloatArray:
        """Shape (n_episodes,): metres from the start to the nearest annotated goal."""
        return self._to_goals(self.ground_truth.episodes.start)

    @cached_property
    def stop_to_goals(self) -> FloatArray:
        """Shape (n_episodes,): metres from the stop to the nearest annotated goal."""
        return self._to_goals(self.submission.stop)

    def _to_goals(self, viewpoint: IntArray) -> FloatArray:
        goal, offsets = self._solution.goals()
        item = self.ground_truth.episodes.item
        count = np.diff(offsets)[item]
        # Each stop is paired with all goals of its item; the smallest distance of the pairs counts.
        goals = goal[take_rows(item, offsets)]
        distance = self._graph.distance_between(np.repeat(viewpoint, count), goals)
        # The compiler rejects an item without goals, so no row is empty.
        return np.minimum.reduceat(distance, offsets_of(count)[:-1])

    @cached_property
    def planner_distance(self) -> FloatArray:
        """Shape (n_poses,): metres to the end of the planner's path."""
        path, offsets = self._solution.further_paths["planner"]
        end = path[last_of(offsets)][self.ground_truth.episodes.item[self._episode]]
        return self._graph.distance_between(self.submission.viewpoint, end)

    @cached_property
    def annotated_length(self) -> FloatArray:
        """Shape (n_episodes,): metres along the annotated path."""
        path, offsets = self._solution.path, self._solution.path_offsets
        legs = self._graph.distance_between(_previous(path, offsets), path)
        return path_length(legs, offsets)[self.ground_truth.episodes.item]

    @cached_property
    def n_poses(self) -> IntArray:
        """Shape (n_episodes,): poses of the trajectory."""
        return np.diff(self.offsets)

    @cached_property
    def n_nodes(self) -> IntArray:
        """Shape (n_episodes,): nodes of the annotated path."""
        return np.diff(self._solution.path_offsets)[self.ground_truth.episodes.item]

    @cached_property
    def pose_to_node(self) -> FloatArray:
        """Metres from poses to path nodes: one table per episode, as path fidelity takes them."""
        # Row by row: each node of an episode's path is paired with all poses of its trajectory.
        item = self.ground_truth.episodes.item
        node = self._solution.path[take_rows(item, self._solution.path_offsets)]
        episode = np.repeat(np.arange(len(item)), self.n_nodes)
        pose = self.submission.viewpoint[take_rows(episode, self.offsets)]
        return self._graph.distance_between(pose, np.repeat(node, self.n_poses[episode]))

    @cached_property
    def _episode(self) -> IntArray:
        return row_of(self.offsets)


class _MovedGoals(Lookups):
    """What is measured where a stop at a goal viewpoint takes the place of the path's end.

    An oracle stops where the trajectory is nearest to the path's end, and is then measured by the
    moved goal, so that it can do worse than the agent.

    References
    ----------
    .. [1] ``evaluation_script/main.py`` lines 84-141 of ZhuFengdaaa/SOON-EvalAI-Starters at
       66f5e37.
    """

    def __init__(self, given: Lookups) -> None:
        truth, submission = given.ground_truth, given.submission
        solution, stop = truth.require_solution(), submission.stop
        # The stop becomes the goal of the episode, of all its lengths and distances.
        is_seen = solution.is_goal(truth.episodes.item, stop)
        moved = replace(solution, goal=np.where(is_seen, stop, solution.goal))
        super().__init__(submission, replace(truth, solution=moved))
        self._given = given

    @cached_property
    def oracle_distance(self) -> FloatArray:
        """Shape (n_poses,): metres to the goal from where the oracle of the episode stops."""
        before = self._given.goal_distance
        # Of several poses that are as near, the official script takes the first.
        nearest = np.minimum.reduceat(before, self.offsets[:-1])[self._episode]
        candidate = np.flatnonzero(before == nearest)
        _, first = np.unique(self._episode[candidate], return_index=True)
        return self.goal_distance[candidate[first]][self._episode]

    def oracle_at_goal(self, rule: GoalRule) -> BoolArray:  # noqa: ARG002
        """Shape (n_poses,): whether the oracle of the episode stops less than 3 m from the goal."""
        return np.less(self.oracle_distance, SUCCESS_DISTANCE)

    @cached_property
    def start_to_goals(self) -> FloatArray:
        """Shape (n_episodes,): metres from the start to the goal."""
        return self.shortest_length

    @cached_property
    def stop_to_goals(self) -> FloatArray:
        """Shape (n_episodes,): metres from the stop to the goal."""
        return self.goal_distance[last_of(self.offsets)]


def is_goal(
    rule: GoalRule, ground_truth: GroundTruth, episode: IntArray, viewpoint: IntArray
) -> BoolArray:
    """Whether a stop at a viewpoint is a success.

    Parameters
    ----------
    rule : GoalRule
        The goal rule of the protocol.
    ground_truth : GroundTruth
        With the solution.
    episode, viewpoint : int arrays of shape (n,)
        Pairs of an episode and a viewpoint of its scan.

    Returns
    -------
    bool array of shape (n,)
    """
    solution = ground_truth.require_solution()
    match rule:
        case "visible":
            return solution.is_visible(solution.target_object[episode], viewpoint)
        case "visible and near the object":
            return solution.is_visible_near(solution.target_object[episode], viewpoint)
        case "at most 3 m from the object":
            offset = ground_truth.graph.viewpoint_position[viewpoint]
            offset = offset - np.asarray(solution.target_position)[episode]
            distance = np.sqrt(np.square(offset).sum(axis=1))
            return np.asarray(distance <= SUCCESS_DISTANCE)
        case "near the path's end" | "at most 3 m from the path's end":
            distance = ground_truth.graph.distance_between(viewpoint, solution.goal[episode])
            # Exactly 3 m is a failure in R2R's script, and a success in R4R's and RxR's.
            near = np.less if rule == "near the path's end" else np.less_equal
            return np.asarray(near(distance, SUCCESS_DISTANCE))
        case "at a goal viewpoint":
            return solution.is_goal(ground_truth.episodes.item[episode], viewpoint)
        case "near the path's end, which a stop at a goal viewpoint becomes":
            distance = ground_truth.graph.distance_between(viewpoint, solution.goal[episode])
            is_seen = solution.is_goal(ground_truth.episodes.item[episode], viewpoint)
            return np.less(distance, SUCCESS_DISTANCE) | is_seen


def find_jumps(submission: SubmissionColumns, graph: NavigationGraph) -> BoolArray:
    """Whether each pose is at another viewpoint than the previous pose, with no edge between."""
    viewpoint = submission.viewpoint
    previous = _previous(viewpoint, submission.offsets)
    return np.not_equal(previous, viewpoint) & ~graph.has_edge(previous, viewpoint)


def _previous(viewpoint: IntArray, offsets: IntArray) -> IntArray:
    """Return the viewpoint before each one in its row; before the first, the first itself."""
    # So a row's first leg has the length 0 and is not a jump, without a case of its own.
    previous = np.roll(viewpoint, 1)
    first = offsets[:-1]
    previous[first] = viewpoint[first]
    return previous


def score_boxes(
    boxes: BoxAnswers, stop: IntArray, target_object: IntArray, solution: Solution
) -> BoxScores:
    """Compare predicted boxes with the annotation.

    ``stop`` and ``target_object``, shape (n_episodes,), are the viewpoint where the agent stops and
    the target's object id.

    References
    ----------
    .. [1] Qi et al., REVERIE, CVPR 2020, section 3: a predicted box is correct if its IoU with the
       ground truth is at least one half, at any viewpoint that sees the target; the views are
       those of ``visible_pos`` in the dataset's box files.
    """
    view = boxes.view
    candidate, is_visible = solution.find(target_object[boxes.row], stop[boxes.row])
    # Where nothing is found, `candidate` and `target` are those of another object.
    target, has_box = solution.boxes.find(candidate, view)
    is_in_view = is_visible & has_box
    # Only the boxes in views that show the target are compared with its boxes.
    shown = np.flatnonzero(is_in_view)
    target = target[shown]
    target_xywh = solution.boxes.xywh.take(target, axis=0)
    whole_image = np.broadcast_to([0.0, 0.0, WIDTH, HEIGHT], target_xywh.shape)
    is_ambiguous = np.zeros_like(is_in_view)
    is_ambiguous[shown] = _has_rival(target, solution)
    return BoxScores(
        row=boxes.row,
        overlap=_among(len(view), shown, _overlap(boxes.take(shown), target_xywh)),
        whole_image=_among(len(view), shown, box_overlap(whole_image, target_xywh)),
        is_visible=is_visible,
        is_in_view=is_in_view,
        is_ambiguous=is_ambiguous,
    )


def _overlap(boxes: BoxAnswers, target_xywh: IntArray) -> Overlap:
    """Return the overlap with the target's box; boxes from cameras off the grid are warped."""
    overlap = box_overlap(boxes.xywh, target_xywh)
    # Nearly all boxes are in a view itself, and need neither shapely nor rounding.
    off_grid = np.flatnonzero(~is_on_grid(boxes.camera))
    if off_grid.size:
        polygons = warp(boxes.xywh[off_grid], boxes.camera[off_grid], boxes.view[off_grid])
        areas = polygon_overlap(polygons, target_xywh[off_grid])
        for column, warped in zip(overlap, areas, strict=True):
            column[off_grid] = warped
    return overlap


def _among(count: int, rows: IntArray, overlap: Overlap) -> Overlap:
    """Return the overlaps of so many boxes, of which only those in these rows overlap anything."""
    intersection, total = np.zeros(count), np.ones(count)
    intersection[rows], total[rows] = overlap
    return Overlap(intersection, total)


def _has_rival(target: IntArray, solution: Solution) -> BoolArray:
    """Whether another object's box in the same view would be accepted as each target's box."""
    box_xywh = solution.boxes.xywh
    index, other = solution.boxes.pair_with_others(target)
    is_rival = box_match(box_xywh.take(other, axis=0), box_xywh.take(target[index], axis=0))
    # bincount has an entry for targets without any other object too; reduceat would not.
    return np.bincount(index, weights=is_rival, minlength=len(target)) > 0
