"""Results of items: records with several trajectories, each with the point that the agent predicts.

SOON's official form of a record is ``{"instr_id": 12, "trajectory": [{"path": [...], "obj_heading":
x, "obj_elevation": y}, ...]}``, with a trajectory for each start of the item in the order of the
annotations. They are read as records of their own, whose ids are ``12#0``, ``12#1`` and so on.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from reverie_eval.errors import SubmissionError
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._document import is_finite, is_list, is_number
from reverie_eval.submissions._fields import INSTR_ID_KEY, POINT_KEYS, TRAJECTORY_KEY
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.submissions._reading_log import ReadingLog

Point: TypeAlias = tuple[float, float]
"""Heading and elevation in turns; NaN for none."""
NO_POINT: Point = (np.nan, np.nan)

_PATH_KEY = "path"
_SEPARATOR = "#"
_DUETS_ID = re.compile(r"\d+-\d+_\d+")
"""The id of an episode of DUET's own files of SOON."""


def is_item(record: Mapping[str, Any]) -> bool:
    """Whether a record's trajectory is an object or a list of objects."""
    given = record.get(TRAJECTORY_KEY)
    trajectories = given if is_list(given) else [given]
    # An object without a path is a pose, which REVERIE's files may have in error.
    return any(isinstance(each, Mapping) and _PATH_KEY in each for each in trajectories)


def split_items(
    records: Iterable[tuple[RecordLocation, Mapping[str, Any]]], log: ReadingLog
) -> Iterator[tuple[RecordLocation, Mapping[str, Any]]]:
    """Yield a record for each trajectory of an item; other records as they are."""
    count: Counter[object] = Counter()
    for location, record in records:
        if not is_item(record):
            yield location, record
            continue
        given = record.get(INSTR_ID_KEY, location.key)
        if isinstance(given, str) and _DUETS_ID.fullmatch(given):  # does not identify the item
            raise SubmissionError([problems.duets_episodes(location, given)])
        trajectories = record[TRAJECTORY_KEY]
        if isinstance(trajectories, Mapping):
            log.differences["single trajectories"] += 1
            trajectories = [trajectories]
        for place, trajectory in enumerate(trajectories):
            instr_id = given
            if isinstance(given, str):
                instr_id = f"{given}{_SEPARATOR}{count[given]}"
                count[given] += 1
            others = {key: value for key, value in record.items() if key != TRAJECTORY_KEY}
            fields = {**others, INSTR_ID_KEY: instr_id, **_flat(trajectory)}
            yield location._replace(place=place), fields


def _flat(trajectory: object) -> Mapping[str, Any]:
    if not isinstance(trajectory, Mapping):
        return {TRAJECTORY_KEY: trajectory}
    return {TRAJECTORY_KEY if key == _PATH_KEY else key: it for key, it in trajectory.items()}


def join_items(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return records of single trajectories as those of their items, in the official form.

    >>> join_items([{"instr_id": "7#0", "trajectory": [], "obj_heading": 0.5}])
    [{'instr_id': 7, 'trajectory': [{'path': [], 'obj_heading': 0.5}]}]
    """
    items: dict[str, list[Mapping[str, Any]]] = {}
    for record in records:
        item, _, _ = record[INSTR_ID_KEY].partition(_SEPARATOR)
        rest = {key: value for key, value in record.items() if key in POINT_KEYS}
        items.setdefault(item, []).append({_PATH_KEY: record[TRAJECTORY_KEY], **rest})
    return [
        {INSTR_ID_KEY: int(item) if item.isdecimal() else item, TRAJECTORY_KEY: trajectories}
        for item, trajectories in items.items()
    ]


def read_point(location: RecordLocation, record: Mapping[str, Any], log: ReadingLog) -> Point:
    """Read a trajectory's point; an unreadable one is reported and becomes none."""
    values: list[float | None] = []
    for key in POINT_KEYS:
        if key not in record:
            log.problems.append(problems.missing_field(location, key))
            return NO_POINT
        value = record[key]
        if is_list(value) and len(value) == 1:
            log.differences["listed angles"] += 1
            (value,) = value
        if value is not None and not (is_number(value) and is_finite(value)):
            log.problems.append(problems.wrong_type(location, value, problems.POINT_FORM, key))
            return NO_POINT
        values.append(value)
    heading, elevation = values
    if heading is not None and elevation is not None:
        return float(heading), float(elevation)
    if heading is elevation is None:
        log.differences["no point"] += 1
    else:
        log.problems.append(problems.half_a_point(location, POINT_KEYS))
    return NO_POINT


def official_point(point: Point) -> Mapping[str, float | None]:
    """Return the fields of a point in the official form; null for none."""
    values = [None if np.isnan(value) else value for value in point]
    return dict(zip(POINT_KEYS, values, strict=True))
