"""Alignment: look up every id in the ground truth, and report those that are missing.

After this stage there is no text left, and nothing can fail.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, repeat

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray, offsets_of, row_of, take_rows
from reverie_eval.errors import SHOWN_PROBLEMS, Problem, SubmissionError
from reverie_eval.ground_truth import GroundTruth, NavigationGraph
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._predictions import (
    AnswerColumns,
    BoxAnswers,
    Content,
    IdColumn,
    Predictions,
)
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.submissions._reading_log import ReadingLog
from reverie_eval.submissions._unknown_ids import fix_instr_ids, fix_viewpoint_ids
from reverie_eval.tasks import BUILT_IN, Task, find_task

_UNKNOWN = -1
_FOREIGN = ("other-task", "not-the-demo-world")
"""The codes of problems that explain why all ids are unknown."""


@dataclass(frozen=True, eq=False, kw_only=True)
class AlignedSubmission(AnswerColumns):
    """A valid submission, its episodes in the order of the ground truth."""

    viewpoint: IntArray
    """Shape (n_poses,): the viewpoint of every pose, trajectory after trajectory."""
    offsets: IntArray
    """Shape (n_episodes + 1,): where each episode's trajectory begins in ``viewpoint``."""

    @property
    def abstained(self) -> BoolArray:
        """Shape (n_episodes,): whether the answer predicts neither an object nor a box."""
        abstained = np.equal(self.predicted_object, ABSTAINED)
        abstained[self.boxes.row] = False
        return abstained

    def take(self, rows: IntArray) -> "AlignedSubmission":
        """Return some of the episodes, in the given order."""
        return AlignedSubmission(
            viewpoint=self.viewpoint[take_rows(rows, self.offsets)],
            offsets=offsets_of(np.diff(self.offsets)[rows]),
            **self.answers_of(rows),
        )

    @classmethod
    def concatenate(cls, parts: Sequence["AlignedSubmission"]) -> "AlignedSubmission":
        """Return the episodes of several submissions, one after the other."""
        counts = offsets_of(np.array([len(part.predicted_object) for part in parts]))[:-1]
        boxes = [
            replace(part.boxes, row=part.boxes.row + count)
            for part, count in zip(parts, counts, strict=True)
        ]
        points = [part.point for part in parts if part.point is not None]
        return cls(
            viewpoint=np.concatenate([part.viewpoint for part in parts]),
            offsets=offsets_of(np.concatenate([np.diff(part.offsets) for part in parts])),
            predicted_object=np.concatenate([part.predicted_object for part in parts]),
            answer_is_text=np.concatenate([part.answer_is_text for part in parts]),
            has_leading_zeros=np.concatenate([part.has_leading_zeros for part in parts]),
            boxes=BoxAnswers.concatenate(boxes),
            is_navigation_only=all(part.is_navigation_only for part in parts),
            point=np.concatenate(points) if points else None,
        )


def align(predictions: Predictions, ground_truth: GroundTruth) -> AlignedSubmission:
    """Align predictions with the episodes of a split, without looking at answers.

    For a subset, records of other episodes are checked as well, and then left out.

    Raises
    ------
    SubmissionError
        Listing every problem, including those found while reading.
    """
    whole, rows = ground_truth.subset_of or (ground_truth, None)
    predictions, episode, viewpoint = _look_up(predictions, whole)
    _raise_problems(
        predictions.problems,
        _episode_problems(predictions, episode, ground_truth),
        _trajectory_problems(predictions, episode, viewpoint, whole),
    )
    order = _in_order(episode, rows)
    return AlignedSubmission(
        viewpoint=viewpoint[take_rows(order, predictions.offsets)],
        offsets=offsets_of(np.diff(predictions.offsets)[order]),
        **predictions.answers_of(order),
    )


def align_answers_only(predictions: Predictions, ground_truth: GroundTruth) -> AlignedSubmission:
    """Align the answers alone, with every agent at the end of its annotated path.

    With a public bundle, which has no paths, every agent is at its start: the answers can be
    checked, but not scored.

    Raises
    ------
    SubmissionError
        Listing every problem, including those found while reading.
    """
    whole, rows = ground_truth.subset_of or (ground_truth, None)
    predictions, episode, _ = _look_up(predictions, whole)
    _raise_problems(predictions.problems, _episode_problems(predictions, episode, ground_truth))
    # A public bundle has no goals; the starts serve as well to check the answers.
    answers = ground_truth.answers
    stop = ground_truth.episodes.start if answers is None else answers.goal
    answered = predictions.answers_of(_in_order(episode, rows))
    return AlignedSubmission(viewpoint=stop, offsets=np.arange(len(stop) + 1), **answered)


