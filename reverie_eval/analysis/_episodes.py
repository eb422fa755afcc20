"""Single episodes, which of them to look at, and how all walks of a method ended."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.analysis._runs import runs_of
from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray, row_of
from reverie_eval.errors import ProtocolError
from reverie_eval.geometry import snap
from reverie_eval.ground_truth import GroundTruth, NavigationGraph, Solution
from reverie_eval.logs import Step
from reverie_eval.metrics import ABSTAINED
from reverie_eval.scoring import (
    CORRECT,
    OUTCOMES,
    Protocol,
    Scored,
    Scores,
    is_goal,
    outcome_indices,
    shared_keys,
)
from reverie_eval.submissions import SubmissionColumns
from reverie_eval.text import category_text

if TYPE_CHECKING:
    from reverie_eval.reporting.episode_figure import Columns


@dataclass(frozen=True, eq=False)
class VisibleObject:
    """An object that is visible from a viewpoint, with its annotated boxes there."""

    object_id: int
    name: str
    """As :meth:`Episode.object_name` returns it."""
    view: IntArray
    """Shape (n_boxes,): the views that show it, 0 to 35."""
    xywh: IntArray
    """Shape (n_boxes, 4): left, top, width and height in pixels of the view."""


class PredictedBox(NamedTuple):
    """A predicted box, in the image of any camera at the stop."""

    xywh: FloatArray
    """Shape (4,): left, top, width and height in pixels of the camera's image."""
    camera: FloatArray
    """Shape (2,): heading and elevation, radians."""
    view: int
    """The view in which it is compared with the target's box."""


@dataclass(frozen=True, eq=False, repr=False)
class Episode:
    """A single episode of a submission, as ``scores.episode(instr_id)`` returns it.

    Viewpoints are given by their ids; :meth:`positions` returns their positions.
    """

    instr_id: str
    scan: str
    instruction: str
    outcome: str
    """One of ``OUTCOMES``; empty if the protocol or track does not define them."""
    values: Mapping[str, float]
    """The value of each metric: fractions in [0, 1], lengths in metres."""
    start: str
    """The viewpoint where the episode starts."""
    trajectory: Sequence[str]
    """The viewpoint of every pose."""
    annotated_path: Sequence[str]
    goal_viewpoints: Sequence[str]
    """The viewpoints where a stop is a success under the protocol."""
    target_object: int | None
    """Object id within the scan; None in a task without target objects."""
    target_category: str
    """The annotated category of the target; empty if there is none."""
    predicted_object: int | None
    """None if the agent predicted no object, or a box."""
    predicted_box: PredictedBox | None
    box_outcome: str
    """The outcome of the predicted box, one of ``BOX_OUTCOMES``; empty without a box."""
    graph: NavigationGraph
    """The navigation graphs of all scans of the split."""
    solution: Solution
    """The solution of the split."""
    steps: Sequence[Step] = ()
    """What the agent did, if :meth:`Scores.with_run` read the log of its steps: those of the last
    attempt."""

    @property
    def stop(self) -> str:
        """The viewpoint where the agent stopped."""
        return self.trajectory[-1]

    @property
    def goal(self) -> str:
        """The viewpoint where the annotated path ends."""
        return self.annotated_path[-1]

    def positions(self, viewpoint_ids: Sequence[str]) -> FloatArray:
        """Return the positions of viewpoints.

        Returns
        -------
        array, shape (n_viewpoints, 3)
            Metres in the scan's own frame, z up.
        """
        rows = [self.graph.index[viewpoint_id] for viewpoint_id in viewpoint_ids]
        return self.graph.viewpoint_position[rows]

    def visible_objects(self, viewpoint_id: str) -> Sequence[VisibleObject]:
        """Return the objects that are visible from a viewpoint, by object id."""
        solution = self.solution
        return [
            VisibleObject(
                object_id=int(solution.candidate_object[row]),
                name=self._name(int(solution.candidate_object[row]), row),
                view=solution.boxes.view[boxes],
                xywh=solution.boxes.xywh[boxes],
            )
            for row, boxes in solution.visible_from(self.graph.index[viewpoint_id])
        ]

    def object_name(self, object_id: int) -> str:
        """Name an object of the scan for people.

        Its category and its id, ``end table 12``; ``object 12`` if it is not visible from any
        viewpoint.
        """
        solution, graph = self.solution, self.graph
        rows = np.flatnonzero(solution.candidate_object == object_id)
        scans = graph.viewpoint_scan[solution.candidate_viewpoint[rows]]
        in_scan = rows[scans == graph.scan_ids.index(self.scan)].tolist()
        return self._name(object_id, in_scan[0]) if in_scan else f"object {object_id}"

    def _name(self, object_id: int, candidate: int) -> str:
        category = category_text(self.solution.candidate_categories[candidate])
        return f"{category or 'object'} {object_id}"

    @property
    def caption(self) -> str:
        """Target, answer and trajectory in one line."""
        texts = [self.outcome if self.target_object is None else self._answer_text]
        if "path_length" in self.values:
            walked, shortest = self.values["path_length"], self.values["shortest_length"]
            texts.append(f"walked {walked:.1f} m, shortest {shortest:.1f} m")
            texts.append(f"stopped {self.values['navigation_error']:.1f} m from the path's end")
        return "; ".join(filter(None, texts))

    @property
    def _answer_text(self) -> str:
        target = f"object {self.target_object}"
        if self.target_category:
            target = f"{category_text(self.target_category)} ({target})"
        if self.predicted_object == self.target_object:
            text = f"predicted the target, {target}"
        elif self.box_outcome:
            text = f"predicted a box ({self.box_outcome}), the target is {target}"
        else:
            is_none = self.predicted_object is None
            predicted = "no object" if is_none else f"object {self.predicted_object}"
            text = f"predicted {predicted}, the target is {target}"
        return f"{self.outcome}: {text}" if self.outcome else text

    # Conveniences by what is above this package; the import contract lists them.

    def save(self, file: str | Path, columns: "Columns" = 2, *, legend: bool = True) -> None:
        """Write the episode as a figure for a paper: its map and what the agent saw at its stop.

        Parameters
        ----------
        file : str or Path
            Its ending says whether it is SVG, PDF or PNG.
        columns : {1, 2}
            The width: one or two columns, 3.3 or 6.9 inches.
        legend : bool
            Whether the signs of the map are explained.
        """
        from reverie_eval.reporting.episode_figure import save_figure

        save_figure({"": self}, file, columns, legend=legend)

    def _repr_html_(self) -> str:
        """Show the map of the episode in a notebook, with its instruction and outcome."""
        from reverie_eval.reporting.map_svg import episode_html

        return episode_html(self)

    def __repr__(self) -> str:
        return f"<Episode {self.instr_id} in {self.scan}: {self.caption}>"


