"""What happened in every episode, before any protocol judges it."""

from dataclasses import dataclass

import numpy as np

from reverie_eval.alignment import AlignedSubmission
from reverie_eval.arrays import BoolArray, FloatArray, IntArray, row_of
from reverie_eval.ground_truth import GroundTruth, NavigationGraph


@dataclass(frozen=True, eq=False)
class Facts:
    """Facts about poses (flat, with ``offsets``) and about episodes."""

    offsets: IntArray
    """Shape (n_episodes + 1,): where each episode's poses begin."""
    leg_length: FloatArray
    """Shape (n_poses,): metres from the previous pose of the episode; 0 for its first."""
    is_jump: BoolArray
    """Shape (n_poses,): whether no edge leads here from another viewpoint before."""
    goal_distance: FloatArray
    """Shape (n_poses,): metres to the end of the annotated path."""
    sees_target: BoolArray
    """Shape (n_poses,): whether the target is visible from the pose's viewpoint."""
    shortest_length: FloatArray
    """Shape (n_episodes,): metres from the start to the end of the annotated path."""
    predicted_object: IntArray
    """Shape (n_episodes,): object id, or -1."""
    target_object: IntArray
    """Shape (n_episodes,): object id."""


def observe(submission: AlignedSubmission, ground_truth: GroundTruth) -> Facts:
    """Look up what a submission's trajectories met on their way.

    Raises
    ------
    GroundTruthError
        If the ground truth is a public bundle, without answers.
    """
    answers, graph = ground_truth.secret, ground_truth.graph
    viewpoint = submission.viewpoint
    episode = row_of(submission.offsets)
    return Facts(
        offsets=submission.offsets,
        leg_length=graph.distance_between(_previous(submission), viewpoint),
        is_jump=find_jumps(submission, graph),
        goal_distance=graph.distance_between(viewpoint, answers.goal[episode]),
        sees_target=answers.is_visible(answers.target_object[episode], viewpoint),
        shortest_length=graph.distance_between(ground_truth.episodes.start, answers.goal),
        predicted_object=submission.predicted_object,
        target_object=answers.target_object,
    )


def find_jumps(submission: AlignedSubmission, graph: NavigationGraph) -> BoolArray:
    """Whether each pose was reached from another viewpoint that no edge joins it to."""
    previous, viewpoint = _previous(submission), submission.viewpoint
    return np.not_equal(previous, viewpoint) & ~graph.has_edge(previous, viewpoint)


def _previous(submission: AlignedSubmission) -> IntArray:
    """Return the viewpoint before each pose; for the first pose its own."""
    previous = np.roll(submission.viewpoint, 1)
    first = submission.offsets[:-1]
    previous[first] = submission.viewpoint[first]
    return previous
