"""One episode: what the agent was told, where it went, what it answered, and what came of it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import TYPE_CHECKING

import numpy as np

from reverie_eval.alignment import AlignedSubmission
from reverie_eval.arrays import FloatArray, IntArray, offsets_of
from reverie_eval.episode_table import EpisodeTable
from reverie_eval.errors import GroundTruthError, ProtocolError, ReverieEvalError
from reverie_eval.facts import Facts
from reverie_eval.ground_truth import GroundTruth, NavigationGraph
from reverie_eval.metrics import ABSTAINED
from reverie_eval.protocol import Protocol
from reverie_eval.wording import category_in_words, counted, some

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from reverie_eval.scores import Scores


@dataclass(frozen=True, eq=False, repr=False)
class Episode:
    """A single episode of a submission, as ``scores.episode(instr_id)`` returns it.

    Viewpoints are given by their ids; :meth:`positions` tells where they are.
    """

    instr_id: str
    scan: str
    instruction: str
    """What the agent was told; empty if the ground truth was compiled without."""
    outcome: str
    """One of ``anatomy.OUTCOMES``; empty where the protocol or track does not score them."""
    values: Mapping[str, float]
    """By metric; fractions in [0, 1], lengths in metres."""
    start: str
    """Where the episode starts."""
    trajectory: Sequence[str]
    """Every pose's viewpoint."""
    annotated_path: Sequence[str]
    success_viewpoints: Sequence[str]
    """Where a stop counts as success under the protocol."""
    target_object: int
    """Object id within the scan."""
    target_category: str
    """What the annotators call it, in their spelling; empty where they do not."""
    answer: int | None
    """The object that the agent named; None if it named none, or drew a box."""
    box_outcome: str
    """What became of its box: one of ``box_outcomes.OUTCOMES``; empty if it drew none."""
    graph: NavigationGraph
    """Of all scans of the split."""

    @property
    def stop(self) -> str:
        """Where the agent stopped."""
        return self.trajectory[-1]

    @property
    def goal(self) -> str:
        """Where the annotated path ends."""
        return self.annotated_path[-1]

    def positions(self, viewpoint_ids: Sequence[str]) -> FloatArray:
        """Return where viewpoints are.

        Returns
        -------
        array, shape (n_viewpoints, 3)
            Metres in the scan's own frame, z up.
        """
        rows = [self.graph.index[viewpoint_id] for viewpoint_id in viewpoint_ids]
        return self.graph.viewpoint_position[rows]

    @property
    def caption(self) -> str:
        """What there was to do, and what came of it, in a line."""
        return "; ".join(filter(None, [self._answered, *self._walked]))

    @property
    def _answered(self) -> str:
        target = f"object {self.target_object}"
        if self.target_category:
            target = f"{category_in_words(self.target_category)} ({target})"
        if self.answer == self.target_object:
            said = f"named the target, {target}"
        elif self.box_outcome:
            said = f"drew a box ({self.box_outcome}), the target is {target}"
        else:
            named = "no object" if self.answer is None else f"object {self.answer}"
            said = f"named {named}, the target is {target}"
        return f"{self.outcome}: {said}" if self.outcome else said

    @property
    def _walked(self) -> Iterator[str]:
        if "path_length" in self.values:
            walked, shortest = self.values["path_length"], self.values["shortest_length"]
            yield f"walked {walked:.1f} m, shortest {shortest:.1f} m"
            yield f"stopped {self.values['navigation_error']:.1f} m from the path's end"

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the episode on its scan's navigation graph, seen from above. Needs matplotlib.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; a new figure if not given.

        Raises
        ------
        ReverieEvalError
            If matplotlib is not installed.
        """
        from reverie_eval.reporting.plots import plot_episode

        return plot_episode(self, ax)

    def __repr__(self) -> str:
        return f"<Episode {self.instr_id} in {self.scan}: {self.caption}>"

    def _repr_html_(self) -> str:
        """Show the map in a notebook, with what there was to do and what came of it."""
        from reverie_eval.reporting.episodes import episode_html

        return episode_html(self)


def episode_of(scores: "Scores", instr_id: str) -> Episode:
    """Gather what is known of one episode.

    Raises
    ------
    ReverieEvalError
        If the split has no such episode, or these scores were made without trajectories.
    """
    truth, submission = scores.ground_truth, scores.submission
    if submission is None:
        raise ReverieEvalError("these scores were made without trajectories: evaluate the file")
    row = _row_of(instr_id, truth)
    graph, answers = truth.graph, truth.secret
    task = int(truth.episodes.task[row])
    start = int(truth.episodes.start[row])
    poses = submission.viewpoint[slice(*submission.offsets[row : row + 2])]
    path = answers.path[slice(*answers.path_offsets[task : task + 2])]
    answer = int(submission.predicted_object[row])
    return Episode(
        instr_id=instr_id,
        scan=graph.scan_of(start),
        instruction=_instruction(truth, row),
        outcome=_outcome(scores, row),
        values={key: float(column[row]) for key, column in scores.episodes.items()},
        start=graph.viewpoint_ids[start],
        trajectory=_ids(graph, poses),
        annotated_path=_ids(graph, path),
        success_viewpoints=_ids(
            graph, _success_viewpoints(submission, truth, scores.protocol, row)
        ),
        target_object=int(answers.target_object[row]),
        target_category=_category(truth, task),
        answer=None if answer == ABSTAINED else answer,
        box_outcome=scores.box_outcome[row],
        graph=graph,
    )


def _row_of(instr_id: str, truth: GroundTruth) -> int:
    row = truth.episodes.index.get(instr_id)
    if row is None:
        known = truth.episodes.instr_ids
        near = get_close_matches(str(instr_id), known) or known
        number = counted(len(known), "episode")
        raise ReverieEvalError(
            f"no episode {instr_id!r} among the {number} of {truth.split}; there are {some(near)}"
        )
    return row


def _ids(graph: NavigationGraph, viewpoints: IntArray) -> Sequence[str]:
    return tuple(graph.viewpoint_ids[viewpoint] for viewpoint in viewpoints.tolist())


def _instruction(truth: GroundTruth, row: int) -> str:
    try:
        return truth.episodes.instructions[row]
    except GroundTruthError:
        return ""


def _category(truth: GroundTruth, task: int) -> str:
    try:
        return truth.secret.target_categories[task]
    except GroundTruthError:
        return ""


def _outcome(scores: "Scores", row: int) -> str:
    try:
        return scores.outcomes[row]
    except ProtocolError:
        return ""


def _success_viewpoints(
    submission: AlignedSubmission, truth: GroundTruth, protocol: Protocol, row: int
) -> IntArray:
    """Send the agent to every viewpoint of the scan, and ask the protocol where it is at the goal.

    No rule of a protocol is written twice so.
    """
    scan = truth.graph.viewpoint_scan
    everywhere = np.flatnonzero(scan == scan[truth.episodes.start[row]])
    visits = np.zeros(len(truth.episodes.instr_ids), dtype=np.int64)
    visits[row] = len(everywhere)
    tour = replace(submission, viewpoint=everywhere, offsets=offsets_of(visits))
    return everywhere[EpisodeTable(Facts(tour, truth), protocol).at_goal]