def episode(scores: Scores, instr_id: str) -> Episode:
    """Return one episode of the submission that was scored; see :meth:`Scores.episode`."""
    truth, submission = scores.ground_truth, scores.require_submission()
    row = truth.row_of(instr_id)
    graph, solution = truth.graph, truth.require_solution()
    item = int(truth.episodes.item[row])
    start = int(truth.episodes.start[row])
    poses = submission.viewpoint[slice(*submission.offsets[row : row + 2])]
    path = solution.path[slice(*solution.path_offsets[item : item + 2])]
    predicted = int(submission.predicted_object[row])
    return Episode(
        instr_id=instr_id,
        scan=graph.scan_of(start),
        instruction=truth.episodes.instructions[row],
        outcome=_outcome(scores, row),
        values={key: float(column[row]) for key, column in scores.episodes.items()},
        start=graph.viewpoint_ids[start],
        trajectory=_ids(graph, poses),
        annotated_path=_ids(graph, path),
        goal_viewpoints=_ids(graph, _goal_viewpoints(scores.protocol, truth, row)),
        target_object=int(solution.target_object[row]) if truth.task.has_targets else None,
        target_category=solution.target_categories[item],
        predicted_object=None if predicted == ABSTAINED else predicted,
        predicted_box=_predicted_box(submission, row),
        box_outcome=scores.box_outcomes[row],
        graph=graph,
        solution=solution,
        steps=() if scores.run is None else scores.run.steps(instr_id),
    )


def _predicted_box(submission: SubmissionColumns, row: int) -> PredictedBox | None:
    boxes = submission.boxes
    found = np.flatnonzero(boxes.row == row)
    if not found.size:
        return None
    camera = boxes.camera[found]
    return PredictedBox(boxes.xywh[found[0]], camera[0], int(snap(camera)[0]))


def _outcome(scores: Scores, row: int) -> str:
    """Return the outcome of an episode; empty if the protocol or track does not define it."""
    try:
        return scores.outcomes[row]
    except ProtocolError:
        return ""


def _ids(graph: NavigationGraph, viewpoints: IntArray) -> Sequence[str]:
    return tuple(graph.viewpoint_ids[viewpoint] for viewpoint in viewpoints.tolist())


def _goal_viewpoints(protocol: Protocol, truth: GroundTruth, row: int) -> IntArray:
    """Return the goal viewpoints of one episode, out of all viewpoints of its scan."""
    scan = truth.graph.viewpoint_scan
    viewpoints = np.flatnonzero(scan == scan[truth.episodes.start[row]])
    episodes = np.full_like(viewpoints, row)
    return viewpoints[is_goal(protocol.goal, truth, episodes, viewpoints)]


