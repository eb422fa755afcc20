"""Alignment: look up every id in the ground truth, and report those that are missing.

After this stage there is no text left, and nothing can fail.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, repeat
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import IntArray, row_of
from reverie_eval.errors import SHOWN_PROBLEMS, Problem, SubmissionError
from reverie_eval.ground_truth import GroundTruth, NavigationGraph
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._predictions import (
    MOST,
    Content,
    Numbering,
    Predictions,
    SubmissionColumns,
)
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.submissions._recognition import (
    Ids,
    fix_viewpoint_ids,
    is_viewpoint_id,
    outside_demo,
    recognise,
)
from reverie_eval.text import first_few

_UNKNOWN = -1


def align(predictions: Predictions, ground_truth: GroundTruth) -> SubmissionColumns:
    """Align predictions with the episodes of a split, without looking at the solution.

    For a subset, records of other episodes are checked as well, and then left out.

    Raises
    ------
    SubmissionError
        Listing every problem, including those found while reading.
    """
    whole, rows = ground_truth.subset_of or (ground_truth, None)
    looked = _look_up(predictions, whole)
    predictions, episode, viewpoint, _ = looked
    _check_release(len(episode), whole)
    _check_buildings(predictions, episode, viewpoint, whole)
    _raise_problems(
        predictions.problems,
        _episode_problems(looked, ground_truth),
        _trajectory_problems(predictions, episode, viewpoint, whole),
    )
    return replace(predictions, viewpoint=viewpoint).take(_in_order(episode, whole, rows))


def align_answers_only(predictions: Predictions, ground_truth: GroundTruth) -> SubmissionColumns:
    """Align the answers alone, with every agent at the end of its annotated path.

    With a public bundle, which has no paths, every agent is at its start: the answers can be
    checked, but not scored.

    Raises
    ------
    SubmissionError
        Listing every problem, including those found while reading.
    """
    whole, rows = ground_truth.subset_of or (ground_truth, None)
    looked = _look_up(predictions, whole)
    predictions, episode, _, _ = looked
    _check_release(len(episode), whole)
    _raise_problems(predictions.problems, _episode_problems(looked, ground_truth))
    # A public bundle has no goals; the starts serve as well to check the answers.
    solution = ground_truth.solution
    stop = ground_truth.episodes.start if solution is None else solution.goal
    in_order = predictions.take(_in_order(episode, whole, rows))
    return replace(in_order, viewpoint=stop, offsets=np.arange(len(stop) + 1))


def check_batch(
    predictions: Predictions,
    ground_truth: GroundTruth,
    collected: Mapping[str, Content],
) -> Mapping[str, Content]:
    """Check predictions of some episodes, without looking at the solution.

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
    whole = ground_truth.whole
    predictions, episode, viewpoint, _ = _look_up(predictions, whole)
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

    Without this check, a file that lost its answers on the way would be scored, and use a
    submission. A file with answers need not be declared, so None means the same as False here.

    Raises
    ------
    SubmissionError
        If it is not as declared.
    """
    if found and not declared:
        raise SubmissionError([problems.UNDECLARED_NAVIGATION_ONLY.of_file()])
    if declared and not found:
        raise SubmissionError([problems.DECLARED_NAVIGATION_ONLY.of_file()])


class _Looked(NamedTuple):
    """Predictions with their ids looked up."""

    predictions: Predictions
    episode: IntArray
    """Shape (n_records,): -1 for an unknown id."""
    viewpoint: IntArray
    """Shape (n_poses,): -1 for an unknown id."""
    is_unresolved: bool = False
    """Whether some records' ids do not tell which episodes they are for."""


