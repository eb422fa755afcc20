"""Views of rooms: what a room looks like in a view, as flat faces from the farthest to the nearest.

Solids of objects that are seen from the viewpoint are fitted to their boxes; the others of the room
are where its other viewpoints see them, if they are far enough to have no box here. The walls are
those of the viewpoint's room.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.geometry._buildings import Building, floors_of
from reverie_eval.geometry._kinds import Form, kind_of
from reverie_eval.geometry._shells import CEILING, NEAREST, Camera, Face, Shell
from reverie_eval.geometry._solid_faces import solid_faces
from reverie_eval.geometry._solids import CAMERA_HEIGHT, SIDES, Solids
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
# Metres above the floor of what casts a shadow there, and how much wider its shadows are.
_STANDS, _SHADOWS = 0.1, {"shadow": 0.3, "shadow near": 0.08}
# Metres between what lies on something, and its top.
_ON = 0.35
# Pixels by which what stands on something may seem to be above it, and how much of that seems to be
# below at least.
_ABOVE_CARRIER, _OF_CARRIER = 10.0, 0.15
# What is below an object that hangs on a wall, by its form.
_FEET: Mapping[Form, str] = MappingProxyType({"sink": "pedestal", "counter": "cabinet"})
# What those look like that hang on a wall though they mostly stand, by the last word of their
# names, and what never hangs there.
_ON_WALLS: Mapping[str, str] = MappingProxyType(
    {"lamp": "wall lamp", "decoration": "wall decoration"}
)
_NEVER_HUNG = ("cushion", "bag", "books", "bottle", "bowl")
# How many times as far away as an object without a box its wall is at most.
_FARTHEST_HUNG = 1.6
# Metres from what hangs highest to the ceiling, and from a camera to the highest ceiling.
_OVER, _HIGHEST = 0.12, 5.0
# Pixels from a box to the edge of a view that cuts it, at most; forms that reach down to the floor
# then, though they may also hang.
_CUT = 2.0
_REACHING = ("cabinet", "shelves")
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
        room, storey = int(building.room[row]), int(building.storey[row])
        solids = self._solids = building.solids
        # What is known of other viewpoints' floors is moved to the floor of this one.
        self._lift = self._camera.floor - floors_of(position[:, 2], building.storey)[storey]
        is_known = np.isin(seen.object_id, solids.object_id)  # two objects make no building
        seen = self._seen = Seen(*(column[is_known] for column in seen))
        rows = np.searchsorted(solids.object_id, seen.object_id)
        boxes = self._camera.position, seen.view, seen.xywh
        self._is_cut = self._cut(solids.take(rows))
        known = self._stood(solids.take(rows).fitted(*boxes))
        is_unseen = (solids.room == room) & (room >= 0)
        is_unseen[rows] = False
        is_unseen &= np.linalg.norm(solids.centre - self._camera.position, axis=1) > _LISTED
        unseen = self._grounded(solids.take(is_unseen))
        within = np.vstack([known.ground(), unseen.ground()])
        self._shell = Shell(building, storey, room, self._camera, within)
        known = self._hung(self._stood(self._hung(known).fitted(*boxes)))
        unseen = self._hung_as_it_is(unseen)
        self._unseen = unseen.take(self._is_carried(unseen, known))
        known = self._supported(known).fitted(*boxes)
        self._camera = self._camera._replace(rise=self._rise(known))
        known = self._reaching(self._stood(known))
        self.fitted = known.trimmed(self._camera.floor, self._camera.ceiling).narrowed()
        """The solids of the objects that are seen, in their order."""
        hung = [each.take(each.supports == "wall").centre[:, :2] for each in self._groups]
        self._shell.finish(self._camera, np.vstack(hung))

    def faces(self) -> Sequence[Face]:
        """Return what the picture shows, the farthest first, and important objects after all."""
        shell = self._shell
        drawn = shell.nowhere(), self._beyond(), shell.faces(), self._shadows(), self._objects()
        return [face for each in drawn for face in each if face.outlines]

    def _beyond(self) -> Iterator[Face]:
        """Yield the other rooms that are seen through doors, and what stands there."""
        for room, by, shell in self._shell.beyond():
            yield from shell
            there = self._grounded(self._solids.take(self._solids.room == room))
            there = there.take(there.supports != "anywhere")
            there = replace(there, centre=there.centre + np.append(by, 0.0))
            away = np.linalg.norm(there.centre - self._camera.position, axis=1)
            drawn = sorted(solid_faces(there, self._camera), key=lambda each: -away[each[0]])
            for _, faces in drawn:
                if self._shell.is_seen([face.outlines[0] for face in faces]):
                    yield from faces

    def _grounded(self, solids: Solids) -> Solids:
        """Move what has no box here to the floor and the ceiling of the picture, if it is near."""
        centre, high = solids.centre.copy(), solids.half[:, 2]
        centre[:, 2] += self._lift
        stands, hangs = solids.supports == "floor", solids.supports == "ceiling"
        floor, ceiling = self._camera.floor + high, self._camera.ceiling - high
        centre[:, 2] = np.where(stands, floor, np.where(hangs, ceiling, centre[:, 2]))
        moved = replace(solids, centre=centre)
        return moved.trimmed(self._camera.floor, self._camera.ceiling).narrowed()

    def _hung_as_it_is(self, solids: Solids) -> Solids:
        """Move what has no box here, and hangs on walls, to those behind it, as large as it is.

        What is not within the walls is left out, and what hangs far from them.
        """
        hung, (share, _) = self._hung(solids), self._shell.behind(solids.centre[:, :2])
        centre = hung.centre.copy()
        centre[:, 2] = solids.centre[:, 2]
        hung = replace(hung, centre=centre, half=solids.turned(hung.back).half)
        return hung.take((share > 1) & ((solids.supports != "wall") | (share < _FARTHEST_HUNG)))

    def _stood(self, solids: Solids) -> Solids:
        """Move solids to the floor or the ceiling, if they belong there; none is beyond them.

        Whatever its distance, a solid looks the same if its size goes with it.
        """
        camera = self._camera
        up, high = solids.centre[:, 2] - camera.position[2], solids.half[:, 2]
        to_floor = CAMERA_HEIGHT / np.maximum(high - up, NEAREST)
        to_ceiling = camera.rise / np.maximum(high + up, NEAREST)
        stands, hangs = solids.supports == "floor", (solids.supports == "ceiling") & (up > 0)
        share = np.where(stands, to_floor, np.where(hangs, to_ceiling, 1.0))
        most = np.where(stands, to_floor, np.minimum(to_floor, to_ceiling))
        share = np.minimum(np.clip(share, _NEARER, _FARTHER), most)
        share = np.where(solids.supports == "wall", 1.0, share)
        return solids.moved(camera.position, np.where(self._is_cut, np.minimum(share, 1.0), share))

    def _reaching(self, solids: Solids) -> Solids:
        """Let what belongs on the floor reach it, if the lower edge of a view cuts its box."""
        centre, half = solids.centre.copy(), solids.half.copy()
        top = centre[:, 2] + half[:, 2]
        reaches = self._is_cut & (top > self._camera.floor)
        centre[:, 2] = np.where(reaches, (top + self._camera.floor) / 2, centre[:, 2])
        half[:, 2] = np.where(reaches, (top - self._camera.floor) / 2, half[:, 2])
        return replace(solids, centre=centre, half=half)

    def _cut(self, solids: Solids) -> BoolArray:
        """Whether each seen object stands on the floor, but its view shows no foot: shape (n,)."""
        foot = self._seen.xywh[:, 1].astype(np.float64) + self._seen.xywh[:, 3]
        reaches = np.isin([kind_of(name).form for name in solids.names], _REACHING)
        reaches &= self._seen.view < 2 * N_HEADINGS  # others show nothing below the horizon
        return np.asarray((foot >= HEIGHT - _CUT) & ((solids.supports == "floor") | reaches))

    def _hung(self, solids: Solids) -> Solids:
        """Move what hangs on walls to the wall behind it."""
        return self._on_walls(solids, solids.supports == "wall")

    def _on_walls(self, solids: Solids, hangs: BoolArray) -> Solids:
        share, back = self._shell.behind(solids.centre[:, :2])
        moved = solids.moved(self._camera.position, np.where(hangs, share, 1.0))
        return moved.turned(np.where(hangs, back, solids.back)).flattened()

    def _supported(self, solids: Solids) -> Solids:
        """Move what nothing carries to the floor or the wall that is behind it, what is nearer."""
        is_loose = (solids.supports == "anywhere") & ~self._carriers(solids).any(axis=1)
        is_loose &= ~self._is_cut
        below = self._camera.position[2] - solids.centre[:, 2] + solids.half[:, 2]
        to_floor = CAMERA_HEIGHT / np.maximum(below, NEAREST)
        to_wall, _ = self._shell.behind(solids.centre[:, :2])
        falls = is_loose & (to_floor <= to_wall)
        moved = solids.moved(self._camera.position, np.where(falls, to_floor, 1.0))
        hangs = is_loose & ~falls
        moved = self._on_walls(moved, hangs)
        self._feet = self._feet_of(moved.take(hangs))
        forms = [kind_of(name).form for name in moved.names]
        is_left_out = hangs & np.isin(forms, _NEVER_HUNG)
        self.left_out = {*moved.object_id[is_left_out].tolist()} - {*self._important}
        """The objects that are not drawn, because nothing carries them."""
        names = [
            _ON_WALLS.get(name.rpartition(" ")[2], name) if is_hung else name
            for name, is_hung in zip(moved.names, hangs.tolist(), strict=True)
        ]
        return replace(moved, names=names)

    def _feet_of(self, solids: Solids) -> Solids:
        """Return what is below those that hang on a wall but have something below: a sink."""
        names = [_FEET.get(kind_of(name).form, "") for name in solids.names]
        high = solids.centre[:, 2] - solids.half[:, 2] - self._camera.floor
        centre, half = solids.centre.copy(), solids.half.copy()
        centre[:, 2], half[:, 2] = self._camera.floor + high / 2, high / 2
        feet = replace(solids, names=names, centre=centre, half=half)
        return feet.take(np.array([bool(name) for name in names], dtype=bool) & (high > _STANDS))

    def _carriers(self, solids: Solids) -> BoolArray:
        """Whether each solid, shape (n, m), seems to stand on each of those that may carry it.

        These are the seen ones and then the others: its lower edge is in the middle of what they
        take up in the picture, or above.
        """
        rects = self._rectangles(solids)
        others = np.vstack([rects, self._rectangles(self._unseen)])
        supports = np.concatenate([solids.supports, self._unseen.supports])
        middle = rects[:, None, [0, 2]].mean(axis=2)
        foot, height = rects[:, None, 3], others[:, 3] - others[:, 1]
        area = (rects[:, 2:] - rects[:, :2]).prod(axis=1)
        other_area = (others[:, 2:] - others[:, :2]).prod(axis=1)
        return np.asarray(
            (others[:, 0] <= middle)
            & (middle <= others[:, 2])
            & (others[:, 1] - _ABOVE_CARRIER <= foot)
            & (foot <= others[:, 3] - _OF_CARRIER * height)
            & (area[:, None] < other_area)
            & np.isin(supports, ("floor", "anywhere"))
        )

    def _rise(self, solids: Solids) -> float:
        """Return the metres to a ceiling above all in the picture that does not hang from it."""
        left, _, right, _ = self._rectangles(solids).T
        is_shown = (right > self.picture.left) & (left < self.picture.left + self.picture.width)
        top = solids.centre[:, 2] + solids.half[:, 2] - self._camera.position[2]
        highest = top[is_shown & (solids.supports != "ceiling")].max(initial=0.0) + _OVER
        return float(np.clip(highest, CEILING, _HIGHEST))

    def _rectangles(self, solids: Solids) -> FloatArray:
        """Return what solids take up in the picture: left, top, right, bottom; nan if behind."""
        corners = solids.corners()
        seen = world_to_camera(corners, self._camera.position, self._camera.axes)
        seen[seen[..., 2].min(axis=1) < NEAREST] = np.nan
        pixels = pixels_of(seen)
        return np.hstack([pixels.min(axis=1), pixels.max(axis=1)])

    def _is_carried(self, solids: Solids, known: Solids) -> BoolArray:
        """Whether what has no box here need not hang in the air: shape (n,)."""
        bottom = solids.centre[:, 2] - solids.half[:, 2]
        found = (solids.supports != "anywhere") | (bottom < self._camera.floor + _STANDS)
        for carriers in (solids, known):
            off = np.abs((solids.centre[:, None, :2] - carriers.centre[:, :2]) @ solids.axes.T)
            is_above = (off < carriers.half[:, :2] + _STANDS).all(axis=2)
            top = carriers.centre[:, 2] + carriers.half[:, 2]
            is_above &= np.abs(bottom[:, None] - top) < _ON
            found |= (is_above & (carriers.supports == "floor")).any(axis=1)
        return np.asarray(found, dtype=np.bool_)

    def _shadows(self) -> Iterator[Face]:
        """Yield the shadows of solids that stand on the floor, two each: their edges are soft."""
        floor = self._camera.floor
        for solids in self._groups:
            corners = solids.corners()
            stands = (corners[:, 0, 2] < floor + _STANDS) & (solids.supports != "wall")
            flat = corners[stands][:, SIDES[4], :2]
            off = flat - flat.mean(axis=1, keepdims=True)
            for kind, wider in _SHADOWS.items():
                for each in flat + wider * off:
                    yield from self._camera.flat(kind, [each], floor)

    def _objects(self) -> Iterator[Face]:
        """Yield the faces of solids, those of the same object next to each other."""
        here = self._camera.position
        away = [np.linalg.norm(its.centre - here, axis=1) for its in self._groups]
        away[1] = np.minimum(away[1], self._in_front_of(away[1], away[0]))
        away.append(np.linalg.norm(self._feet.centre - here, axis=1))
        rank = {object_id: index for index, object_id in enumerate(self._important, 1)}
        found = [
            (rank.get(int(its.object_id[row]), 0), -float(distance[row]), faces)
            for its, distance in zip((*self._groups, self._feet), away, strict=True)
            for row, faces in solid_faces(its, self._camera)
            if int(its.object_id[row]) not in self.left_out
        ]
        for *_, faces in sorted(found, key=lambda each: each[:2]):
            yield from faces

    @property
    def _groups(self) -> Sequence[Solids]:
        return self._unseen, self.fitted

    def _in_front_of(self, away: FloatArray, others: FloatArray) -> FloatArray:
        """Return just less than the distance of the nearest object that carries or contains one.

        It is inf where no object does. ``away`` has the distances of all centres, shape (n_seen,),
        as the result has, and ``others`` those of objects without boxes. An object contains another
        if its box contains the other's. By their centres alone, a table would hide the book that
        lies on it.
        """
        low = self._seen.xywh[:, :2].astype(np.float64)
        size = self._seen.xywh[:, 2:].astype(np.float64)
        first, last = np.maximum(low[:, None], low), np.minimum((low + size)[:, None], low + size)
        shared, area = np.maximum(last - first, 0).prod(axis=2), size.prod(axis=1)
        is_same_view = self._seen.view[:, None] == self._seen.view
        is_within = is_same_view & (shared >= _WITHIN * area[:, None]) & (area[:, None] < area)
        nearest = np.where(is_within, away, np.inf).min(axis=1, initial=np.inf)
        carriers = self._carriers(self.fitted) & (self.fitted.supports == "anywhere")[:, None]
        carrier = np.where(carriers, np.concatenate([away, others]), np.inf)
        nearest = np.minimum(nearest, carrier.min(axis=1, initial=np.inf))
        return np.asarray(np.nextafter(nearest, 0))


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
