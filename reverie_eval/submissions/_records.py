"""The careful reader: read records value by value, and explain what cannot be read.

Nothing is repaired. A value that has none of the known forms becomes a problem with its location,
and reading goes on, so that all problems are found at once. A form that differs from the official
one without changing the meaning is read, counted and reported.
"""

from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from reverie_eval.arrays import offsets_of
from reverie_eval.errors import SubmissionError
from reverie_eval.ground_truth import NavigationGraph
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._answers import (
    NO_POINT,
    Answer,
    GivenBoxes,
    Point,
    box_columns,
    disagree,
    has_answer,
    predicts,
    read_answer,
    read_point,
)
from reverie_eval.submissions._document import are_records, locate_records, parse_document
from reverie_eval.submissions._fast import convert_official, read_fast
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._fields import (
    ID_KEYS,
    INSTR_ID_KEY,
    MAX_COMPARED,
    PART_OF_ITEM,
    TRAJECTORY_KEY,
    Fields,
    answers_spelt_like,
    fields_of,
    find_misspelt,
    id_key_of,
    is_integer,
    is_list,
    unwrap,
)
from reverie_eval.submissions._predictions import (
    NO_BOXES,
    Numbering,
    Predictions,
    Signs,
    Submission,
    look_like_degrees,
)
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.submissions._sources import read_bytes
from reverie_eval.submissions._trajectories import (
    Trajectory,
    has_point,
    is_item,
    read_trajectory,
    split_items,
    take_path,
)
from reverie_eval.tasks import DEFAULT_TASK, ID_PREFIX, Task, find_task

REVERIE = find_task(DEFAULT_TASK)
"""What is read if no task is named."""


class ReadRecord(NamedTuple):
    """The content of one record."""

    location: RecordLocation
    instr_id: str | None
    """None if it could not be read."""
    trajectory: Trajectory
    answer: Answer | None
    """None if no record of the file has an answer."""
    point: Point = NO_POINT


def read_predictions(
    submission: Submission,
    task: Task = REVERIE,
    graph: NavigationGraph | None = None,
    *,
    answers_only: bool = False,
) -> Predictions:
    """Read a submission in any form that public codebases of a task write.

    A file is read fast if its viewpoints are those of the graph. With ``answers_only``,
    trajectories are ignored and may be left out.

    Raises
    ------
    SubmissionError
        If it is not a list of records at all. Smaller problems are in the result's ``problems``.
    OSError
        If the file cannot be read.
    """
    if not are_records(submission):
        return parse_predictions(read_bytes(submission), task, graph, answers_only=answers_only)
    if not answers_only and not task.has_items:
        predictions = convert_official(submission, has_answers=task.has_targets)
        if predictions is not None:
            return predictions
    return read_carefully(submission, ReadingLog(), task, answers_only=answers_only)


def parse_predictions(
    content: bytes, task: Task, graph: NavigationGraph | None, *, answers_only: bool
) -> Predictions:
    """Read the unpacked JSON text of a submission, as :func:`read_predictions` does."""
    if graph is not None:
        predictions = read_fast(content, task, graph.viewpoint_table, answers_only=answers_only)
        if predictions is not None:
            return predictions
    log = ReadingLog()
    document = parse_document(content, log)
    return read_carefully(document, log, task, answers_only=answers_only)


def read_headings(content: bytes, instr_id: str, task: Task = REVERIE) -> Sequence[float | None]:
    """Return the heading of each pose of an episode, radians; None where the text has none.

    Empty if the episode is not found. Scores do not depend on them, so the readers of whole files
    leave them out. Where all are 0 they were not known: converted files have that.
    """
    log = ReadingLog()
    for location, record in locate_records(parse_document(content, log), log, task):
        if record.get(location.id_key, location.key) == instr_id:
            headings = read_trajectory(location, record, log).headings
            return headings if any(headings) else ()
    return ()


