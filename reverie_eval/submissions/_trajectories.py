"""Read a trajectory in any form that public codebases write.

The structure of an element tells what it is, so nothing is guessed: a viewpoint id followed by
numbers is a pose, a list of viewpoint ids is a hop that is walked from first to last, and a string
is a viewpoint id.

Records of items have several trajectories. SOON's official form is ``{"instr_id": 12, "trajectory":
[{"path": [...], "obj_heading": x, "obj_elevation": y}, ...]}``, with a trajectory for each start of
the item in the order of the annotations. They are read as records of their own, whose ids are
``12#0``, ``12#1`` and so on.
"""

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

from reverie_eval.errors import SubmissionError
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._faults import Fault, ReadingLog
from reverie_eval.submissions._fields import (
    INSTR_ID_KEY,
    POINT_KEYS,
    TRAJECTORY_KEY,
    is_finite,
    is_integer,
    is_list,
    is_number,
    is_number_as_text,
    means_trajectory,
    read_printed,
    unwrap,
)
from reverie_eval.submissions._problems import PoseLocation, RecordLocation
from reverie_eval.tasks import ITEM_MARK

MAX_POSES = 20_000
"""Per trajectory. Published agents take about 15 steps, each with turns between 36 views."""
_POSE_LENGTH = 3
_FEW_POSES = 100
_VIEWPOINT_KEYS = ("viewpoint", "viewpointId", "viewpoint_id", "viewpointid", "vp", "vp_id")
_ANGLE_KEYS = ("heading", "elevation")


class Pose(NamedTuple):
    """One pose of a trajectory; None where the file gives no value."""

    location: PoseLocation
    viewpoint_id: str | None
    heading: float | None = None
    elevation: float | None = None
    continues_hop: bool = False
    """Whether evaluators that read only the first viewpoint of each hop miss it."""
    is_reported: bool = False
    """Whether a problem was reported already that explains why a value is missing."""


class Trajectory(NamedTuple):
    """The poses of a trajectory by their fields, without an object for each pose."""

    locations: Sequence[PoseLocation] = ()
    viewpoint_ids: Sequence[str | None] = ()
    headings: Sequence[float | None] = ()
    elevations: Sequence[float | None] = ()
    continues_hop: Sequence[bool] = ()
    is_reported: Sequence[bool] = ()

    @property
    def stop(self) -> Pose | None:
        """The last pose; None if the trajectory could not be read."""
        columns: Sequence[Sequence[Any]] = self
        return Pose(*(column[-1] for column in columns)) if self.locations else None


def read_trajectory(
    location: RecordLocation, record: Mapping[str, Any], log: ReadingLog
) -> Trajectory:
    """Read a record's trajectory; an unreadable pose is reported and has no viewpoint."""
    if "trajectory" not in record:
        missing = "trajectory" if location.trajectory is None else "path"
        log.problems.append(problems.MISSING_FIELD.of_record(location, field=missing))
        return Trajectory()
    trajectory = _meant(location, record["trajectory"], log)
    if not is_list(trajectory):
        log.add_wrong_type(location, TRAJECTORY_KEY, trajectory, problems.TRAJECTORY_FORM)
        return Trajectory()
    if len(trajectory) > MAX_POSES:
        found = problems.TOO_MANY_POSES.of_record(location, found=len(trajectory), limit=MAX_POSES)
        log.problems.append(found)
        return Trajectory()
    if all(_is_empty(element) for element in trajectory):
        log.problems.append(problems.EMPTY_TRAJECTORY.of_record(location))
        return Trajectory()
    # Nearly all trajectories have one of two forms throughout, which are read by loops in C. The
    # last of these reads any form, and takes five times as long.
    return (
        _read_plain(trajectory)
        or _read_hops(trajectory, log)
        or Trajectory(*zip(*_read_elements(location, trajectory, log), strict=True))
    )


