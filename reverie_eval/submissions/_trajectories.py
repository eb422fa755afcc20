"""Read a trajectory in any form that public codebases write.

The structure of an element tells what it is, so nothing is guessed: a viewpoint id followed by
numbers is a pose, a list of viewpoint ids is a hop that is walked from first to last, and a text is
a viewpoint id.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._document import is_finite, is_integer, is_list, is_number
from reverie_eval.submissions._problems import PosePath, RecordLocation
from reverie_eval.submissions._reading_log import ReadingLog

MAX_POSES = 20_000
"""Per trajectory. Published agents take about 15 steps, each with turns between 36 views."""
_POSE_LENGTH = 3
_NUMBER = re.compile(r"-?\d{1,3}(\.\d{1,20})?(e-?\d{1,2})?")
"""An angle. Viewpoint ids are 32 hexadecimal digits."""
_VIEWPOINT_KEYS = ("viewpoint", "viewpointId", "viewpoint_id", "viewpointid", "vp", "vp_id")
_ANGLE_KEYS = ("heading", "elevation")


class Pose(NamedTuple):
    """One pose of a trajectory; None where the file gives no value."""

    path: PosePath
    viewpoint_id: str | None
    heading: float | None = None
    elevation: float | None = None
    continues_hop: bool = False
    """Whether evaluators that read only the first viewpoint of each hop miss it."""
    is_reported: bool = False
    """Whether a problem was reported already that explains why a value is missing."""


def read_trajectory(
    location: RecordLocation, record: Mapping[str, Any], log: ReadingLog
) -> list[Pose]:
    """Read a record's trajectory; an unreadable pose is reported and has no viewpoint."""
    if "trajectory" not in record:
        log.problems.append(problems.missing_field(location, "trajectory"))
        return []
    trajectory = record["trajectory"]
    if not is_list(trajectory):
        log.problems.append(
            problems.wrong_type(location, trajectory, problems.TRAJECTORY_FORM, "trajectory")
        )
        return []
    if len(trajectory) > MAX_POSES:
        log.problems.append(problems.too_many_poses(location, len(trajectory), MAX_POSES))
        return []
    if all(_is_empty(element) for element in trajectory):
        log.problems.append(problems.empty_trajectory(location))
        return []
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
    if _has_angles_as_text(element):
        log.add_fault(problems.ANGLES_AS_TEXT, location, f".trajectory[{index}]", element)
        element = [element[0], *map(float, element[1:])]
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
            log.add_fault(problems.POSES_AS_OBJECTS, location, f".trajectory[{index}]", element)
            element = pose
    viewpoint_id, *angles = element if is_list(element) else (element,)
    if is_integer(viewpoint_id):
        log.add_fault(problems.NUMBERED_VIEWPOINTS, location, f".trajectory[{index}]", element)
        return [Pose((index,), None, is_reported=True)]
    if not isinstance(viewpoint_id, str) or len(angles) == 1 or not all(map(is_number, angles)):
        log.problems.append(problems.wrong_pose(location, (index,), element))
        return [Pose((index,), None, is_reported=True)]
    if not all(map(is_finite, angles)):
        log.problems.append(problems.not_finite(location, (index,), element))
        return [Pose((index, 0), viewpoint_id, is_reported=True)]
    log.differences["no angles"] += not angles
    log.differences["extra numbers"] += len(angles) > 2
    return [Pose((index, 0), viewpoint_id, *angles[:2])]


def _has_angles_as_text(element: Any) -> bool:
    """Whether this is ``["viewpoint", "1.5", "0.0"]``, which looks like a hop."""
    if not (is_list(element) and len(element) == _POSE_LENGTH and _is_hop(element)):
        return False
    return all(_NUMBER.fullmatch(part) for part in element[1:])


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
