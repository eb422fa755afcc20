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
from reverie_eval.submissions._fields import (
    INSTR_ID_KEY,
    POINT_KEYS,
    TRAJECTORY_KEY,
    means_trajectory,
)
from reverie_eval.submissions._problems import Fault, RecordLocation
from reverie_eval.submissions._reading_log import ReadingLog
from reverie_eval.submissions._values import unwrap_number

Point: TypeAlias = tuple[float, float]
"""Heading and elevation in turns; NaN for none."""
NO_POINT: Point = (np.nan, np.nan)

PATH_KEY = "path"
_SEPARATOR = "#"
_NO_OBJECTS = frozenset({list, tuple, str})
_DUETS_ID = re.compile(r"(?:[A-Za-z]\w*_)?\d+-\d+_\d+")
"""The id of an episode of DUET's own files of SOON; NaviLLM writes a prefix before it."""


def is_item(record: Mapping[str, Any]) -> bool:
    """Whether a record's trajectory is an object or a list of objects."""
    given, _ = _unnest(record.get(TRAJECTORY_KEY))
    trajectories = given if is_list(given) else [given]
    if set(map(type, trajectories)) <= _NO_OBJECTS:
        return False  # nearly always: types are compared by loops in C
    # An object without a path is a pose, which REVERIE's files may have in error.
    return any(isinstance(each, Mapping) and _path_key(each) for each in trajectories)


def _unnest(trajectories: Any) -> tuple[Any, Fault | None]:
    """Return the list of objects that is in lists of one, if it is."""
    given, fault = trajectories, None
    while is_list(trajectories) and len(trajectories) == 1 and is_list(trajectories[0]):
        (inner,) = trajectories
        if not (inner and isinstance(inner[0], Mapping | list | tuple)):
            break
        trajectories, fault = inner, problems.LISTED_VALUES
    is_meant = is_list(trajectories) and all(isinstance(each, Mapping) for each in trajectories)
    return (trajectories, fault) if is_meant else (given, None)


def has_point(record: Mapping[str, Any]) -> bool:
    """Whether one of an item's trajectories has a point, or it has several trajectories."""
    given, _ = _unnest(record[TRAJECTORY_KEY])
    trajectories = given if is_list(given) else [given]
    return len(trajectories) > 1 or any(key in each for key in POINT_KEYS for each in trajectories)


def take_path(
    location: RecordLocation, record: Mapping[str, Any], log: ReadingLog
) -> Mapping[str, Any]:
    """Return an item's record as that of one trajectory, for tasks that have no items."""
    given, _ = _unnest(record[TRAJECTORY_KEY])
    trajectories = given if is_list(given) else [given]
    first, key = next((each, key) for each in trajectories if (key := _path_key(each)) is not None)
    fault = problems.ITEMS_FOR_PATHS if len(trajectories) == 1 else problems.SEVERAL_PATHS
    log.add_fault(fault, location, f".{TRAJECTORY_KEY}", given)
    rest = {name: value for name, value in first.items() if name != key}
    return {**rest, **record, TRAJECTORY_KEY: first[key]}


def split_items(
    records: Iterable[tuple[RecordLocation, Mapping[str, Any]]], log: ReadingLog
) -> Iterator[tuple[RecordLocation, Mapping[str, Any]]]:
    """Yield a record for each trajectory of an item; those with an id of their own as they are."""
    count: Counter[object] = Counter()
    for location, record in records:
        given = record.get(INSTR_ID_KEY, location.key)
        if isinstance(given, str) and _DUETS_ID.fullmatch(given):  # does not identify the item
            raise SubmissionError([problems.duets_episodes(location, given)])
        is_part = isinstance(given, str) and _SEPARATOR in given
        if is_part and not is_item(record):
            yield location, record
            continue
        item = record if is_item(record) else _as_item(location, record, log)
        trajectories, fault = _unnest(item[TRAJECTORY_KEY])
        if fault is not None:
            log.add_fault(fault, location, f".{TRAJECTORY_KEY}", item[TRAJECTORY_KEY])
        if isinstance(trajectories, Mapping):
            log.differences["single trajectories"] += 1
            trajectories = [trajectories]
        for place, trajectory in enumerate(trajectories):
            instr_id = given
            if isinstance(given, str):
                instr_id = f"{given}{_SEPARATOR}{count[given]}"
                count[given] += 1
            others = {key: value for key, value in item.items() if key != TRAJECTORY_KEY}
            its_place = location._replace(place=place)
            fields = {**others, INSTR_ID_KEY: instr_id, **_flat(its_place, trajectory, log)}
            yield its_place, fields


