"""Faces of solids in a picture: the sides of boxes, and the outlines of what is round or soft."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.geometry._kinds import Material
from reverie_eval.geometry._shells import NEAREST, Camera, Face
from reverie_eval.geometry._solids import SIDES, Parts, Solids, sides_of
from reverie_eval.geometry._views import pixels_of, world_to_camera

# A side faces an axis if the cosine of the angle between them is larger.
_HALF = 0.5
# Points around a circle, and along each edge of a cushion.
_CIRCLE, _EDGE = 20, 4
# How far the edges of a cushion are bent inwards, as a part of its half.
_BENT = 0.08
# How many of the points around a circle, from its right end on, are in the shade.
_SHADED = 3
# Corners at the lower and at the upper end of a part, and those of its front.
_LOW, _HIGH, _FRONT = SIDES[4], SIDES[5], SIDES[2]
# A ball and the light on it: how far it is to the left and up, and how large, by its own half.
_BALL = (("dim", 0.0, 1.0), ("lit", 0.1, 0.84), ("top", 0.26, 0.48))
# The light on a cushion, as on a ball.
_CUSHION = (("lit", 0.0, 1.0), ("top", 0.12, 0.66))
# Colours of which a material may have another, for objects of another name or in another room.
_TINTS: Mapping[Material, Sequence[str]] = MappingProxyType(
    {"cloth": ("cloth", "cloth blue", "cloth green"), "wood": ("wood", "wood brown")}
)

_TURNS = np.linspace(0, 2 * np.pi, _CIRCLE, endpoint=False)
_CIRCLE_POINTS: FloatArray = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])


def _cushion_points() -> FloatArray:
    along = np.linspace(-1, 1, _EDGE, endpoint=False)
    bent = 1 - _BENT * (1 - along**2)
    return np.concatenate(
        [
            np.column_stack([along, -bent]),
            np.column_stack([bent, along]),
            np.column_stack([-along, bent]),
            np.column_stack([-bent, -along]),
        ]
    )


_CUSHION_POINTS = _cushion_points()


class _Projected(NamedTuple):
    """Parts in a picture."""

    parts: Parts
    pixels: FloatArray
    """Shape (n, 8, 2)."""
    quads: FloatArray
    """Shape (n, 6, 4, 3): the sides."""
    faces_camera: BoolArray
    """Shape (n, 6)."""
    shades: Sequence[Sequence[str]]
    """The light on each side of each part."""
    is_whole: BoolArray
    """Shape (n,): whether all of it is in front of the camera."""


def solid_faces(solids: Solids, camera: Camera) -> Iterator[tuple[int, list[Face]]]:
    """Yield the faces of each solid that is in the picture, with its row."""
    parts = solids.parts()
    corners = parts.corners
    if not len(corners):
        return
    seen = world_to_camera(corners, camera.position, camera.axes)
    depth = seen[..., 2]
    is_whole = depth.min(axis=1) >= NEAREST
    pixels = pixels_of(np.where(is_whole[:, None, None], seen, 1.0))
    in_view = (depth.max(axis=1) >= NEAREST) & ~(is_whole & camera.is_beside(pixels))
    quads, normal = sides_of(corners)
    faces_camera = ((camera.position - quads[:, :, 0]) * normal).sum(axis=2) > 0
    length = np.maximum(np.linalg.norm(normal, axis=2), 1e-12)
    up = normal[..., 2] / length
    along = np.abs((normal[..., :2] @ solids.axes[0]) / length)
    is_dim = (along > _HALF) | (up < -_HALF)
    shades = np.where(up > _HALF, "top", np.where(is_dim, "dim", "lit"))
    away = np.linalg.norm(corners.mean(axis=1) - camera.position, axis=1)
    away[parts.lies_on] = -np.flatnonzero(parts.lies_on)
    order = np.lexsort((-away, parts.of_solid))
    projected = _Projected(parts, pixels, quads, faces_camera, shades.tolist(), is_whole)
    rows = [row for row in order.tolist() if in_view[row]]
    for solid, its in groupby(rows, key=lambda row: int(parts.of_solid[row])):
        object_id = int(solids.object_id[solid])
        tint = int(solids.room[solid]) + sum(solids.names[solid].encode())
        faces = [
            Face(f"{_tinted(parts.parts[row].material, tint)} {shade}", [outline], object_id)
            for row in its
            for shade, outline in _outlines(projected, row, camera)
            if len(outline)
        ]
        if faces:
            yield solid, faces


def _tinted(material: Material, tint: int) -> str:
    tints = _TINTS.get(material, (material,))
    return tints[tint % len(tints)]


def _outlines(projected: _Projected, row: int, camera: Camera) -> Iterator[tuple[str, FloatArray]]:
    """Yield the light on each face of a part, and its outline."""
    part, pixels = projected.parts.parts[row], projected.pixels[row]
    shape = part.shape
    if shape == "box" or not projected.is_whole[row]:
        for side in np.flatnonzero(projected.faces_camera[row]).tolist():
            outline = pixels[SIDES[side]]
            if not projected.is_whole[row]:
                outline = camera.pixels(projected.quads[row, side])
            yield projected.shades[row][side], outline
    elif shape == "round":
        yield from _round(projected.parts.corners[row], part.profile, camera)
    elif shape == "disc":
        if projected.faces_camera[row, 2]:
            ring = _ring(projected.parts.corners[row, _FRONT])
            yield projected.shades[row][2], camera.pixels(ring)
    else:
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        middle, half = (low + high) / 2, (high - low) / 2
        points = _CIRCLE_POINTS if shape == "ball" else _CUSHION_POINTS
        for shade, off, size in _BALL if shape == "ball" else _CUSHION:
            yield shade, middle + half * (size * points - off)


def _round(
    corners: FloatArray, profile: Sequence[tuple[float, float]], camera: Camera
) -> Iterator[tuple[str, FloatArray]]:
    """Yield the faces of a round body: its side, what of that is in the shade, and its end."""
    low, high = corners[_LOW].mean(axis=0), corners[_HIGH].mean(axis=0)
    first, second = (corners[4] - corners[0]) / 2, (corners[2] - corners[0]) / 2
    to_camera = camera.position - low
    right = np.array([-to_camera[1], to_camera[0]]) / np.hypot(*to_camera[:2])
    turn = np.arctan2(second[:2] @ right, first[:2] @ right)
    # Half the width of the ellipse, as it is seen, and then what of it is towards the camera.
    aside = first * np.cos(turn) + second * np.sin(turn)
    forth = second * np.cos(turn) - first * np.sin(turn)
    forth *= 1.0 if forth @ to_camera > 0 else -1.0
    height, radius = np.array(profile).T
    middle = low + (height[:, None] + 1) / 2 * (high - low)
    around = _CIRCLE_POINTS @ np.stack([aside, forth])
    ring = middle[:, None] + radius[:, None, None] * around
    rings = pixels_of(world_to_camera(ring, camera.position, camera.axes))
    # Points 0 to _CIRCLE / 2 are on the camera's side, from right to left.
    for light, last in (("lit", _CIRCLE // 2), ("dim", _SHADED)):
        if high[2] > low[2]:
            ends = rings[-1, last:0:-1], rings[0, : last + 1]
            yield light, np.concatenate([rings[:, last], ends[0], rings[::-1, 0], ends[1]])
    if camera.position[2] > high[2]:
        yield "top", rings[-1]
    elif camera.position[2] < low[2]:
        yield "dim", rings[0]


def _ring(corners: FloatArray) -> FloatArray:
    """Return points around the ellipse in a side with corners of shape (4, 3)."""
    middle = corners.mean(axis=0)
    across, along = (corners[1] - corners[0]) / 2, (corners[3] - corners[0]) / 2
    return np.asarray(middle + _CIRCLE_POINTS @ np.stack([across, along]))
