"""Read records value by value: what has the official form is taken, the rest is explained.

Nothing is repaired. A value that does not have the form becomes a problem with its place, and
reading goes on, so that all of them are found at once.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from numbers import Integral, Real
from typing import Any

import numpy as np

from reverie_eval.arrays import offsets_of
from reverie_eval.errors import Problem, SubmissionError
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading import problems
from reverie_eval.reading.document import RepeatingObject
from reverie_eval.reading.predictions import LARGEST_OBJECT_ID, Predictions

_MISSING: Any = object()


def read_records(document: Any) -> Predictions:
    """Read a list of records.

    Raises
    ------
    SubmissionError
        If it is no list. Everything smaller is in the result's ``problems``, to be reported
        together with what the ground truth finds.
    """
    if not isinstance(document, list | tuple):
        raise SubmissionError([problems.not_a_list(document)])
    found: list[Problem] = []
    records = {row: record for row, record in enumerate(document) if _is_record(row, record, found)}
    trajectories = [_read_trajectory(row, record, found) for row, record in records.items()]
    answers = [_read_answer(row, record, found) for row, record in records.items()]
    return Predictions(
        rows=list(records),
        instr_ids=[_read_instr_id(row, record, found) for row, record in records.items()],
        viewpoint_ids=list(chain.from_iterable(trajectories)),
        offsets=offsets_of(np.array([len(trajectory) for trajectory in trajectories], dtype=int)),
        predicted_object=np.array(answers, dtype=np.int64),
        problems=found,
    )


def _is_record(row: int, record: Any, found: list[Problem]) -> bool:
    if not isinstance(record, Mapping):
        found.append(problems.not_an_object(row, record))
        return False
    if isinstance(record, RepeatingObject):
        found.append(problems.repeated_field(row, record.repeated))
    return True


def _read_instr_id(row: int, record: Mapping[str, Any], found: list[Problem]) -> str | None:
    value = _field(row, record, "instr_id", found)
    if isinstance(value, str):
        return value
    if value is not _MISSING:
        found.append(problems.wrong_instr_id(row, value))
    return None


def _read_trajectory(
    row: int, record: Mapping[str, Any], found: list[Problem]
) -> Sequence[str | None]:
    value = _field(row, record, "trajectory", found)
    if value is _MISSING:
        return ()
    if not isinstance(value, list | tuple):
        found.append(problems.wrong_trajectory(row, value))
        return ()
    if not value:
        found.append(problems.empty_trajectory(row))
    return [_read_viewpoint(row, number, pose, found) for number, pose in enumerate(value)]


def _read_viewpoint(row: int, number: int, pose: Any, found: list[Problem]) -> str | None:
    """Take the viewpoint out of a pose; heading and elevation may be left out."""
    if not isinstance(pose, list | tuple) or not pose or not isinstance(pose[0], str):
        found.append(problems.wrong_pose(row, number, pose))
        return None
    viewpoint_id, *angles = pose
    if not all(map(_is_number, angles)):
        found.append(problems.wrong_pose(row, number, pose))
        return None
    if not all(map(_is_finite, angles)):
        found.append(problems.not_finite(row, number, pose))
    return str(viewpoint_id)


def _read_answer(row: int, record: Mapping[str, Any], found: list[Problem]) -> int:
    value = _field(row, record, "predObjId", found)
    if value is None or value is _MISSING:
        return ABSTAINED
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    if is_whole and ABSTAINED <= value <= LARGEST_OBJECT_ID:
        return int(value)
    found.append(problems.wrong_object(row, value))
    return ABSTAINED


def _field(row: int, record: Mapping[str, Any], field: str, found: list[Problem]) -> Any:
    value = record.get(field, _MISSING)
    if value is _MISSING:
        found.append(problems.missing_field(row, field))
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _is_finite(angle: float) -> bool:
    try:
        return math.isfinite(angle)
    except OverflowError:  # a whole number beyond the range of floats
        return False
