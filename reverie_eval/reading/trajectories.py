"""Read a trajectory, in any form that public codebases write.

What an element is, its structure tells, never a guess: a viewpoint id with numbers behind it is a
pose; a list of viewpoint ids is a hop, walked from first to last; a text is a viewpoint id.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from reverie_eval.reading import problems
from reverie_eval.reading.findings import Findings, Place, PosePath
from reverie_eval.reading.values import is_finite, is_list, is_number

MAX_POSES = 20_000
"""Of a trajectory. Published agents take some 15 steps, each with a turn to one of 36 views."""


class Pose(NamedTuple):
    """One step of a trajectory; what the file does not say is None."""

    path: PosePath
    viewpoint_id: str | None
    heading: float | None = None
    elevation: float | None = None
    continues_hop: bool = False
    """Whether a reader of each hop's first viewpoint alone would miss it."""
    is_reported: bool = False
    """Whether a problem says already why viewpoint or angles are not known."""


def read_trajectory(place: Place, record: Mapping[str, Any], found: Findings) -> list[Pose]:
    """Read a record's trajectory; what cannot be read is a problem and a pose without viewpoint."""
    if "trajectory" not in record:
        found.problems.append(problems.missing_field(place, "trajectory"))
        return []
    trajectory = record["trajectory"]
    if not is_list(trajectory):
        found.problems.append(problems.wrong_trajectory(place, trajectory))
        return []
    if len(trajectory) > MAX_POSES:
        found.problems.append(problems.too_many_poses(place, len(trajectory), MAX_POSES))
        return []
    if not any(not is_list(element) or element for element in trajectory):
        found.problems.append(problems.empty_trajectory(place))
        return []
    only_hops = all(_is_hop(element) for element in trajectory)
    poses = []
    for number, element in enumerate(trajectory):
        if not (only_hops and not element):
            poses += _read_element(place, number, element, found)
    if only_hops and any(len(element) != 1 for element in trajectory):
        found.differences["hops"] += 1
    return poses


def _read_element(place: Place, number: int, element: Any, found: Findings) -> list[Pose]:
    if isinstance(element, str):
        found.differences["bare viewpoints"] += 1
        return [Pose((number,), element)]
    if _is_hop(element) and element:
        return _read_hop(number, element, found)
    if not _is_pose(element):
        found.problems.append(problems.wrong_pose(place, (number,), element))
        return [Pose((number,), None, is_reported=True)]
    viewpoint_id, *angles = element
    if not all(map(is_finite, angles)):
        found.problems.append(problems.not_finite(place, (number,), element))
        return [Pose((number, 0), viewpoint_id, is_reported=True)]
    found.differences["no angles"] += not angles
    found.differences["further numbers"] += len(angles) > 2
    return [Pose((number, 0), viewpoint_id, *angles[:2])]


def _read_hop(number: int, hop: Sequence[str], found: Findings) -> list[Pose]:
    found.differences["long hops"] += len(hop) > 1
    found.differences["no angles"] += len(hop)
    return [
        Pose((number, step), viewpoint_id, continues_hop=step > 0)
        for step, viewpoint_id in enumerate(hop)
    ]


def _is_hop(element: Any) -> bool:
    """Whether this is a list of viewpoint ids and nothing else."""
    return is_list(element) and all(isinstance(part, str) for part in element)


def _is_pose(element: Any) -> bool:
    """Whether this is a viewpoint id, alone or with heading and elevation behind it."""
    if not is_list(element) or not element:
        return False
    viewpoint_id, *angles = element
    is_whole = isinstance(viewpoint_id, str) and len(angles) != 1
    return is_whole and all(map(is_number, angles))
