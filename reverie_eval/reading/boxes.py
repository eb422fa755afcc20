"""Read an answer that is a box: in which picture it was drawn, and where in it.

The picture is the view that ``predView`` names, or else what the camera of the last pose sees. A
box is scaled to a view's 640 x 480 pixels if the record gives the size of the picture that it was
drawn in, and then cut to the picture.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeGuard

import numpy as np

from reverie_eval.geometry import HEIGHT, N_VIEWS, WIDTH, view_angles
from reverie_eval.reading import problems
from reverie_eval.reading.findings import Findings, Place
from reverie_eval.reading.trajectories import Pose
from reverie_eval.reading.values import is_finite, is_list, is_number, is_whole

BOX_KEY = "predBox"
VIEW_KEY = "predView"
IMAGE_SIZE_KEY = "predImageSize"
BOX_KEYS = (BOX_KEY, VIEW_KEY, IMAGE_SIZE_KEY)

_STRAIGHT_UP = math.pi / 2
"""Radians."""
_SLACK = 1e-6
"""Pixels by which scaling alone may carry a box beyond the picture."""


class Camera(NamedTuple):
    """Where a picture was taken to, radians."""

    heading: float
    elevation: float


class BoxAnswer(NamedTuple):
    """A box and the camera in whose picture it was drawn."""

    xywh: tuple[float, float, float, float]
    """Pixels of a 640 x 480 picture, cut to it; without area if it lay wholly outside."""
    camera: Camera
    is_cut: bool
    """Whether the box reached beyond the picture."""


_CAMERAS = [Camera(*angles) for angles in view_angles(np.arange(N_VIEWS)).tolist()]


def read_box(
    place: Place, record: Mapping[str, Any], poses: Sequence[Pose] | None, found: Findings
) -> BoxAnswer | None:
    """Read a record's box; where it can not be read, a problem for each thing that is wrong.

    ``poses`` is the record's trajectory; None where trajectories are not looked at.
    """
    camera = _read_camera(place, record, poses, found)
    size = _read_image_size(place, record, found)
    edges = _read_edges(place, record[BOX_KEY], found)
    if camera is None or size is None or edges is None:
        return None
    across, down = WIDTH / size[0], HEIGHT / size[1]
    left, top, right, bottom = (
        edge * scale for edge, scale in zip(edges, (across, down, across, down), strict=True)
    )
    x, x_end = _within(left, WIDTH), _within(right, WIDTH)
    y, y_end = _within(top, HEIGHT), _within(bottom, HEIGHT)
    is_cut = max(x - left, right - x_end, y - top, bottom - y_end) > _SLACK
    is_outside = x_end <= x or y_end <= y
    found.differences["scaled boxes"] += size != (WIDTH, HEIGHT)
    found.differences["cut boxes"] += is_cut and not is_outside
    found.differences["boxes outside"] += is_outside
    return BoxAnswer((x, y, x_end - x, y_end - y), camera, is_cut)


def _read_camera(
    place: Place, record: Mapping[str, Any], poses: Sequence[Pose] | None, found: Findings
) -> Camera | None:
    view = record.get(VIEW_KEY)
    if view is not None:
        if is_whole(view) and 0 <= view < N_VIEWS:
            return _CAMERAS[int(view)]
        found.problems.append(problems.wrong_view(place, VIEW_KEY, view))
        return None
    stop = poses[-1] if poses else None
    if stop is not None and stop.heading is not None and stop.elevation is not None:
        if abs(stop.elevation) <= _STRAIGHT_UP:
            return Camera(float(stop.heading), float(stop.elevation))
        found.problems.append(problems.upside_down(place, stop.path[:1], stop.elevation, VIEW_KEY))
    elif poses is None or (stop is not None and not stop.is_reported):
        # A trajectory, or a pose, that cannot be read has been reported.
        found.problems.append(problems.no_view(place, VIEW_KEY, may_be_posed=poses is not None))
    return None


def _read_image_size(
    place: Place, record: Mapping[str, Any], found: Findings
) -> tuple[float, float] | None:
    """Return width and height of the picture that the box was drawn in."""
    size = record.get(IMAGE_SIZE_KEY)
    if size is None:
        return WIDTH, HEIGHT
    if _are_numbers(size, 2) and all(is_finite(side) and side >= 1 for side in size):
        return float(size[0]), float(size[1])
    found.problems.append(problems.wrong_image_size(place, IMAGE_SIZE_KEY, size))
    return None


def _read_edges(
    place: Place, box: Any, found: Findings
) -> tuple[float, float, float, float] | None:
    """Return left, top, right and bottom in the picture that the box was drawn in."""
    if not _are_numbers(box, 4):
        found.problems.append(problems.wrong_box(place, BOX_KEY, box))
        return None
    if not all(map(is_finite, box)):
        found.problems.append(problems.box_not_finite(place, BOX_KEY, box))
        return None
    x, y, width, height = map(float, box)
    if width <= 0 or height <= 0:
        found.problems.append(problems.empty_box(place, BOX_KEY, box))
        return None
    return x, y, x + width, y + height


def _are_numbers(value: Any, count: int) -> TypeGuard[Sequence[float]]:
    return is_list(value) and len(value) == count and all(map(is_number, value))


def _within(edge: float, size: int) -> float:
    return min(max(edge, 0.0), float(size))