def _meant(location: RecordLocation, trajectory: Any, log: ReadingLog) -> Any:
    """Return the trajectory that was meant, where it is printed as text or in a list of its own."""
    meant, fault = _without_lists_of_one(trajectory, _are_poses)
    if fault is not None:
        log.add_fault(fault, location, ".trajectory", trajectory)
    return meant


def _meant_pose(location: RecordLocation, index: int, element: Any, log: ReadingLog) -> Any:
    """Return the pose or hop that was meant, where it or its parts are printed or in lists."""
    meant, fault = _without_lists_of_one(element, _is_filled_list)
    if is_list(meant):
        parts = [_meant_part(part) for part in meant]
        if meant and isinstance(meant[0], str):
            parts[0] = meant[0], None  # what is written around it, the graph tells
        meant, fault = (
            [part for part, _ in parts],
            fault or next((it for _, it in parts if it), None),
        )
    if _has_angles_as_text(meant):
        meant, fault = [meant[0], *map(float, meant[1:])], fault or faults.ANGLES_AS_TEXT
    if is_list(meant) and list(meant[1:]) == [None, None] and isinstance(meant[0], str):
        meant, fault = meant[:1], fault or faults.NULL_ANGLES
    if fault is None:
        return element
    log.add_fault(fault, location, f".trajectory[{index}]", element)
    return meant


def _meant_part(part: Any) -> tuple[Any, Fault | None]:
    """Return the viewpoint or the angle that was meant; a text as it is, if it is no number."""
    if is_number(part):
        return part, None
    meant, fault = unwrap(part)
    return (meant, fault) if is_list(part) or is_number(meant) else (part, None)


def _without_lists_of_one(value: Any, is_meant: Callable[[Any], bool]) -> tuple[Any, Fault | None]:
    """Return a list in lists of one, or printed as text, if what is inside is what was meant."""
    fault = None
    printed = read_printed(value) if isinstance(value, str) else None
    if is_list(printed) and _begins_with_viewpoint(printed):
        value, fault = printed, faults.PRINTED_VALUES
    while is_list(value) and len(value) == 1 and is_meant(value[0]):
        (value,), fault = value, fault or faults.LISTED_VALUES
    return value, fault


def _is_filled_list(value: Any) -> bool:
    return is_list(value) and bool(value)


def _are_poses(values: Any) -> bool:
    """Whether these are poses or hops, and not the parts of a pose in lists of one."""
    return _is_filled_list(values) and all(
        is_list(each) and _begins_with_viewpoint(each) for each in values
    )


def _begins_with_viewpoint(element: Any) -> bool:
    while is_list(element) and element:
        element = element[0]
    return isinstance(element, str) and not is_number_as_text(element)


def _read_plain(trajectory: Sequence[Any]) -> Trajectory | None:
    """Read poses that are all ``["viewpoint", heading, elevation]``; None if some are not."""
    if not have_types(trajectory, {list}) or set(map(len, trajectory)) != {_POSE_LENGTH}:
        return None
    viewpoints, headings, elevations = zip(*trajectory, strict=True)
    angles = (*headings, *elevations)
    if not (have_types(viewpoints, {str}) and have_types(angles, {float, int})):
        return None
    if not all(map(is_finite, angles)):
        return None
    locations, no = _locations_in((1,) * len(trajectory)), (False,) * len(trajectory)
    return Trajectory(locations, viewpoints, headings, elevations, no, no)


def _read_hops(trajectory: Sequence[Any], log: ReadingLog) -> Trajectory | None:
    """Read hops, lists of nothing but viewpoint ids; None if some elements are no hops."""
    if not have_types(trajectory, {list}):
        return None
    viewpoints = tuple(chain.from_iterable(trajectory))
    if not have_types(viewpoints, {str}):
        return None
    lengths = tuple(map(len, trajectory))
    if _POSE_LENGTH in lengths and any(map(_has_angles_as_text, trajectory)):
        return None
    log.differences["hops"] += lengths.count(1) < len(lengths)
    log.differences["empty hops"] += lengths.count(0)
    log.differences["long hops"] += sum(length > 1 for length in lengths)
    log.differences["no angles"] += sum(lengths)
    none, no = (None,) * len(viewpoints), (False,) * len(viewpoints)
    locations = _locations_in(lengths)
    return Trajectory(locations, viewpoints, none, none, [step > 0 for _, step in locations], no)