def read_records(
    document: Any, log: ReadingLog, task: Task, *, answers_only: bool = False
) -> tuple[Sequence[ReadRecord], Signs]:
    """Read a list of records, or an object of records keyed by their instr_id.

    Raises
    ------
    SubmissionError
        If it is neither, or has positions instead of viewpoints, or too many problems to go on.
        Smaller problems are in the log, to be reported together with those that alignment finds.
    """
    located = locate_records(document, log, task)
    optional = {TRAJECTORY_KEY} if answers_only else set()
    named = [
        (location, _with_known_fields(location, record, log, optional, fields_of(task)))
        for location, record in located
    ]
    signs = _signs_of([record for _, record in located], [record for _, record in named], task)
    found = [(location, _with_id(location, record, log, task)) for location, record in named]
    if task.has_items:
        records = [
            (location, _with_known_fields(location, record, log, optional, PART_OF_ITEM))
            for location, record in split_items(found, log)
        ]
    else:
        records = [
            (location, take_path(location, record, log) if is_item(record) else record)
            for location, record in found
        ]
    _check_problem_count(log)
    # A single missing answer is a fault; if no record has one, the agent does not ground at all.
    has_any = any(has_answer(record) for _, record in records)
    navigation_only = bool(records) and not (task.has_targets and has_any)
    log.differences["navigation only"] += len(records) * (navigation_only and task.has_targets)
    if navigation_only and answers_only:
        log.problems.append(problems.NO_ANSWERS.of_file())
    read = []
    for location, record in records:
        instr_id = _read_instr_id(location, record, log, task)
        trajectory = None if answers_only else read_trajectory(location, record, log)
        answer = None if navigation_only else read_answer(location, record, trajectory, log)
        point = read_point(location, record, log) if task.has_items else NO_POINT
        read.append(ReadRecord(location, instr_id, trajectory or Trajectory(), answer, point))
        _check_problem_count(log)
    return read, signs


def _signs_of(
    given: Sequence[Mapping[str, Any]], named: Sequence[Mapping[str, Any]], task: Task
) -> Signs:
    """Return what the form of records says, as given and with their fields renamed."""
    if not given:
        return Signs()
    keys = {frozenset(ID_KEYS.intersection(record)) for record in given}
    # Only a field that all records have, and no other id field beside it, tells a task.
    (key,) = next(iter(keys)) if len(keys) == 1 and len(next(iter(keys))) == 1 else ("",)
    items = [record for record in named if is_item(record)]
    return Signs(
        id_key=key,
        has_items=len(items) == len(named),
        has_points=any(map(has_point, items)),
        has_answers=task.has_targets and any(map(predicts, named)),
        numbered=frozenset() if task.has_numbers else _numbered(named, task),
    )


def _numbered(records: Sequence[Mapping[str, Any]], task: Task) -> frozenset[int]:
    """Return the rows of records whose ids are numbers."""
    ids = [record.get(id_key_of(record, task)) for record in records]
    return frozenset(
        row
        for row, each in enumerate(ids)
        if not isinstance(each, str) and is_integer(unwrap(each)[0])
    )


def _check_problem_count(log: ReadingLog) -> None:
    # Asked after each record: a file of another kind would give a problem for each of its values.
    if len(log.problems) > faults.MAX_PROBLEMS:
        raise SubmissionError(faults.limit_problems(log.all_problems()))


def _with_known_fields(
    location: RecordLocation,
    record: Mapping[str, Any],
    log: ReadingLog,
    optional: AbstractSet[str],
    fields: Fields,
) -> Mapping[str, Any]:
    """Return a record with its misspelt fields under the names that they must mean."""
    if record.keys() <= fields.all:
        return record
    # The key is the record's id, so a field that resembles one may be a note of the codebase's.
    if location.key is not None:
        optional = {*optional, fields.id.name}
    few = log.unknown_fields + len(record) <= MAX_COMPARED
    misspelt = find_misspelt(record, fields, optional) if few else {}
    for field, meant in misspelt.items():
        log.add_fault(faults.misspelt(field, meant), location, "", field)
    ignored = [field for field in record if field not in fields.all and field not in misspelt]
    log.ignored_fields.update(ignored)
    for field in ignored if few and fields.has_answers else ():
        others = answers_spelt_like(field)
        if others and disagree((answers := _given(record, [*others, field])).values()):
            log.add_fault(faults.DISAGREEING_ANSWERS, location, "", answers)
    if not misspelt:
        return record
    return {**record, **{meant: record[field] for field, meant in misspelt.items()}}


def _given(record: Mapping[str, Any], fields: Iterable[str]) -> Mapping[str, Any]:
    """Return those of some fields that a record has, without null."""
    return {field: record[field] for field in fields if record.get(field) is not None}


