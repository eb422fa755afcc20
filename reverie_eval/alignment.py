"""From predictions to integers: every id is held against the ground truth, or reported.

Behind this stage no text is left and nothing can fail.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, repeat

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray, offsets_of, row_of, take_rows
from reverie_eval.errors import Problem, SubmissionError
from reverie_eval.ground_truth import GroundTruth, NavigationGraph
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading import BoxAnswers, Predictions, problems
from reverie_eval.reading.findings import Place

_UNKNOWN = -1


@dataclass(frozen=True, eq=False)
class AlignedSubmission:
    """A sound submission, its episodes in the order of the ground truth."""

    viewpoint: IntArray
    """Shape (n_poses,): every pose's viewpoint, trajectory after trajectory."""
    offsets: IntArray
    """Shape (n_episodes + 1,): where each episode's trajectory begins in ``viewpoint``."""
    predicted_object: IntArray
    """Shape (n_episodes,): object id within the scan, or -1."""
    answer_is_text: BoolArray
    """Shape (n_episodes,): whether the object id is written as text."""
    boxes: BoxAnswers
    """The answers that are boxes, in the order of their episodes."""

    @property
    def abstained(self) -> BoolArray:
        """Shape (n_episodes,): whether the answer is neither an object nor a box."""
        silent = np.equal(self.predicted_object, ABSTAINED)
        silent[self.boxes.row] = False
        return silent


def align(predictions: Predictions, ground_truth: GroundTruth) -> AlignedSubmission:
    """Hold predictions against a split; answers are not looked at.

    Raises
    ------
    SubmissionError
        Listing everything that is wrong, what could not be read included.
    """
    episode = _numbers(predictions.instr_ids, ground_truth.episodes.index)
    viewpoint = _numbers(predictions.viewpoint_ids, ground_truth.graph.index)
    _demand_none(
        predictions.problems,
        _episode_problems(predictions, episode, ground_truth),
        _trajectory_problems(predictions, episode, viewpoint, ground_truth),
    )
    order = np.argsort(episode)
    return _with_answers(
        predictions,
        episode,
        viewpoint=viewpoint[take_rows(order, predictions.offsets)],
        offsets=offsets_of(np.diff(predictions.offsets)[order]),
    )


def place_at_goal(predictions: Predictions, ground_truth: GroundTruth) -> AlignedSubmission:
    """Hold the answers against a split, with every agent at the end of its annotated path.

    Raises
    ------
    SubmissionError
        Listing everything that is wrong, what could not be read included.
    GroundTruthError
        If the ground truth is a public bundle.
    """
    episode = _numbers(predictions.instr_ids, ground_truth.episodes.index)
    _demand_none(predictions.problems, _episode_problems(predictions, episode, ground_truth))
    goal = ground_truth.secret.goal
    return _with_answers(predictions, episode, viewpoint=goal, offsets=np.arange(len(goal) + 1))


def _demand_none(*found: Iterable[Problem]) -> None:
    listed = problems.few_enough(chain.from_iterable(found))
    if listed:
        raise SubmissionError(listed)


def _with_answers(
    predictions: Predictions, episode: IntArray, viewpoint: IntArray, offsets: IntArray
) -> AlignedSubmission:
    """Put the answers beside trajectories that are in the order of episodes."""
    order = np.argsort(episode)
    boxes = replace(predictions.boxes, row=episode[predictions.boxes.row])
    return AlignedSubmission(
        viewpoint=viewpoint,
        offsets=offsets,
        predicted_object=predictions.predicted_object[order],
        answer_is_text=predictions.answer_is_text[order],
        boxes=boxes.take(np.argsort(boxes.row)),
    )


def _numbers(ids: Sequence[str | None], index: Mapping[str, int]) -> IntArray:
    numbers: Iterable[int] = map(index.get, ids, repeat(_UNKNOWN))  # type: ignore[arg-type]
    return np.fromiter(numbers, np.int64, len(ids))


def _episode_problems(
    predictions: Predictions, episode: IntArray, ground_truth: GroundTruth
) -> Iterator[Problem]:
    known = episode[episode != _UNKNOWN]
    times_predicted = np.bincount(known, minlength=len(ground_truth.episodes.instr_ids))
    if (times_predicted == 1).all() and len(known) == len(episode):
        return
    strangers = _strangers(predictions, episode, ground_truth)
    if ground_truth.is_demo and not known.size and strangers.keys() == {None}:
        yield problems.ids_outside_demo(len(strangers[None]), ground_truth.split)
        return
    yield from _stranger_problems(predictions, strangers, ground_truth.split)
    yield from _duplicate_problems(predictions, episode)
    yield from _missing_problems(np.flatnonzero(times_predicted == 0), ground_truth)