# Which episodes to look at.


# Episodes of each kind; readers learn more from different routes than from more of them.
_N_EXAMPLES = 3


def near_misses(scores: Scored) -> Mapping[str, Sequence[str]]:
    """Choose a few episodes of every failure mode, those closest to being correct first.

    With several runs, episodes that failed in this way in the most runs come first.

    Episodes that never reached the goal are ordered by how close they came to the path's end;
    those that overshot, or predicted the correct object at the wrong stop, by how close to it they
    stopped; those with a wrong object by their box's IoU, then by SPL.

    Returns
    -------
    mapping of lists of str
        Instr_ids by outcome; the same scores give the same episodes.
    """
    outcome = np.array([run.outcomes for run in runs_of(scores).values()])
    chosen = {}
    for failure in [outcome for outcome in OUTCOMES if outcome != "correct"]:
        times = (outcome == failure).sum(axis=0)
        rows = np.flatnonzero(times)
        # lexsort takes the most important key last.
        keys = [-times, *_distances(scores, failure)]
        order = np.lexsort([column[rows] for column in reversed(keys)])
        ordered = [scores.instr_ids[row] for row in rows[order].tolist()]
        chosen[failure] = with_different_routes(scores, ordered)
    return chosen


@dataclass(frozen=True, eq=False, repr=False)
class Gallery(Mapping[str, Sequence[Episode]]):
    """A few failed episodes by outcome; a notebook shows each with its map and answer."""

    episodes: Mapping[str, Sequence[Episode]]

    def __getitem__(self, outcome: str) -> Sequence[Episode]:
        return self.episodes[outcome]

    def __iter__(self) -> Iterator[str]:
        return iter(self.episodes)

    def __len__(self) -> int:
        return len(self.episodes)

    def _repr_html_(self) -> str:
        """Show near misses in a notebook, each with its map and answer."""
        from reverie_eval.reporting.map_svg import gallery_html

        return gallery_html(self)

    def __repr__(self) -> str:
        counts = ", ".join(f"{len(shown)} {outcome}" for outcome, shown in self.items())
        return f"<Gallery of near misses: {counts}>"


def gallery(scores: Scored) -> Gallery:
    """Return failed episodes that were close to being correct; see :meth:`Scored.gallery`."""

    def as_first(instr_id: str, outcome: str) -> Episode:
        runs = (episode(run, instr_id) for run in runs_of(scores).values())
        return next(run for run in runs if run.outcome == outcome)

    return Gallery(
        {
            outcome: [as_first(instr_id, outcome) for instr_id in instr_ids]
            for outcome, instr_ids in near_misses(scores).items()
            if instr_ids
        }
    )


def episodes_won(first: Scores, other: Scores) -> Sequence[str]:
    """List the episodes that only the other submission got right, the largest difference first.

    If one of them has no answers, an episode is right if its agent stopped at the goal.
    """
    shared = shared_keys([first, other])
    correct = "rgs" if "rgs" in shared else "success"
    better = other.episodes[correct] > first.episodes[correct]
    primary = first.ground_truth.task.primary_metric(shared).key
    change = other.episodes[primary] - first.episodes[primary]
    rows = np.flatnonzero(better)
    # Stable: equal differences stay in the order of the split.
    ordered = rows[np.argsort(-change[rows], kind="stable")]
    return [first.instr_ids[row] for row in ordered.tolist()]


def with_different_routes(scores: Scored, instr_ids: Sequence[str]) -> Sequence[str]:
    """Return the first few episodes that differ in start or goal."""
    truth = scores.ground_truth
    rows = np.array([truth.episodes.index[instr_id] for instr_id in instr_ids], dtype=int)
    routes = np.column_stack([truth.episodes.start[rows], truth.require_solution().goal[rows]])
    _, first_of_route = np.unique(routes, axis=0, return_index=True)
    # np.unique sorts routes by viewpoint; sorting the indices restores the order of episodes.
    return [instr_ids[index] for index in np.sort(first_of_route)[:_N_EXAMPLES].tolist()]


def _distances(scores: Scored, failure: str) -> Sequence[Array]:
    """Return how far each episode is from being correct, the most important quantity first."""
    episodes = scores.episodes
    if failure == "never reached":
        return [episodes["oracle_error"]]
    if failure == "wrong object":
        overlap = [-episodes["iou"]] if "iou" in episodes else []
        return [*overlap, -episodes["spl"]]
    return [episodes["navigation_error"]]


# All episodes of a method, small enough to be kept for all methods of a leaderboard.


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
            stop=submission.stop.astype(np.int32),
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
