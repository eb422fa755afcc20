"""The geometry of panoramas, written once more: corner by corner, in plain arithmetic.

It shares no line of code with what it judges. A picture is what four planes through the camera
cut out of all directions, so what two pictures have in common is found among directions, before
anything is projected: nothing behind a camera can be mirrored into its picture.
"""

import math
from collections.abc import Sequence
from fractions import Fraction

Number = float | Fraction
Box = tuple[Number, Number, Number, Number]
"""Left, top, width and height in pixels."""
Camera = tuple[float, float]
"""Heading and elevation in radians."""
Vector = tuple[float, float, float]

PICTURE: Box = (0, 0, 640, 480)
_FOCAL_LENGTH = 240 / math.tan(math.radians(30))
_ON_GRID = 0.001


def camera_of(view: int) -> Camera:
    """Return where a view looks."""
    return math.radians(30 * (view % 12)), math.radians(30 * (view // 12 - 1))


def view_of(camera: Camera) -> int:
    """Return the view that a camera's angles mean, which must not be halfway between two."""
    column = min(range(12), key=lambda number: _turn(camera[0], math.radians(30 * number)))
    row = 2 if camera[1] > math.pi / 12 else 0 if camera[1] < -math.pi / 12 else 1
    return 12 * row + column


def is_a_view(camera: Camera) -> bool:
    """Whether a camera looks where a view does, to a thousandth of a radian."""
    heading, elevation = camera_of(view_of(camera))
    return max(_turn(camera[0], heading), abs(camera[1] - elevation)) <= _ON_GRID


def overlap_over_union(first: Box, second: Box) -> Number:
    """Return the IoU of two boxes; exactly, if they are fractions."""
    shared = area(common(first, second))
    return shared / (area(first) + area(second) - shared)


def common(first: Box, second: Box) -> Box:
    """Return what two boxes share, without area if they share nothing."""
    (a, b, c, d), (e, f, g, h) = first, second
    left, top, right, bottom = max(a, e), max(b, f), min(a + c, e + g), min(b + d, f + h)
    return left, top, max(right - left, 0), max(bottom - top, 0)


def area(box: Box) -> Number:
    """Return width times height."""
    return box[2] * box[3]


def overlap_over_union_from(camera: Camera, drawn: Box, target: Box) -> float:
    """Return the IoU in a camera's view of what the camera drew and of a box in that view."""
    view = view_of(camera)
    shared = _area_in(target, _outline(drawn, camera, camera_of(view)))
    visible = _area_in(PICTURE, _outline(drawn, camera, camera_of(view)))
    return shared / (visible + float(area(target)) - shared)


def drawn_from(camera: Camera, view: int, target: Box) -> Box:
    """Return the box that a camera sees around a view's box: all of it must be before the camera.

    It is not cut to the picture.
    """
    across, down = zip(*map(_pixel, _outline(target, camera_of(view), camera)), strict=True)
    return min(across), min(down), max(across) - min(across), max(down) - min(down)


def _turn(first: float, second: float) -> float:
    """Radians between two headings, the shorter way round."""
    turn = abs(first - second) % math.tau
    return min(turn, math.tau - turn)


def _outline(box: Box, camera: Camera, other: Camera) -> Sequence[Vector]:
    """Return where another camera at the same place has a box's corners, around the box."""
    left, top, width, height = map(float, box)
    right, bottom = left + width, top + height
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    return [_seen_by(other, _looking_at(camera, *corner)) for corner in corners]


def _looking_at(camera: Camera, x: float, y: float) -> Vector:
    """Return the direction in the world that a pixel of a camera looks in."""
    right, up, forward = _axes(camera)
    across, upwards = (x - 320) / _FOCAL_LENGTH, (240 - y) / _FOCAL_LENGTH
    east, north, above = (
        forward[axis] + across * right[axis] + upwards * up[axis] for axis in range(3)
    )
    return east, north, above


def _seen_by(camera: Camera, direction: Vector) -> Vector:
    right, up, forward = (_dot(axis, direction) for axis in _axes(camera))
    return right, up, forward


def _axes(camera: Camera) -> tuple[Vector, Vector, Vector]:
    """Right, up and forward in the world."""
    (turn, rise), (sin, cos) = camera, (math.sin, math.cos)
    return (
        (cos(turn), -sin(turn), 0.0),
        (-sin(turn) * sin(rise), -cos(turn) * sin(rise), cos(rise)),
        (sin(turn) * cos(rise), cos(turn) * cos(rise), sin(rise)),
    )


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _pixel(ray: Vector) -> tuple[float, float]:
    right, up, forward = ray
    return 320 + _FOCAL_LENGTH * right / forward, 240 - _FOCAL_LENGTH * up / forward


def _area_in(window: Box, outline: Sequence[Vector]) -> float:
    """Return how many square pixels of an outline are seen through a part of the picture."""
    left, top, width, height = map(float, window)
    right, bottom = left + width, top + height
    for inwards in (
        (_FOCAL_LENGTH, 0.0, 320 - left),
        (-_FOCAL_LENGTH, 0.0, right - 320),
        (0.0, -_FOCAL_LENGTH, 240 - top),
        (0.0, _FOCAL_LENGTH, bottom - 240),
    ):
        outline = _cut(outline, inwards)
    corners = list(map(_pixel, outline))
    pairs = zip(corners, corners[1:] + corners[:1], strict=True)
    return abs(sum(a * d - b * c for (a, b), (c, d) in pairs)) / 2


def _cut(outline: Sequence[Vector], inwards: Vector) -> Sequence[Vector]:
    """Keep what lies on the inner side of a plane through the camera."""
    kept = []
    for here, there in zip(outline, [*outline[1:], *outline[:1]], strict=True):
        inside, beyond = _dot(here, inwards), _dot(there, inwards)
        if inside >= 0:
            kept.append(here)
        if (inside >= 0) != (beyond >= 0):
            part = inside / (inside - beyond)
            x, y, z = (a + part * (b - a) for a, b in zip(here, there, strict=True))
            kept.append((x, y, z))
    return kept