def check_batch(
    predictions: Predictions,
    ground_truth: GroundTruth,
    collected: Mapping[str, Content],
) -> Mapping[str, Content]:
    """Check predictions of some episodes, without looking at answers.

    Parameters
    ----------
    predictions : Predictions
        The predictions of the batch. An episode may occur more than once, if its predictions are
        equal.
    collected : mapping
        The predictions of earlier batches, by instr_id.

    Returns
    -------
    mapping
        The predictions of this batch, by instr_id.

    Raises
    ------
    SubmissionError
        Listing every problem, including those found while reading.
    """
    whole, _ = ground_truth.subset_of or (ground_truth, None)
    predictions, episode, viewpoint = _look_up(predictions, whole)
    contents = [predictions.content(record) for record in range(len(episode))]
    _raise_problems(
        predictions.problems,
        _unknown_problems(predictions, episode, whole),
        _trajectory_problems(predictions, episode, viewpoint, whole),
        _changed_problems(predictions, contents, collected),
    )
    return dict(zip(map(str, predictions.instr_ids), contents, strict=True))


def check_navigation_only(*, found: bool, declared: bool | None) -> None:
    """Check that a submission is navigation only if, and only if, its method is declared so.

    A file with answers need not be declared, so None means the same as False here.

    Otherwise a file that lost its answers on the way would be scored, and use a submission.

    Raises
    ------
    SubmissionError
        If it is not as declared.
    """
    if found and not declared:
        raise SubmissionError([problems.undeclared_navigation_only()])
    if declared and not found:
        raise SubmissionError([problems.declared_navigation_only()])


def _look_up(
    predictions: Predictions, ground_truth: GroundTruth
) -> tuple[Predictions, IntArray, IntArray]:
    """Return the episode of each record and the viewpoint of each pose, -1 for unknown ids.

    If unknown ids have something in common, that is one problem, and what was meant is looked up.
    """
    if ground_truth.task.has_short_ids:
        full = ground_truth.episodes.by_short_id
        instr_ids = [each and full.get(each, each) for each in predictions.instr_ids]
        predictions = replace(predictions, instr_ids=instr_ids)
    episode, viewpoint = _episodes_and_viewpoints(predictions, ground_truth)
    if (episode == _UNKNOWN).any() or (viewpoint == _UNKNOWN).any():
        predictions = _fix_ids(predictions, ground_truth)
        episode, viewpoint = _episodes_and_viewpoints(predictions, ground_truth)
    return predictions, episode, viewpoint


def _fix_ids(predictions: Predictions, ground_truth: GroundTruth) -> Predictions:
    log = ReadingLog()
    record_of = row_of(predictions.offsets).tolist()

    def place_of_pose(pose: int) -> tuple[RecordLocation, str]:
        record = record_of[pose]
        path = predictions.pose_path(record, pose)
        return predictions.location(record), problems.pose_field(path)

    def place_of_id(record: int) -> tuple[RecordLocation, str]:
        return predictions.location(record), ".instr_id"

    return replace(
        predictions,
        instr_ids=fix_instr_ids(predictions.instr_ids, ground_truth, log, place_of_id),
        viewpoint_ids=IdColumn.of(
            fix_viewpoint_ids(list(predictions.viewpoint_ids), ground_truth, log, place_of_pose)
        ),
        problems=[*predictions.problems, *log.all_problems()],
    )


def _raise_problems(*groups: Iterable[Problem]) -> None:
    # The groups are generators: nothing is searched for beyond the limit.
    found = problems.limit_problems(chain.from_iterable(groups))
    if found:
        raise SubmissionError(found)


def _in_order(episode: IntArray, rows: IntArray | None) -> IntArray:
    """Return the records in the order of the ground truth, those of some episodes alone."""
    order = np.argsort(episode)
    return order if rows is None else order[np.isin(episode[order], rows)]