def _strangers(
    predictions: Predictions, episode: IntArray, ground_truth: GroundTruth
) -> Mapping[str | None, list[int]]:
    """Group predictions of no episode of this split by the split they do belong to."""
    split_of = {
        instr_id: split
        for split, instr_ids in ground_truth.other_splits.items()
        for instr_id in instr_ids.tolist()
    }
    groups: defaultdict[str | None, list[int]] = defaultdict(list)
    for prediction in np.flatnonzero(episode == _UNKNOWN).tolist():
        instr_id = predictions.instr_ids[prediction]
        if instr_id is not None:
            groups[split_of.get(instr_id)].append(prediction)
    return groups


def _stranger_problems(
    predictions: Predictions, strangers: Mapping[str | None, list[int]], split: str
) -> Iterator[Problem]:
    for other, group in strangers.items():
        if other is not None:
            place, instr_id = _named(predictions, group[0])
            yield problems.ids_of_another_split(len(group), other, split, place, instr_id)
    for prediction in strangers.get(None, ()):
        yield problems.unknown_episode(*_named(predictions, prediction), split)


def _duplicate_problems(predictions: Predictions, episode: IntArray) -> Iterator[Problem]:
    first: dict[int, Place] = {}
    for prediction, number in enumerate(episode.tolist()):
        place, instr_id = _named(predictions, prediction)
        if number in first:
            yield problems.duplicate_episode(place, instr_id, first[number])
        elif number != _UNKNOWN:
            first[number] = place


def _missing_problems(missing: IntArray, ground_truth: GroundTruth) -> Iterator[Problem]:
    instr_ids = ground_truth.episodes.instr_ids
    if len(missing) == len(instr_ids):
        yield problems.no_prediction_at_all(ground_truth.split, len(instr_ids))
        return
    for number in missing.tolist():
        yield problems.missing_episode(instr_ids[number], ground_truth.split)


def _named(predictions: Predictions, record: int) -> tuple[Place, str]:
    return predictions.place(record), str(predictions.instr_ids[record])


def _trajectory_problems(
    predictions: Predictions, episode: IntArray, viewpoint: IntArray, ground_truth: GroundTruth
) -> Iterator[Problem]:
    """Report poses that no agent can have taken in their episode."""
    graph = ground_truth.graph
    prediction = row_of(predictions.offsets)
    start = ground_truth.episodes.start[episode][prediction]
    is_here = (viewpoint != _UNKNOWN) & (
        graph.viewpoint_scan[viewpoint] == graph.viewpoint_scan[start]
    )
    route = graph.distance_between(start, np.where(is_here, viewpoint, start))
    is_sound = is_here & np.isfinite(route)
    first = predictions.offsets[:-1][np.diff(predictions.offsets) > 0]
    is_sound[first] &= viewpoint[first] == start[first]
    for pose in np.flatnonzero(~is_sound & (episode[prediction] != _UNKNOWN)).tolist():
        if predictions.viewpoint_ids[pose] is not None:  # else reading has reported it
            yield _pose_problem(predictions, pose, int(viewpoint[pose]), int(start[pose]), graph)


def _pose_problem(
    predictions: Predictions, pose: int, viewpoint: int, start: int, graph: NavigationGraph
) -> Problem:
    prediction = int(np.searchsorted(predictions.offsets, pose, side="right")) - 1
    place, instr_id = _named(predictions, prediction)
    path = predictions.pose_path(prediction, pose)
    viewpoint_id = str(predictions.viewpoint_ids[pose])
    scan = graph.scan_of(start)
    if viewpoint == _UNKNOWN:
        return problems.unknown_viewpoint(place, path, viewpoint_id, scan)
    if graph.scan_of(viewpoint) != scan:
        found = graph.scan_of(viewpoint)
        return problems.viewpoint_of_another_scan(place, path, viewpoint_id, scan, found)
    if pose == predictions.offsets[prediction]:
        return problems.wrong_start(place, instr_id, graph.viewpoint_ids[start], viewpoint_id)
    return problems.unreachable(place, path, viewpoint_id)