def _locations_in(lengths: tuple[int, ...]) -> Sequence[PoseLocation]:
    """Return the location of each viewpoint in a trajectory whose elements have these lengths."""
    # Nearly all trajectories are short and share their locations with others of their form. Long
    # ones would fill the memory.
    return _shared_locations(lengths) if sum(lengths) <= _FEW_POSES else _make_locations(lengths)


def _make_locations(lengths: tuple[int, ...]) -> Sequence[PoseLocation]:
    return [(index, step) for index, length in enumerate(lengths) for step in range(length)]


_shared_locations = lru_cache(maxsize=1024)(_make_locations)


def have_types(values: Iterable[object], types: AbstractSet[type]) -> bool:
    """Whether every value is of one of these types itself; subclasses do not count."""
    return set(map(type, values)) <= types


def _read_elements(
    location: RecordLocation, trajectory: Sequence[Any], log: ReadingLog
) -> list[Pose]:
    """Read a trajectory whose elements may have any form."""
    poses = []
    for index, element in enumerate(trajectory):
        if not _is_empty(element):
            poses += _read_element(location, index, element, log)
    is_nested = any(
        is_list(element) and len(element) != 1 and _is_hop(element) for element in trajectory
    )
    log.differences["hops"] += is_nested
    log.differences["empty hops"] += sum(_is_empty(element) for element in trajectory)
    return poses


def _read_element(
    location: RecordLocation, index: int, element: Any, log: ReadingLog
) -> list[Pose]:
    element = _meant_pose(location, index, element, log)
    if isinstance(element, str):
        log.differences["bare viewpoints"] += 1
        return [Pose((index,), element)]
    # A lone viewpoint id in a list is read as a hop of one, which means the same as a pose.
    if _is_hop(element) and element:
        log.differences["long hops"] += len(element) > 1
        log.differences["no angles"] += len(element)
        return [
            Pose((index, step), viewpoint_id, continues_hop=step > 0)
            for step, viewpoint_id in enumerate(element)
        ]
    if isinstance(element, Mapping):
        pose = _pose_from_object(element)
        if pose is not None:
            log.add_fault(faults.POSES_AS_OBJECTS, location, f".trajectory[{index}]", element)
            element = pose
    viewpoint_id, *angles = element if is_list(element) else (element,)
    if is_integer(viewpoint_id):
        log.add_fault(faults.NUMBERED_VIEWPOINTS, location, f".trajectory[{index}]", element)
        return [Pose((index,), None, is_reported=True)]
    if not isinstance(viewpoint_id, str) or len(angles) == 1 or not all(map(is_number, angles)):
        log.problems.append(problems.WRONG_POSE.of_pose(location, (index,), found=element))
        return [Pose((index,), None, is_reported=True)]
    if not all(map(is_finite, angles)):
        log.problems.append(problems.NOT_FINITE.of_pose(location, (index,), found=list(element)))
        return [Pose((index, 0), viewpoint_id, is_reported=True)]
    log.differences["no angles"] += not angles
    log.differences["extra numbers"] += len(angles) > 2
    return [Pose((index, 0), viewpoint_id, *angles[:2])]


def _has_angles_as_text(element: Any) -> bool:
    """Whether this is ``["viewpoint", "1.5", "0.0"]``, which looks like a hop."""
    if not (is_list(element) and len(element) == _POSE_LENGTH and _is_hop(element)):
        return False
    return all(map(is_number_as_text, element[1:]))


def _pose_from_object(element: Mapping[str, Any]) -> Sequence[Any] | None:
    """Return ``{"viewpoint": ..., "heading": ..., "elevation": ...}`` as a list."""
    viewpoints = [element[key] for key in _VIEWPOINT_KEYS if isinstance(element.get(key), str)]
    if len(viewpoints) != 1:
        return None
    angles = [element[key] for key in _ANGLE_KEYS if key in element]
    return [viewpoints[0], *angles]