def _episodes_and_viewpoints(
    predictions: Predictions, ground_truth: GroundTruth
) -> tuple[IntArray, IntArray]:
    ids = predictions.viewpoint_ids
    episode = _indices(predictions.instr_ids, ground_truth.episodes.index)
    return episode, _indices(ids.distinct, ground_truth.graph.index)[ids.number]


def _indices(ids: Sequence[str | None], index: Mapping[str, int]) -> IntArray:
    # `map` calls `dict.get` from C: no Python frame for each of thousands of episodes.
    indices: Iterable[int] = map(index.get, ids, repeat(_UNKNOWN))  # type: ignore[arg-type]
    return np.fromiter(indices, np.int64, len(ids))


def _episode_problems(
    predictions: Predictions, episode: IntArray, ground_truth: GroundTruth
) -> Iterator[Problem]:
    """Report unknown, duplicate and missing episodes."""
    whole, rows = ground_truth.subset_of or (ground_truth, slice(None))
    known = episode[episode != _UNKNOWN]
    times_predicted = np.bincount(known, minlength=len(whole.episodes.instr_ids))
    is_complete = (times_predicted[rows] == 1).all() and (times_predicted <= 1).all()
    if is_complete and len(known) == len(episode):
        return  # nearly always: what follows loops over records in Python
    unknown = list(_unknown_problems(predictions, episode, ground_truth))
    yield from unknown
    if any(problem.code in _FOREIGN for problem in unknown):
        return
    yield from _duplicate_problems(predictions, episode)
    instr_ids = ground_truth.episodes.instr_ids
    if not known.size:
        yield problems.no_episode_of_split(ground_truth.split, len(instr_ids))
        return
    missing = [instr_ids[index] for index in np.flatnonzero(times_predicted[rows] == 0).tolist()]
    if len(missing) > SHOWN_PROBLEMS:
        yield problems.missing_episodes(missing, len(instr_ids), ground_truth.split)
        return
    for instr_id in missing:
        yield problems.missing_episode(instr_id, ground_truth.split)


def _unknown_problems(
    predictions: Predictions, episode: IntArray, ground_truth: GroundTruth
) -> Iterator[Problem]:
    """Report records of episodes that the split does not have."""
    if (episode != _UNKNOWN).all():
        return  # before the ids of all other splits are collected
    unknown = _unknown_by_split(predictions, episode, ground_truth)
    none_known = (episode == _UNKNOWN).all()
    if none_known and unknown.keys() == {None}:
        problem = _foreign_problem(predictions, unknown[None], ground_truth)
        if problem is not None:
            yield problem
            return
    for other_split, records in unknown.items():
        if other_split is not None:
            # One problem for all of them: the file as a whole is for the wrong split.
            location, instr_id = _location_and_id(predictions, records[0])
            problem = problems.ids_of_another_split(
                len(records), other_split, ground_truth.split, location, instr_id
            )
            yield replace(problem, split=other_split) if none_known else problem
    for record in unknown.get(None, ()):
        yield problems.unknown_episode(
            *_location_and_id(predictions, record), ground_truth.split, ground_truth.task
        )


def _foreign_problem(
    predictions: Predictions, records: Sequence[int], ground_truth: GroundTruth
) -> Problem | None:
    """Return the one problem of a file whose ids are all of another task or another world."""
    count, task = len(records), ground_truth.task
    _, first = _location_and_id(predictions, records[0])
    others = _tasks_with_such_ids(predictions.instr_ids, task)
    if others:
        return problems.ids_of_another_task(count, first, task, others)
    if ground_truth.is_demo:
        return problems.ids_outside_demo(count, first, ground_truth.split, task)
    return None


def _tasks_with_such_ids(instr_ids: Sequence[str | None], task: Task) -> Sequence[Task]:
    """Return the tasks whose ids look most like all of these; none if this task's do."""
    ids = [instr_id for instr_id in instr_ids if instr_id is not None]
    known = [task, *(find_task(name) for name in BUILT_IN if name != task.name)]
    alike = [each for each in known if all(map(each.has_id_like, ids))]
    # Of two tasks, the ids of one may all look like the other's: RxR's as R2R's, but not R2R's as
    # RxR's. The narrower form says more.
    narrow = [each for each in alike if not any(_is_wider(each, other) for other in alike)]
    return [] if task in narrow else narrow


