"""What happened in every episode, before any protocol judges it."""

from functools import cached_property

import numpy as np

from reverie_eval.alignment import AlignedSubmission
from reverie_eval.arrays import BoolArray, FloatArray, IntArray, last_of, row_of, take_rows
from reverie_eval.box_outcomes import BoxOutcomes, judge_boxes
from reverie_eval.ground_truth import GroundTruth, NavigationGraph
from reverie_eval.metrics import path_length


class Facts:
    """Facts about poses (flat, with ``offsets``) and about episodes, looked up when asked for.

    Raises
    ------
    GroundTruthError
        When made with a public bundle, which has no answers.
    """

    def __init__(self, submission: AlignedSubmission, ground_truth: GroundTruth) -> None:
        self.offsets = submission.offsets
        self.predicted_object = submission.predicted_object
        self.answer_is_text = submission.answer_is_text
        self._answers = ground_truth.secret
        self._submission = submission
        self._ground_truth = ground_truth
        self._graph = ground_truth.graph

    @property
    def target_object(self) -> IntArray:
        """Shape (n_episodes,): object id."""
        return self._answers.target_object

    @cached_property
    def leg_length(self) -> FloatArray:
        """Shape (n_poses,): metres from the previous pose of the episode; 0 for its first."""
        viewpoint = self._submission.viewpoint
        return self._graph.distance_between(_previous(viewpoint, self.offsets), viewpoint)

    @cached_property
    def is_jump(self) -> BoolArray:
        """Shape (n_poses,): whether no edge leads here from another viewpoint before."""
        return find_jumps(self._submission, self._graph)

    @cached_property
    def goal_distance(self) -> FloatArray:
        """Shape (n_poses,): metres to the end of the annotated path."""
        goal = self._answers.goal[self._episode]
        return self._graph.distance_between(self._submission.viewpoint, goal)

    @cached_property
    def sees_target(self) -> BoolArray:
        """Shape (n_poses,): whether the target is visible from the pose's viewpoint."""
        target = self._answers.target_object[self._episode]
        return self._answers.is_visible(target, self._submission.viewpoint)

    @cached_property
    def sees_target_near(self) -> BoolArray:
        """Shape (n_poses,): whether it is visible, and its centre at most 3 m from the camera."""
        target = self._answers.target_object[self._episode]
        return self._answers.is_visible_near(target, self._submission.viewpoint)

    @property
    def has_boxes(self) -> bool:
        """Whether any answer is a box."""
        return len(self._submission.boxes.row) > 0

    @cached_property
    def boxes(self) -> BoxOutcomes:
        """The answers that are boxes, judged."""
        stop = self._submission.viewpoint[last_of(self.offsets)]
        return judge_boxes(self._submission.boxes, stop, self.target_object, self._answers)

    @cached_property
    def shortest_length(self) -> FloatArray:
        """Shape (n_episodes,): metres from the start to the end of the annotated path."""
        start = self._ground_truth.episodes.start
        return self._graph.distance_between(start, self._answers.goal)

    @cached_property
    def annotated_length(self) -> FloatArray:
        """Shape (n_episodes,): metres along the annotated path."""
        path, offsets = self._answers.path, self._answers.path_offsets
        legs = self._graph.distance_between(_previous(path, offsets), path)
        return path_length(legs, offsets)[self._ground_truth.episodes.task]

    @cached_property
    def n_poses(self) -> IntArray:
        """Shape (n_episodes,): poses of the trajectory."""
        return np.diff(self.offsets)

    @cached_property
    def n_nodes(self) -> IntArray:
        """Shape (n_episodes,): nodes of the annotated path."""
        return np.diff(self._answers.path_offsets)[self._ground_truth.episodes.task]

    @cached_property
    def pose_to_node(self) -> FloatArray:
        """Metres from poses to nodes, a table per episode as path fidelity wants them."""
        task = self._ground_truth.episodes.task
        node = self._answers.path[take_rows(task, self._answers.path_offsets)]
        episode = np.repeat(np.arange(len(task)), self.n_nodes)
        pose = self._submission.viewpoint[take_rows(episode, self.offsets)]
        return self._graph.distance_between(pose, np.repeat(node, self.n_poses[episode]))

    @cached_property
    def _episode(self) -> IntArray:
        return row_of(self.offsets)


def find_jumps(submission: AlignedSubmission, graph: NavigationGraph) -> BoolArray:
    """Whether each pose was reached from another viewpoint that no edge joins it to."""
    viewpoint = submission.viewpoint
    previous = _previous(viewpoint, submission.offsets)
    return np.not_equal(previous, viewpoint) & ~graph.has_edge(previous, viewpoint)


def _previous(viewpoint: IntArray, offsets: IntArray) -> IntArray:
    """Return the viewpoint before each one of its row; for the row's first its own."""
    previous = np.roll(viewpoint, 1)
    first = offsets[:-1]
    previous[first] = viewpoint[first]
    return previous
