"""Read a trajectory in any form that public codebases write.

The structure of an element tells what it is, so nothing is guessed: a viewpoint id followed by
numbers is a pose, a list of viewpoint ids is a hop that is walked from first to last, and a text is
a viewpoint id.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._document import is_finite, is_list, is_number
from reverie_eval.submissions._problems import PosePath, RecordLocation
from reverie_eval.submissions._reading_log import ReadingLog

MAX_POSES = 20_000
"""Per trajectory. Published agents take about 15 steps, each with turns between 36 views."""


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
    if not any(not is_list(element) or element for element in trajectory):
        log.problems.append(problems.empty_trajectory(location))
        return []
    # An empty hop is a step without a move, but only among hops: among poses, `[]` is a fault.
    only_hops = all(_is_hop(element) for element in trajectory)
    poses = []
    for index, element in enumerate(trajectory):
        if not (only_hops and not element):
            poses += _read_element(location, index, element, log)
    if only_hops and any(len(element) != 1 for element in trajectory):
        log.differences["hops"] += 1
        log.differences["empty hops"] += sum(not element for element in trajectory)
    return poses


def _read_element(
    location: RecordLocation, index: int, element: Any, log: ReadingLog
) -> list[Pose]:
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
    viewpoint_id, *angles = element if is_list(element) and element else (None,)
    if not isinstance(viewpoint_id, str) or len(angles) == 1 or not all(map(is_number, angles)):
        log.problems.append(problems.wrong_pose(location, (index,), element))
        return [Pose((index,), None, is_reported=True)]
    if not all(map(is_finite, angles)):
        log.problems.append(problems.not_finite(location, (index,), element))
        return [Pose((index, 0), viewpoint_id, is_reported=True)]
    log.differences["no angles"] += not angles
    log.differences["extra numbers"] += len(angles) > 2
    return [Pose((index, 0), viewpoint_id, *angles[:2])]


def _is_hop(element: Any) -> bool:
    """Whether this is a list of viewpoint ids and nothing else."""
    return is_list(element) and all(isinstance(part, str) for part in element)
