"""Read records value by value: what says what the official form says is taken, the rest explained.

Nothing is repaired. A value that has none of the known forms becomes a problem with its place, and
reading goes on, so that all of them are found at once. What was read although it is not the
official form is counted, and said.
"""

from collections.abc import Iterable, Mapping, Sequence, Sized
from typing import Any, NamedTuple

import numpy as np

from reverie_eval.arrays import offsets_of
from reverie_eval.errors import SubmissionError
from reverie_eval.geometry import FAR_OFF, degrees_off, is_on_grid
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading import problems
from reverie_eval.reading.answers import ANSWER_KEYS, Answer, has_answer, read_answer
from reverie_eval.reading.boxes import BOX_KEYS
from reverie_eval.reading.document import RepeatingObject
from reverie_eval.reading.findings import Findings, Place
from reverie_eval.reading.predictions import ID_PREFIX, Aside, BoxAnswers, Predictions
from reverie_eval.reading.trajectories import Pose, read_trajectory

MAX_RECORDS = 200_000
"""Nearly twenty times the largest split, the 10,290 episodes of train."""

FIELDS = frozenset({"instr_id", "trajectory", *ANSWER_KEYS, *BOX_KEYS})
"""What a record is read for; everything else is ignored."""


class ReadRecord(NamedTuple):
    """One record as it was read."""

    place: Place
    instr_id: str | None
    """None where it could not be read."""
    poses: Sequence[Pose]
    answer: Answer


def read_records(document: Any, *, answers_only: bool = False) -> Predictions:
    """Read a list of records, or an object of records keyed by their instr_id.

    Raises
    ------
    SubmissionError
        If it is neither, or has too many problems to go on. Everything smaller is in the result's
        ``problems``, to be reported together with what the ground truth finds.
    """
    found = Findings()
    return _columns(read_each(document, found, answers_only=answers_only), found)


def read_each(document: Any, found: Findings, *, answers_only: bool = False) -> list[ReadRecord]:
    """Read every record that is one; raises as :func:`read_records` does."""
    if isinstance(document, Sized) and len(document) > MAX_RECORDS:
        raise SubmissionError([problems.too_many_records(len(document), MAX_RECORDS)])
    records = [
        (place, record)
        for place, record in _placed(document, found)
        if _is_record(place, record, found)
    ]
    _demand_few_problems(found)
    navigation_only = bool(records) and not any(has_answer(record) for _, record in records)
    found.differences["navigation only"] += len(records) * navigation_only
    read = []
    for place, record in records:
        instr_id = _read_instr_id(place, record, found)
        poses = None if answers_only else read_trajectory(place, record, found)
        answer = Answer(ABSTAINED)
        if not navigation_only:
            answer = read_answer(place, record, poses, found)
        read.append(ReadRecord(place, instr_id, poses or (), answer))
        _demand_few_problems(found)
    return read


def _demand_few_problems(found: Findings) -> None:
    if len(found.problems) > problems.MAX_PROBLEMS:
        raise SubmissionError(problems.few_enough(found.problems))


def _placed(document: Any, found: Findings) -> Iterable[tuple[Place, Any]]:
    if isinstance(document, list | tuple):
        return [(Place(number), record) for number, record in enumerate(document)]
    if not isinstance(document, Mapping) or not _are_records(document):
        raise SubmissionError([problems.not_a_list(document)])
    if isinstance(document, RepeatingObject):
        found.problems.extend(map(problems.repeated_key, sorted(document.repeated)))
    found.differences["keyed"] += len(document)
    return [(Place(row, key), record) for row, (key, record) in enumerate(document.items())]


def _are_records(document: Mapping[str, Any]) -> bool:
    """Whether this looks like records by id, and not like one record or a wrapped list."""
    return any(isinstance(value, Mapping) for value in document.values()) or not document


def _is_record(place: Place, record: Any, found: Findings) -> bool:
    if not isinstance(record, Mapping):
        found.problems.append(problems.not_an_object(place, record))
        return False
    if isinstance(record, RepeatingObject):
        for field in sorted(record.repeated & FIELDS):
            found.problems.append(problems.repeated_field(place, field))
    return True


def _read_instr_id(place: Place, record: Mapping[str, Any], found: Findings) -> str | None:
    value = record.get("instr_id", place.key)
    if value is None and "instr_id" not in record:
        found.problems.append(problems.missing_field(place, "instr_id"))
        return None
    if not isinstance(value, str):
        found.problems.append(problems.wrong_instr_id(place, value))
        return None
    if place.key not in (None, value):
        found.problems.append(problems.key_contradicts(place, value))
    found.differences["prefixed"] += value.startswith(ID_PREFIX)
    return value.removeprefix(ID_PREFIX)


def _columns(records: Sequence[ReadRecord], found: Findings) -> Predictions:
    poses = [pose for record in records for pose in record.poses]
    lengths = np.array([len(record.poses) for record in records], dtype=np.int64)
    answers = [record.answer for record in records]
    boxes = _box_columns(answers)
    found.differences["cameras off the grid"] += int((~is_on_grid(boxes.camera)).sum())
    found.differences["far cameras"] += int((degrees_off(boxes.camera) > FAR_OFF).sum())
    return Predictions(
        instr_ids=[record.instr_id for record in records],
        viewpoint_ids=[pose.viewpoint_id for pose in poses],
        offsets=offsets_of(lengths),
        predicted_object=np.array([answer.object_id for answer in answers], dtype=np.int64),
        stop_angles=np.array([_stop_angles(record) for record in records]).reshape(-1, 2),
        aside=Aside(
            places=[record.place for record in records],
            pose_paths=[pose.path for pose in poses],
            continues_hop=np.array([pose.continues_hop for pose in poses], dtype=np.bool_),
            answer_is_text=np.array([answer.is_text for answer in answers], dtype=np.bool_),
            boxes=boxes,
            read_as=found.read_as(),
        ),
        problems=found.problems,
    )


def _box_columns(answers: Sequence[Answer]) -> BoxAnswers:
    boxes = {row: answer.box for row, answer in enumerate(answers) if answer.box is not None}
    return BoxAnswers(
        row=np.array(list(boxes), dtype=np.int64),
        xywh=np.array([box.xywh for box in boxes.values()]).reshape(-1, 4),
        camera=np.array([box.camera for box in boxes.values()]).reshape(-1, 2),
        is_cut=np.array([box.is_cut for box in boxes.values()], dtype=np.bool_),
    )


def _stop_angles(record: ReadRecord) -> tuple[float, float]:
    stop = record.poses[-1] if record.poses else None
    if stop is None or stop.heading is None or stop.elevation is None:
        return np.nan, np.nan
    return float(stop.heading), float(stop.elevation)