def _with_id(
    location: RecordLocation, record: Mapping[str, Any], log: ReadingLog, task: Task
) -> Mapping[str, Any]:
    """Return a record with its id as instr_id, whatever the task calls it; a number as text."""
    key = id_key_of(record, task)
    if key not in record:
        return record
    given = record[key]
    # How a text differs from an id is found with the ids of the split.
    meant, fault = (given, None) if isinstance(given, str) else unwrap(given)
    if fault is not None and isinstance(meant, str | int | float):
        log.add_fault(fault, location, f".{INSTR_ID_KEY}", given)
    if isinstance(meant, float) and meant.is_integer() and task.has_numbers:
        log.add_fault(faults.DECIMAL_NUMBERS, location, f".{INSTR_ID_KEY}", given)
        meant = int(meant)
    # Someone kept the parts of "4332_0" as [4332, 0].
    if is_list(meant) and meant and all(map(is_integer, meant)):
        log.add_fault(faults.REWRITTEN_IDS, location, f".{INSTR_ID_KEY}", given)
        meant = "_".join(map(str, meant))
    text = str(meant) if is_integer(meant) else meant
    if key == INSTR_ID_KEY and text is given:
        return record
    return {**{name: each for name, each in record.items() if name != key}, INSTR_ID_KEY: text}


def _read_instr_id(
    location: RecordLocation, record: Mapping[str, Any], log: ReadingLog, task: Task
) -> str | None:
    value = record.get("instr_id", location.key)
    if value is None and "instr_id" not in record:
        log.problems.append(problems.MISSING_FIELD.of_record(location, field=location.id_key))
        return None
    if not isinstance(value, str):
        log.add_wrong_type(location, INSTR_ID_KEY, value, problems.id_form(task))
        return None
    if (
        location.key is not None
        and location.trajectory is None
        and _bare(location.key) != _bare(value)
    ):
        found = problems.KEY_MISMATCH.of_record(location, instr_id=value, key=location.key)
        log.problems.append(found)
    log.differences["prefixed"] += value.startswith(ID_PREFIX)
    return value.removeprefix(ID_PREFIX)


def _bare(instr_id: str) -> str:
    return instr_id.removeprefix(ID_PREFIX)


def read_carefully(
    document: Any, log: ReadingLog, task: Task = REVERIE, *, answers_only: bool = False
) -> Predictions:
    """Read a list of records, or records keyed by their instr_id, in any form."""
    records, signs = read_records(document, log, task, answers_only=answers_only)
    walks = [record.trajectory for record in records]
    lengths = np.fromiter((len(walk.locations) for walk in walks), np.int64, len(walks))
    answers = [record.answer or Answer(ABSTAINED) for record in records]
    # The shape is said for a file without records, of which numpy makes shape (0,).
    stop_angles = np.array([_stop_angles(record) for record in records]).reshape(-1, 2)
    given = {row: answer.box for row, answer in enumerate(answers) if answer.box is not None}
    boxes = NO_BOXES
    if given:
        xywh, image_size, camera, _ = map(np.array, zip(*given.values(), strict=True))
        rows = np.array(list(given))
        boxes = box_columns(GivenBoxes(rows, xywh, image_size, camera, stop_angles[rows]), log)
    return Predictions(
        instr_ids=[record.instr_id for record in records],
        **Numbering.columns(chain.from_iterable(walk.viewpoint_ids for walk in walks)),
        offsets=offsets_of(lengths),
        predicted_object=np.array([answer.object_id for answer in answers], dtype=np.int64),
        has_degrees=look_like_degrees(stop_angles),
        answer_is_text=np.array([answer.is_text for answer in answers], dtype=np.bool_),
        has_leading_zeros=np.array([a.has_leading_zeros for a in answers], dtype=np.bool_),
        locate=[record.location for record in records].__getitem__,
        pose_locations=list(chain.from_iterable(walk.locations for walk in walks)),
        continues_hop=np.fromiter(
            chain.from_iterable(walk.continues_hop for walk in walks), np.bool_
        ),
        boxes=boxes,
        point=np.array([record.point for record in records]).reshape(-1, 2)
        if task.has_items
        else None,
        read_as=log.read_as(),
        ignored_fields=dict(log.ignored_fields),
        differences=log.differences,
        is_navigation_only=bool(records) and all(record.answer is None for record in records),
        problems=log.all_problems(),
        signs=signs,
    )


def _stop_angles(record: ReadRecord) -> tuple[float, float]:
    """Return heading and elevation of the last pose; NaN if the file gives none."""
    _, _, headings, elevations, *_ = record.trajectory
    if not headings or headings[-1] is None or elevations[-1] is None:
        return np.nan, np.nan
    return float(headings[-1]), float(elevations[-1])