def _is_wider(task: Task, other: Task) -> bool:
    return task.has_id_like(other.id_example) and not other.has_id_like(task.id_example)


def _unknown_by_split(
    predictions: Predictions, episode: IntArray, ground_truth: GroundTruth
) -> Mapping[str | None, list[int]]:
    """Group the records without an episode in this split by the split that has it, if any."""
    split_of = {
        instr_id: split
        for split, instr_ids in ground_truth.other_splits.items()
        for instr_id in instr_ids.tolist()
    }
    groups: defaultdict[str | None, list[int]] = defaultdict(list)
    for record in np.flatnonzero(episode == _UNKNOWN).tolist():
        instr_id = predictions.instr_ids[record]
        if instr_id is not None:
            groups[split_of.get(instr_id)].append(record)
    return groups


def _duplicate_problems(predictions: Predictions, episode: IntArray) -> Iterator[Problem]:
    first: dict[int, int] = {}
    log = ReadingLog()
    for record, index in enumerate(episode.tolist()):
        earlier = first.setdefault(index, record)
        if index == _UNKNOWN or earlier == record:
            continue
        location, instr_id = _location_and_id(predictions, record)
        if predictions.content(record) == predictions.content(earlier):
            log.add_fault(problems.REPEATED_RECORDS, location, ".instr_id", instr_id)
        else:
            yield problems.duplicate_episode(location, instr_id, predictions.location(earlier))
    yield from log.all_problems()


def _changed_problems(
    predictions: Predictions, contents: Sequence[Content], collected: Mapping[str, Content]
) -> Iterator[Problem]:
    """Report episodes that have another prediction already."""
    earlier = dict(collected)
    for record, content in enumerate(contents):
        if earlier.setdefault(str(predictions.instr_ids[record]), content) != content:
            yield problems.changed_prediction(*_location_and_id(predictions, record))


def _location_and_id(predictions: Predictions, record: int) -> tuple[RecordLocation, str]:
    return predictions.location(record), str(predictions.instr_ids[record])


def _trajectory_problems(
    predictions: Predictions, episode: IntArray, viewpoint: IntArray, ground_truth: GroundTruth
) -> Iterator[Problem]:
    """Report poses that an agent cannot have reached in their episode."""
    graph = ground_truth.graph
    # An unknown viewpoint or episode has index -1, which numpy takes for the last one: whatever is
    # looked up for it below is masked out again.
    record = row_of(predictions.offsets)
    start = ground_truth.episodes.start[episode][record]
    in_scan = (viewpoint != _UNKNOWN) & (
        graph.viewpoint_scan[viewpoint] == graph.viewpoint_scan[start]
    )
    # Distances exist within a scan only, so other viewpoints are replaced before the look-up.
    distance = graph.distance_between(start, np.where(in_scan, viewpoint, start))
    is_valid = in_scan & np.isfinite(distance)
    first = predictions.offsets[:-1][np.diff(predictions.offsets) > 0]
    is_valid[first] &= viewpoint[first] == start[first]
    for pose in np.flatnonzero(~is_valid & (episode[record] != _UNKNOWN)).tolist():
        if predictions.viewpoint_ids[pose] is not None:  # None was reported while reading
            yield _pose_problem(predictions, pose, int(viewpoint[pose]), int(start[pose]), graph)


def _pose_problem(
    predictions: Predictions, pose: int, viewpoint: int, start: int, graph: NavigationGraph
) -> Problem:
    record = int(np.searchsorted(predictions.offsets, pose, side="right")) - 1
    location, instr_id = _location_and_id(predictions, record)
    path = predictions.pose_path(record, pose)
    viewpoint_id = str(predictions.viewpoint_ids[pose])
    scan = graph.scan_of(start)
    if viewpoint == _UNKNOWN:
        return problems.unknown_viewpoint(location, path, viewpoint_id, scan)
    other_scan = graph.scan_of(viewpoint)
    if other_scan != scan:
        return problems.viewpoint_of_another_scan(location, path, viewpoint_id, scan, other_scan)
    if pose == predictions.offsets[record]:
        return problems.wrong_start(location, instr_id, graph.viewpoint_ids[start], viewpoint_id)
    return problems.unreachable(location, path, viewpoint_id)