def _look_up(predictions: Predictions, ground_truth: GroundTruth) -> _Looked:
    """Look up the episode of each record and the viewpoint of each pose.

    If unknown ids have something in common, that is one problem, and what was meant is looked up.

    Raises
    ------
    SubmissionError
        If the file as a whole is for another task, split or world: what else is wrong with it
        depends on what it is for.
    """
    episode, viewpoint = _episodes_and_viewpoints(predictions, ground_truth)
    signs = predictions.signs
    has_its_form = not signs.numbered and signs.has_items == ground_truth.task.has_items
    # Nearly always: recognition compares texts, one by one.
    if has_its_form and not ((episode == _UNKNOWN).any() or (viewpoint == _UNKNOWN).any()):
        return _Looked(predictions, episode, viewpoint)
    log = ReadingLog()
    found = recognise(
        predictions.instr_ids,
        signs,
        ground_truth,
        log,
        lambda record: (predictions.location(record), ".instr_id"),
    )
    if found.problem is not None:
        raise SubmissionError([found.problem])
    predictions = _with_ids(predictions, found.instr_ids, ground_truth, log)
    indexes = _episodes_and_viewpoints(predictions, ground_truth)
    return _Looked(predictions, *indexes, found.is_unresolved)


def _check_release(found: int, ground_truth: GroundTruth) -> None:
    """Raise one SubmissionError for a file with as many records as another release has episodes."""
    expected, own = len(ground_truth.episodes.instr_ids), ground_truth.header.dataset
    releases = ground_truth.task.releases
    if found == expected or own not in releases.values():
        return
    for (split, _, episodes), release in releases.items():
        if (split, episodes) == (ground_truth.split, found):
            problem = problems.OTHER_RELEASE.of_file(
                found=found, release=release, split=split, own=own, expected=expected
            )
            raise SubmissionError([problem])


def _check_buildings(
    predictions: Predictions, episode: IntArray, viewpoint: IntArray, ground_truth: GroundTruth
) -> None:
    """Raise one SubmissionError for a file whose ids are only by chance those of the split.

    R2R, R4R and their splits number paths alike, in different buildings.
    """
    first = predictions.offsets[:-1]
    rows = np.flatnonzero((np.diff(predictions.offsets) > 0) & (episode != _UNKNOWN))
    begin = viewpoint[first[rows]]
    scan = ground_truth.graph.viewpoint_scan
    # An unknown start is -1, and takes the scan of the last viewpoint; it is decided below.
    elsewhere = scan[begin] != scan[ground_truth.episodes.start[episode[rows]]]
    # The graph has the buildings of the split alone, so other viewpoints may be of another one.
    elsewhere[begin == _UNKNOWN] = [
        is_viewpoint_id(predictions.viewpoint_id(pose))
        for pose in first[rows[begin == _UNKNOWN]].tolist()
    ]
    count = int(elsewhere.sum())
    # A few wrong starts are an agent's mistakes, and told one by one.
    if count > SHOWN_PROBLEMS and count > MOST * len(rows):
        if ground_truth.is_demo and (begin[elsewhere] == _UNKNOWN).all():
            found = outside_demo(
                problems.BUILDINGS_OUTSIDE_DEMO, ground_truth, count=count, total=len(rows)
            )
        else:
            found = problems.OTHER_BUILDINGS.of_file(
                count=count, total=len(rows), split=ground_truth.split
            )
        raise SubmissionError([found])


def _with_ids(
    predictions: Predictions, instr_ids: Ids, ground_truth: GroundTruth, log: ReadingLog
) -> Predictions:
    record_of = row_of(predictions.offsets).tolist()

    def location_of_pose(pose: int) -> tuple[RecordLocation, str]:
        record = record_of[pose]
        within = predictions.pose_location(record, pose)
        return predictions.location(record), problems.pose_field(within)

    viewpoint_ids = fix_viewpoint_ids(
        predictions.viewpoint_ids, ground_truth, log, location_of_pose
    )
    return replace(
        predictions,
        instr_ids=instr_ids,
        **Numbering.columns(viewpoint_ids),
        problems=[*predictions.problems, *log.all_problems()],
    )


def _raise_problems(*groups: Iterable[Problem]) -> None:
    # The groups are generators: nothing is searched for beyond the limit.
    found = faults.limit_problems(chain.from_iterable(groups))
    if found:
        raise SubmissionError(found)


