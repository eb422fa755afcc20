"""Views of rooms: what a room looks like in a view, as flat faces from the farthest to the nearest.

Solids of objects that are seen from the viewpoint are fitted to their boxes; the others of the room
are where its other viewpoints see them, if they are far enough to have no box here. The walls are
those of the viewpoint's room.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray
from reverie_eval.geometry._buildings import Building
from reverie_eval.geometry._shells import CEILING, NEAREST, Camera, Face, Shell
from reverie_eval.geometry._solids import CAMERA_HEIGHT, SIDES, Solids, kind_of, sides_of
from reverie_eval.geometry._views import (
    HEIGHT,
    N_HEADINGS,
    VIEW_AXES,
    WIDTH,
    Picture,
    pixels_of,
    rays_of,
    world_to_camera,
)

# Pixels of a level view: half the width of a picture, and how much it shows above and below the
# horizon. It shows more than the view, 51 degrees to each side, 36 up and 48 down: from where most
# cameras stand, a view shows a piece of a wall, and neither floor nor ceiling.
_HALF_WIDTH, _ABOVE, _BELOW = 510.0, 300.0, 465.0
# For objects above or below that, it shows more: so much around their middles, and at most in all.
_AROUND, _MOST = 60.0, 800.0
# Released boxes are of what is visible within so many metres: what is nearer, and has none, is not.
_LISTED = 2.0
# How much nearer or farther than in the model an object may be, to stand on the floor.
_NEARER, _FARTHER = 0.4, 2.5
# Metres above the floor of what casts a shadow there, and how much wider the shadow is.
_STANDS, _SHADOW = 0.1, 0.15
# A side faces an axis if the cosine of the angle between them is larger.
_HALF = 0.5
# Points around a crown of leaves.
_CIRCLE = 14
# The part of a box that lies within another if its object lies in front.
_WITHIN = 0.8


class Seen(NamedTuple):
    """The objects that are seen from a viewpoint."""

    object_id: IntArray
    """Shape (n,)."""
    view: IntArray
    """Shape (n,): a view that shows it."""
    xywh: Array
    """Shape (n, 4): its box there."""


class RoomView:
    """A picture of a room and its objects."""

    def __init__(
        self,
        building: Building,
        position: FloatArray,
        row: int,
        view: int,
        seen: Seen,
        *,
        important: Sequence[int] = (),
    ) -> None:
        """Look from the viewpoint in a row of the positions of a building's viewpoints.

        The picture is level, and has the heading of the view. It shows the ``important`` objects if
        they are ahead, however high or low; nothing hides the last of them.
        """
        self.picture = _picture(view, seen, important)
        """The part of the plane of the level view that is drawn."""
        self._camera, self._important = Camera(position[row], self.picture), important
        room = int(building.room[row])
        solids = building.solids
        is_known = np.isin(seen.object_id, solids.object_id)  # two objects make no building
        seen = self._seen = Seen(*(column[is_known] for column in seen))
        rows = np.searchsorted(solids.object_id, seen.object_id)
        boxes = self._camera.position, seen.view, seen.xywh
        known = self._stood(solids.take(rows).fitted(*boxes))
        is_unseen = (solids.room == room) & (room >= 0)
        is_unseen[rows] = False
        is_unseen &= np.linalg.norm(solids.centre - self._camera.position, axis=1) > _LISTED
        unseen = self._stood(solids.take(is_unseen))
        storey, within = int(building.storey[row]), np.vstack([known.ground(), unseen.ground()])
        self._shell = Shell(building, storey, room, self._camera, within)
        self.fitted = self._hung(self._stood(self._hung(known).fitted(*boxes)))
        """The solids of the objects that are seen, in their order."""
        unseen = self._hung(unseen)
        to_wall, _ = self._shell.behind(unseen.centre[:, :2])
        self._unseen = unseen.take((to_wall > 1) | (unseen.supports == "wall"))

    def faces(self) -> Sequence[Face]:
        """Return what the picture shows, the farthest first, and important objects after all."""
        return [*self._shell.faces(), *self._shadows(), *self._objects()]

    def _stood(self, solids: Solids) -> Solids:
        """Move solids to the floor or the ceiling, if they belong there; none is beyond them.

        Whatever its distance, a solid looks the same if its size goes with it.
        """
        up, high = solids.centre[:, 2] - self._camera.position[2], solids.half[:, 2]
        to_floor = CAMERA_HEIGHT / np.maximum(high - up, NEAREST)
        to_ceiling = CEILING / np.maximum(high + up, NEAREST)
        stands, hangs = solids.supports == "floor", (solids.supports == "ceiling") & (up > 0)
        share = np.where(stands, to_floor, np.where(hangs, to_ceiling, 1.0))
        most = np.where(stands, to_floor, np.minimum(to_floor, to_ceiling))
        share = np.minimum(np.clip(share, _NEARER, _FARTHER), most)
        return solids.moved(self._camera.position, share)

    def _hung(self, solids: Solids) -> Solids:
        """Move what hangs on walls to the wall behind it."""
        hangs = solids.supports == "wall"
        share, back = self._shell.behind(solids.centre[:, :2])
        moved = solids.moved(self._camera.position, np.where(hangs, share, 1.0))
        return moved.turned(np.where(hangs, back, solids.back))

    def _shadows(self) -> Iterator[Face]:
        """Yield the shadows of solids that stand on the floor."""
        floor = self._camera.floor
        for solids in self._groups:
            corners = solids.corners()
            stands = (corners[:, 0, 2] < floor + _STANDS) & (solids.supports != "wall")
            flat = corners[stands][:, SIDES[4], :2]
            flat += _SHADOW * (flat - flat.mean(axis=1, keepdims=True))
            for each in flat:
                yield from self._camera.flat("shadow", [each], floor)

    def _objects(self) -> Iterator[Face]:
        """Yield the faces of solids, those of the same object next to each other."""
        here = self._camera.position
        away = [np.linalg.norm(its.centre - here, axis=1) for its in self._groups]
        away[1] = np.minimum(away[1], self._in_front_of(away[1]))
        rank = {object_id: index for index, object_id in enumerate(self._important, 1)}
        found = [
            (rank.get(int(its.object_id[row]), 0), -float(distance[row]), faces)
            for its, distance in zip(self._groups, away, strict=True)
            for row, faces in self._faces_of(its)
        ]
        for *_, faces in sorted(found, key=lambda each: each[:2]):
            yield from faces

    @property
    def _groups(self) -> Sequence[Solids]:
        return self._unseen, self.fitted

    def _in_front_of(self, away: FloatArray) -> FloatArray:
        """Return just less than the distance of the nearest object whose box contains an object's.

        ``away`` has the distances of all centres, shape (n_seen,), as the result; inf if no box
        contains it. By their centres alone, a table would hide the book that lies on it.
        """
        low = self._seen.xywh[:, :2].astype(np.float64)
        size = self._seen.xywh[:, 2:].astype(np.float64)
        first, last = np.maximum(low[:, None], low), np.minimum((low + size)[:, None], low + size)
        shared, area = np.maximum(last - first, 0).prod(axis=2), size.prod(axis=1)
        is_same_view = self._seen.view[:, None] == self._seen.view
        is_within = is_same_view & (shared >= _WITHIN * area[:, None]) & (area[:, None] < area)
        nearest = np.where(is_within, away, np.inf).min(axis=1, initial=np.inf)
        return np.asarray(np.nextafter(nearest, 0))

    def _faces_of(self, solids: Solids) -> Iterator[tuple[int, list[Face]]]:
        """Yield the faces of each solid that is in the view, with its row."""
        corners, of_solid, materials, lies_on = solids.parts()
        if not len(corners):
            return
        camera = self._camera
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
        shades = np.where(
            up > _HALF, "top", np.where((along > _HALF) | (up < -_HALF), "dim", "lit")
        )
        away = np.linalg.norm(corners.mean(axis=1) - camera.position, axis=1)
        away[lies_on] = -np.flatnonzero(lies_on)
        order = np.lexsort((-away, of_solid))
        rows = [row for row in order.tolist() if in_view[row]]
        for solid, parts in groupby(rows, key=lambda row: int(of_solid[row])):
            object_id = int(solids.object_id[solid])
            faces = []
            for part in parts:
                for side in np.flatnonzero(faces_camera[part]).tolist():
                    outline = (
                        pixels[part, SIDES[side]]
                        if is_whole[part]
                        else camera.pixels(quads[part, side])
                    )
                    if len(outline):
                        kind = f"{materials[part]} {shades[part, side]}"
                        faces.append(Face(kind, [outline], object_id))
            if kind_of(solids.names[solid]).form == "plant":
                faces += self._crown(solids, solid)
            if faces:
                yield solid, faces

    def _crown(self, solids: Solids, row: int) -> Iterator[Face]:
        """Yield the leaves of a plant: three balls."""
        object_id = int(solids.object_id[row])
        wide, _, high = solids.half[row]
        for x, z, shade in ((-0.4, -0.05, "dim"), (0.4, -0.05, "dim"), (0.0, 0.4, "top")):
            right = self._camera.axes[0]
            centre = solids.centre[row] + right * x * wide + np.array([0, 0, z * high])
            seen = world_to_camera(centre, self._camera.position, self._camera.axes)
            if seen[2] < NEAREST:
                continue
            turns = np.linspace(0, 2 * np.pi, _CIRCLE, endpoint=False)
            radius = np.column_stack([0.6 * wide * np.cos(turns), 0.6 * high * np.sin(turns)])
            ring = seen + np.column_stack([radius, np.zeros(_CIRCLE)])
            yield Face(f"leaf {shade}", [pixels_of(ring)], object_id)


def _picture(view: int, seen: Seen, important: Sequence[int]) -> Picture:
    """Return what to show around the level view with the heading of a view."""
    level = N_HEADINGS + view % N_HEADINGS
    above, below = _ABOVE, _BELOW
    for row in np.flatnonzero(np.isin(seen.object_id, important)).tolist():
        left, top, width, height = seen.xywh[row].astype(np.float64)
        corners = np.array([(left + x, top + y) for x in (0, width) for y in (0, height)])
        rays = rays_of(corners) @ VIEW_AXES[seen.view[row]] @ VIEW_AXES[level].T
        if rays[:, 2].min() < NEAREST:
            continue
        off = pixels_of(rays) - (WIDTH / 2, HEIGHT / 2)
        (first, high), (last, low) = off.min(axis=0), off.max(axis=0)
        if first < _HALF_WIDTH and last > -_HALF_WIDTH:
            middle, around = (high + low) / 2, min((low - high) / 2, _AROUND)
            above = max(above, min(around - middle, _MOST))
            below = max(below, min(around + middle, _MOST))
    half_width = _HALF_WIDTH * (above + below) / (_ABOVE + _BELOW)
    return Picture(level, WIDTH / 2 - half_width, HEIGHT / 2 - above, 2 * half_width, above + below)
