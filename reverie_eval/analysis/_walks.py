"""The outcomes of a method in all episodes, small enough to be kept for all methods of a board."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, row_of
from reverie_eval.scoring import CORRECT, Scores, is_goal, outcome_indices


@dataclass(frozen=True, eq=False)
class WalkOutcomes:
    """How a method's walks ended and where they first went wrong; shapes are (n_episodes,).

    Viewpoints are indices in the navigation graph of the split.
    """

    outcome: IntArray
    """Index into ``OUTCOMES``."""
    path_length: FloatArray
    """Metres walked."""
    stop: IntArray
    """The viewpoint of the last pose."""
    wrong_turn: IntArray
    """Shape (n_episodes, 2): the first move that led away from the end of the annotated path, from
    a viewpoint to another; -1 twice if there was none before a goal viewpoint was reached."""

    @classmethod
    def of(cls, scores: Scores) -> Self:
        """Summarise the walks of a submission.

        Raises
        ------
        ProtocolError
            If the protocol or track scores no outcomes.
        """
        submission = scores.require_submission()
        return cls(
            outcome=outcome_indices(scores.episodes).astype(np.uint8),
            path_length=scores.episodes["path_length"],
            stop=submission.viewpoint[submission.offsets[1:] - 1].astype(np.int32),
            wrong_turn=_wrong_turns(scores).astype(np.int32),
        )

    @cached_property
    def is_correct(self) -> BoolArray:
        """Whether the agent stopped at the goal and predicted the target."""
        return np.equal(self.outcome, CORRECT)


def _wrong_turns(scores: Scores) -> IntArray:
    submission, truth = scores.require_submission(), scores.ground_truth
    viewpoint, episode = submission.viewpoint, row_of(submission.offsets)
    end = truth.require_solution().goal[episode]
    distance = truth.graph.distance_between(viewpoint, end)
    is_at_goal = is_goal(scores.protocol.goal, truth, episode, viewpoint)
    # Poses at a goal viewpoint before each one, in the whole file, minus those before its episode.
    earlier = np.concatenate([[0], np.cumsum(is_at_goal)])
    has_reached = earlier[1:] > earlier[submission.offsets[:-1]][episode]
    is_move = episode[1:] == episode[:-1]
    leads_away = is_move & (distance[1:] > distance[:-1]) & ~has_reached[:-1]
    moves = np.flatnonzero(leads_away)
    episodes, first = np.unique(episode[moves], return_index=True)
    turns = np.full((len(submission.predicted_object), 2), -1)
    turns[episodes] = np.column_stack([viewpoint[moves], viewpoint[moves + 1]])[first]
    return turns