def _as_item(
    location: RecordLocation, record: Mapping[str, Any], log: ReadingLog
) -> Mapping[str, Any]:
    """Return a record of one trajectory as an item's, which has them with their points."""
    moved = (TRAJECTORY_KEY, *POINT_KEYS)
    fault = problems.FLAT_ITEMS if all(key in record for key in moved) else problems.PATHS_FOR_ITEMS
    log.add_fault(fault, location, f".{TRAJECTORY_KEY}", record.get(TRAJECTORY_KEY))
    part = {PATH_KEY if key == TRAJECTORY_KEY else key: record.get(key) for key in moved}
    rest = {key: value for key, value in record.items() if key not in moved}
    return {**rest, TRAJECTORY_KEY: [part]}


def _path_key(trajectory: object) -> str | None:
    """Return the field with the path of one of an item's trajectories, if it is one."""
    if not isinstance(trajectory, Mapping):
        return None
    if PATH_KEY in trajectory:
        return PATH_KEY
    return next(
        (key for key in trajectory if means_trajectory(key) and is_list(trajectory[key])), None
    )


def _flat(location: RecordLocation, trajectory: object, log: ReadingLog) -> Mapping[str, Any]:
    if not isinstance(trajectory, Mapping):
        return {TRAJECTORY_KEY: trajectory}
    path = _path_key(trajectory)
    if path not in (PATH_KEY, None):
        log.add_fault(problems.misspelt(path, PATH_KEY), location, "", path)
    return {TRAJECTORY_KEY if key == path else key: it for key, it in trajectory.items()}


def join_items(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return records of single trajectories as those of their items, in the official form.

    >>> join_items([{"instr_id": "7#0", "trajectory": [], "obj_heading": 0.5}])
    [{'instr_id': 7, 'trajectory': [{'path': [], 'obj_heading': 0.5}]}]
    """
    items: dict[str, list[Mapping[str, Any]]] = {}
    for record in records:
        item, _, _ = record[INSTR_ID_KEY].partition(_SEPARATOR)
        rest = {key: value for key, value in record.items() if key in POINT_KEYS}
        items.setdefault(item, []).append({PATH_KEY: record[TRAJECTORY_KEY], **rest})
    return [
        {INSTR_ID_KEY: int(item) if item.isdecimal() else item, TRAJECTORY_KEY: trajectories}
        for item, trajectories in items.items()
    ]


def read_point(location: RecordLocation, record: Mapping[str, Any], log: ReadingLog) -> Point:
    """Read a trajectory's point; an unreadable one is reported and becomes none."""
    values: list[float | None] = []
    for key in POINT_KEYS:
        if key not in record:
            log.add_fault(problems.missing_in_all(key), location, "", None)
            return NO_POINT
        value = record[key]
        listed = value
        while is_list(value) and len(value) == 1:
            (value,) = value
        log.differences["listed angles"] += value is not listed
        meant, fault = (value, None) if value is None else unwrap_number(value)
        if meant is not None and not (is_number(meant) and is_finite(meant)):
            log.problems.append(problems.wrong_type(location, value, problems.POINT_FORM, key))
            return NO_POINT
        if fault is not None:
            log.add_fault(fault, location, f".{key}", value)
        values.append(meant)
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