def _in_order(episode: IntArray, whole: GroundTruth, rows: IntArray | None) -> IntArray:
    """Return the records in the order of the ground truth, those of some episodes alone."""
    # Every episode that is scored occurs once by now, and no other one more than once.
    record = np.empty(len(whole.episodes.instr_ids), dtype=np.int64)
    record[episode] = np.arange(len(episode))
    return record if rows is None else record[rows]


def _episodes_and_viewpoints(
    predictions: Predictions, ground_truth: GroundTruth
) -> tuple[IntArray, IntArray]:
    episodes = ground_truth.episodes
    episode = episodes.table.find(predictions.instr_ids)
    if episode is None:  # some are unknown, or unusual
        episode = _indices(predictions.instr_ids, episodes.index)
    graph = ground_truth.graph
    if predictions.distinct_ids is graph.viewpoint_ids:  # nearly always: they are read with these
        return episode, predictions.viewpoint
    return episode, _indices(predictions.distinct_ids, graph.index)[predictions.viewpoint]


def _indices(ids: Sequence[str | None], index: Mapping[str, int]) -> IntArray:
    # `map` calls `dict.get` from C: no Python frame for each of thousands of episodes.
    indices: Iterable[int] = map(index.get, ids, repeat(_UNKNOWN))  # type: ignore[arg-type]
    return np.fromiter(indices, np.int64, len(ids))


def _episode_problems(looked: _Looked, ground_truth: GroundTruth) -> Iterator[Problem]:
    """Report unknown, duplicate and missing episodes."""
    predictions, episode, _, is_unresolved = looked
    whole, rows = ground_truth.subset_of or (ground_truth, slice(None))
    known = episode[episode != _UNKNOWN]
    times_predicted = np.bincount(known, minlength=len(whole.episodes.instr_ids))
    is_complete = (times_predicted[rows] == 1).all() and (times_predicted <= 1).all()
    if is_complete and len(known) == len(episode):
        return  # nearly always: what follows loops over records in Python
    yield from _unknown_problems(predictions, episode, ground_truth)
    yield from _duplicate_problems(predictions, episode)
    if is_unresolved:
        return
    episodes, split = ground_truth.episodes, ground_truth.split
    expected = len(episodes.instr_ids)
    if ground_truth.subset_digest:
        split = f"the subset {ground_truth.subset_digest} of {split}"
    if predictions.problems and not len(episode):
        return  # that nothing is a record was reported
    if len(episode) > SHOWN_PROBLEMS and not any(it is not None for it in predictions.instr_ids):
        return  # that no id could be read is one problem, which was reported
    if not known.size:
        yield problems.NO_EPISODE_OF_SPLIT.of_file(expected=expected, split=split)
        return
    missing = np.flatnonzero(times_predicted[rows] == 0).tolist()
    if len(missing) > SHOWN_PROBLEMS:
        yield problems.MISSING_EPISODES.of_file(
            count=len(missing),
            expected=expected,
            split=split,
            examples=first_few(episodes.instr_ids[row] for row in missing),
            points=100 * len(missing) / expected,
        )
        return
    for row in missing:
        start = ground_truth.graph.viewpoint_ids[episodes.start[row]]
        yield problems.MISSING_EPISODE.of_file(
            instr_id=episodes.instr_ids[row], split=split, start=start
        )


def _unknown_problems(
    predictions: Predictions, episode: IntArray, ground_truth: GroundTruth
) -> Iterator[Problem]:
    """Report records of episodes that the split does not have."""
    for record in np.flatnonzero(episode == _UNKNOWN).tolist():
        if predictions.instr_ids[record] is not None:  # None was reported before
            location, instr_id = _location_and_id(predictions, record)
            yield problems.UNKNOWN_EPISODE.of_record(
                location, instr_id=instr_id, split=ground_truth.split, task=ground_truth.task
            )