def _is_empty(element: Any) -> bool:
    """Whether this is an empty hop, which is a step without a move."""
    return is_list(element) and not element


def _is_hop(element: Any) -> bool:
    """Whether this is a list of viewpoint ids and nothing else."""
    return is_list(element) and all(isinstance(part, str) for part in element)


PATH_KEY = "path"
_NO_OBJECTS = frozenset({list, tuple, str})
DUETS_ID = re.compile(r"(?:[A-Za-z]\w*_)?\d+-\d+_\d+")
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
        trajectories, fault = inner, faults.LISTED_VALUES
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
    fault = faults.ITEMS_FOR_PATHS if len(trajectories) == 1 else faults.SEVERAL_PATHS
    log.add_fault(fault, location, f".{TRAJECTORY_KEY}", given)
    rest = {name: value for name, value in first.items() if name != key}
    # What the record itself says, such as its answer, comes before what is in its trajectory.
    return {**rest, **record, TRAJECTORY_KEY: first[key]}


def split_items(
    records: Iterable[tuple[RecordLocation, Mapping[str, Any]]], log: ReadingLog
) -> Iterator[tuple[RecordLocation, Mapping[str, Any]]]:
    """Yield a record for each trajectory of an item; those with an id of their own as they are."""
    # Counted over the whole file, because an item's trajectories may be in several records.
    count: Counter[object] = Counter()
    for location, record in records:
        given = record.get(INSTR_ID_KEY, location.key)
        if isinstance(given, str) and DUETS_ID.fullmatch(given):  # does not identify the item
            raise SubmissionError([problems.DUETS_EPISODES.of_record(location, instr_id=given)])
        is_part = isinstance(given, str) and ITEM_MARK in given
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
        for index, trajectory in enumerate(trajectories):
            instr_id = given
            if isinstance(given, str):
                instr_id = f"{given}{ITEM_MARK}{count[given]}"
                count[given] += 1
            others = {key: value for key, value in item.items() if key != TRAJECTORY_KEY}
            own = location._replace(trajectory=index)
            fields = {**others, INSTR_ID_KEY: instr_id, **_flat(own, trajectory, log)}
            yield own, fields


def _as_item(
    location: RecordLocation, record: Mapping[str, Any], log: ReadingLog
) -> Mapping[str, Any]:
    """Return a record of one trajectory as an item's, which has them with their points."""
    moved = (TRAJECTORY_KEY, *POINT_KEYS)
    fault = faults.FLAT_ITEMS if all(key in record for key in moved) else faults.PATHS_FOR_ITEMS
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
        log.add_fault(faults.misspelt(path, PATH_KEY), location, "", path)
    return {TRAJECTORY_KEY if key == path else key: it for key, it in trajectory.items()}


def submission_text(records: Sequence[Mapping[str, Any]]) -> str:
    """Return a submission with a record per line, to read and to compare line by line."""
    # The json of the standard library writes floats as agents' own writers do.
    return "[\n" + ",\n".join(map(json.dumps, records)) + "\n]\n"


def join_items(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return records of single trajectories as those of their items, in the official form.

    >>> join_items([{"instr_id": "7#0", "trajectory": [], "obj_heading": 0.5}])
    [{'instr_id': 7, 'trajectory': [{'path': [], 'obj_heading': 0.5}]}]
    """
    items: dict[str, list[Mapping[str, Any]]] = {}
    for record in records:
        # SOON's own files have the ids of items as numbers.
        item, _, _ = record[INSTR_ID_KEY].partition(ITEM_MARK)
        rest = {key: value for key, value in record.items() if key in POINT_KEYS}
        items.setdefault(item, []).append({PATH_KEY: record[TRAJECTORY_KEY], **rest})
    return [
        {INSTR_ID_KEY: int(item) if item.isdecimal() else item, TRAJECTORY_KEY: trajectories}
        for item, trajectories in items.items()
    ]