def _duplicate_problems(predictions: Predictions, episode: IntArray) -> Iterator[Problem]:
    first: dict[int, int] = {}
    log = ReadingLog()
    for record, index in enumerate(episode.tolist()):
        earlier = first.setdefault(index, record)
        if index == _UNKNOWN or earlier == record:
            continue
        location, instr_id = _location_and_id(predictions, record)
        if predictions.content(record) == predictions.content(earlier):
            log.add_fault(faults.REPEATED_RECORDS, location, ".instr_id", instr_id)
        else:
            yield problems.DUPLICATE_EPISODE.of_record(
                location, instr_id=instr_id, first=predictions.location(earlier)
            )
    yield from log.all_problems()


def _changed_problems(
    predictions: Predictions, contents: Sequence[Content], collected: Mapping[str, Content]
) -> Iterator[Problem]:
    """Report episodes that have another prediction already."""
    earlier = dict(collected)
    for record, content in enumerate(contents):
        if earlier.setdefault(str(predictions.instr_ids[record]), content) != content:
            location, instr_id = _location_and_id(predictions, record)
            yield problems.CHANGED_PREDICTION.of_record(location, instr_id=instr_id)


def _location_and_id(predictions: Predictions, record: int) -> tuple[RecordLocation, str]:
    return predictions.location(record), str(predictions.instr_ids[record])


def _trajectory_problems(
    predictions: Predictions, episode: IntArray, viewpoint: IntArray, ground_truth: GroundTruth
) -> Iterator[Problem]:
    """Report poses that an agent cannot have reached in their episode."""
    graph = ground_truth.graph
    # An unknown viewpoint or episode has index -1, which numpy takes for the last one: whatever is
    # looked up for it below is masked out again.
    start, length = ground_truth.episodes.start[episode], np.diff(predictions.offsets)
    is_wrong = graph.component[viewpoint] != np.repeat(graph.component[start], length)
    is_wrong |= viewpoint == _UNKNOWN
    first = predictions.offsets[:-1][length > 0]
    is_wrong[first] |= viewpoint[first] != start[length > 0]
    if not is_wrong.any():
        return  # nearly always: the record of each pose is needed for problems alone
    # A walk in another building is one mistake, told at its first pose.
    begin = np.repeat(viewpoint[first], length[length > 0])
    follows = graph.component[viewpoint] == graph.component[begin]
    follows &= (viewpoint != _UNKNOWN) & (begin != _UNKNOWN)
    follows[first] = False
    is_wrong &= ~follows
    record = row_of(predictions.offsets)
    for pose in np.flatnonzero(is_wrong & (episode[record] != _UNKNOWN)).tolist():
        if predictions.viewpoint_id(pose) is not None:  # None was reported while reading
            expected = int(start[record[pose]])
            yield _pose_problem(predictions, pose, int(viewpoint[pose]), expected, graph)


def _pose_problem(
    predictions: Predictions, pose: int, viewpoint: int, start: int, graph: NavigationGraph
) -> Problem:
    record = int(np.searchsorted(predictions.offsets, pose, side="right")) - 1
    location, instr_id = _location_and_id(predictions, record)
    within = predictions.pose_location(record, pose)
    viewpoint_id = str(predictions.viewpoint_id(pose))
    scan = graph.scan_of(start)
    if viewpoint == _UNKNOWN:
        return problems.UNKNOWN_VIEWPOINT.of_pose(
            location, within, viewpoint_id=viewpoint_id, scan=scan
        )
    other_scan = graph.scan_of(viewpoint)
    if other_scan != scan:
        return problems.VIEWPOINT_OF_ANOTHER_SCAN.of_pose(
            location, within, viewpoint_id=viewpoint_id, scan=scan, other_scan=other_scan
        )
    if pose == predictions.offsets[record]:
        is_item = location.trajectory is not None
        wrong = problems.WRONG_START_OF_ITEM if is_item else problems.WRONG_START
        expected = graph.viewpoint_ids[start]
        return wrong.of_pose(
            location, (0,), instr_id=instr_id, expected=expected, found=viewpoint_id
        )
    return problems.UNREACHABLE.of_pose(location, within, viewpoint_id=viewpoint_id)
