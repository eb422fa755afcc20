"""Solids: what the objects of a building look like, from their names and the boxes around them.

A box says how wide and high an object looks from a viewpoint. How deep it is, and what it is made
of, is told by the last word of its name; a name that is not in the table is that of a block. Solids
stand upright, with their sides along the walls of the building.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.geometry._views import FOCAL_LENGTH, VIEW_AXES, pixels_of, rays_of

Form = Literal[
    "block",
    "board",
    "window",
    "picture",
    "curtain",
    "table",
    "chair",
    "couch",
    "toilet",
    "bed",
    "basin",
    "cabinet",
    "drawers",
    "shelves",
    "machine",
    "hearth",
    "plant",
    "rail",
    "figure",
    "lamp",
    "pendant",
    "fan",
]
Material = Literal["wood", "cloth", "white", "glass", "metal", "dark", "leaf", "light", "plain"]
Support = Literal["anywhere", "floor", "wall", "ceiling"]

CAMERA_HEIGHT = 1.5
"""Metres from the floor to a camera; the median over Matterport3D is 1.54."""
# An object stands on the floor if it seems to begin at most this part of its height above it.
_STANDS = 0.5
# Metres of the thinnest and the largest side of an object.
_LEAST, _MOST = 0.03, 4.0
# Half the thickness of what hangs on a wall, and half the width of a room at least, metres.
_THIN, _ROOM = 0.03, 0.45
# Iterations that fit a solid to a box, by how much each may change a side, and the least depth.
_FITS, _CHANGE, _NEAR = 6, 2.0, 0.15


class Kind(NamedTuple):
    """What an object is built like."""

    form: Form
    material: Material
    support: Support = "anywhere"
    """Where it stands or hangs."""
    depth: float = 1.0
    """Fraction of the width."""


_KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        word: kind
        for words, kind in {
            "picture, painting, painter, photo, poster, art, frame": Kind(
                "picture", "wood", "wall"
            ),
            "window, windowframe, window frame": Kind("window", "glass", "wall"),
            "mirror, skylight, glass": Kind("board", "glass", "wall"),
            "clock, door, doorway, archway, arch, panel": Kind("board", "wood", "wall"),
            "tv, monitor, television, screen": Kind("board", "dark", "wall"),
            "curtain, blinds, tapestry, shade": Kind("curtain", "cloth", "wall"),
            "towel, clothes, robe, hanger": Kind("board", "cloth", "wall"),
            "vent, switch, thermostat, radiator, heater, board, whiteboard, wainscotting, wall, "
            "windowsill": Kind("board", "white", "wall"),
            "table, desk, stand, workbench, sidetable": Kind("table", "wood", "floor", 0.8),
            "bench, pew": Kind("table", "wood", "floor", 0.5),
            "stool": Kind("table", "wood", "floor"),
            "chair, seat": Kind("chair", "wood", "floor"),
            "armchair, sofa chair, recliner": Kind("couch", "cloth", "floor"),
            "couch, sofa, loveseat": Kind("couch", "cloth", "floor", 0.5),
            "toilet, bidet": Kind("toilet", "white", "floor"),
            "bed": Kind("bed", "cloth", "floor"),
            "sink, washbasin, basin": Kind("basin", "white"),
            "bathtub, tub": Kind("basin", "white", "floor", 0.5),
            "plant, tree, flower, bush, fern, bouquet, shrubbery": Kind("plant", "leaf"),
            "lamp": Kind("lamp", "light"),
            "chandelier": Kind("pendant", "light", "ceiling"),
            "light": Kind("block", "light", "ceiling"),
            "fan": Kind("fan", "wood", "ceiling"),
            "duct, beam, rafter, sprinkler, detector, firealarm": Kind("block", "white", "ceiling"),
            "pillar, column, post": Kind("block", "white", "floor"),
            "sconce, candle": Kind("block", "light"),
            "cabinet, counter, cupboard": Kind("cabinet", "wood", depth=0.5),
            "island, altar, locker, pantry, case": Kind("cabinet", "wood", "floor", 0.5),
            "wardrobe, closet, vanity": Kind("cabinet", "wood", "floor", 0.5),
            "dresser, drawer, chest, nightstand": Kind("drawers", "wood", "floor", 0.6),
            "shelf, shelves, shelving, rack": Kind("shelves", "wood", depth=0.4),
            "bookshelf, bookcase": Kind("shelves", "wood", "floor", 0.4),
            "fireplace": Kind("hearth", "white", "floor", 0.4),
            "countertop": Kind("block", "wood", depth=0.5),
            "refrigerator, fridge, oven, stove, dishwasher, dryer, machine": Kind(
                "machine", "white", "floor"
            ),
            "microwave, conditioner, hood, printer": Kind("machine", "white"),
            "piano, treadmill": Kind("block", "dark", "floor", 0.5),
            "pillow, cushion, blanket, sheet, comforter, cloth, purse, bag, shoe, book": Kind(
                "block", "cloth"
            ),
            "ottoman, footstool, rug, carpet, mat": Kind("block", "cloth", "floor"),
            "can, trashcan, bin, basket, hamper, suitcase, bucket, extinguisher": Kind(
                "block", "metal", "floor"
            ),
            "faucet, pipe, handle, doorhandle, knob": Kind("block", "metal"),
            "railing, handrail, fence, fencing, baracade, rope": Kind("rail", "wood", "floor", 0.1),
            "rod, bar": Kind("rail", "metal", depth=0.1),
            "vase, bottle, bowl, plate, cup, paper": Kind("block", "white"),
            "box": Kind("block", "wood"),
            "pot, flowerpot, pedestal, headboard": Kind("block", "wood", "floor"),
            "statue, sculpture, bust, figure, figurine": Kind("figure", "plain"),
        }.items()
        for word in words.split(", ")
    }
)
BLOCK = Kind("block", "plain", depth=0.6)
"""What a name tells nothing about."""

Part = tuple[Material, tuple[float, float, float], tuple[float, float, float]]
"""A box of a form: what it is made of, its low and its high corner. Coordinates are to the right,
to the back and up, from -1 to 1 within the solid; what is beyond lies on the parts before it."""


@cache
def kind_of(name: str) -> Kind:
    """Return what an object with this name is built like.

    Examples
    --------
    >>> kind_of("coffee table").form, kind_of("kitchen cabinets").form, kind_of("trophy").form
    ('table', 'cabinet', 'block')
    """
    word = name.rpartition(" ")[2]
    known = (_KINDS.get(each) for each in (name, word, word.removesuffix("s")))
    return next(filter(None, known), BLOCK)


@cache
def parts_of(kind: Kind) -> Sequence[Part]:
    """Return the boxes that an object of a kind consists of."""
    own = kind.material
    whole: Part = (own, (-1, -1, -1), (1, 1, 1))

    def legs(top: float, across: float = 0.1) -> Sequence[Part]:
        inner = 1 - 2 * across
        return [
            (own, (x, y, -1), (x + 2 * across, y + 2 * across, top))
            for x in (-1, inner)
            for y in (-1, inner)
        ]

    def front(material: Material, left: float, low: float, right: float, high: float) -> Part:
        return material, (left, -1.03, low), (right, -1, high)

    forms: Mapping[Form, Sequence[Part]] = {
        "board": [whole, front("glass" if own == "glass" else own, -0.88, -0.92, 0.88, 0.92)],
        "window": [
            ("white", (-1, -1, -1), (1, 1, 1)),
            *(front(own, x, z, x + 0.88, z + 0.88) for x in (-0.92, 0.04) for z in (-0.92, 0.04)),
        ],
        "picture": [
            whole,
            front("white", -0.86, -0.86, 0.86, 0.86),
            ("glass", (-0.6, -1.06, 0), (0.6, -1.03, 0.6)),
            ("plain", (-0.6, -1.06, -0.6), (0.6, -1.03, 0)),
        ],
        "curtain": [(own, (x, -1, -1), (x + 0.4, 1, 1)) for x in (-1, -0.6, -0.2, 0.2, 0.6)],
        "table": [*legs(0.8, 0.07), (own, (-1, -1, 0.8), (1, 1, 1))],
        "chair": [
            *legs(-0.12),
            (own, (-1, -1, -0.12), (1, 1, 0.03)),
            (own, (-1, 0.82, 0.03), (1, 1, 1)),
        ],
        "couch": [
            (own, (-1, -1, -0.9), (1, 1, -0.15)),
            (own, (-1, 0.6, -0.15), (1, 1, 1)),
            *((own, (x - 0.12, -1, -0.15), (x + 0.12, 0.6, 0.35)) for x in (-0.88, 0.88)),
        ],
        "toilet": [
            (own, (-0.6, -0.7, -1), (0.6, 0.6, -0.25)),
            (own, (-1, -1, -0.25), (1, 0.6, 0)),
            (own, (-1, 0.6, -0.4), (1, 1, 1)),
        ],
        "bed": [
            ("wood", (-1, 0.94, -1), (1, 1, 1)),
            ("white", (-0.97, -0.98, -1), (0.97, 0.94, -0.05)),
            (own, (-1, -1, -0.8), (1, 0.35, 0)),
            *(("white", (x - 0.38, 0.5, -0.05), (x + 0.38, 0.85, 0.2)) for x in (-0.48, 0.48)),
        ],
        "basin": [whole, ("glass", (-0.8, -0.8, 1), (0.8, 0.8, 1))],
        "cabinet": [whole, *(front(own, x, -0.92, x + 0.92, 0.92) for x in (-0.95, 0.03))],
        "drawers": [whole, *(front(own, -0.92, z, 0.92, z + 0.55) for z in (-0.92, -0.3, 0.32))],
        "shelves": [
            (own, (-1, 0.9, -1), (1, 1, 1)),
            *((own, (x, -1, -1), (x + 0.1, 0.9, 1)) for x in (-1, 0.9)),
            *((own, (-0.9, -1, z), (0.9, 0.9, z + 0.08)) for z in (-1, -0.36, 0.28, 0.92)),
        ],
        "machine": [
            whole,
            front("metal", -0.85, -0.85, 0.85, 0.55),
            front("dark", -0.85, 0.7, 0.85, 0.88),
        ],
        "hearth": [whole, front("dark", -0.6, -1, 0.6, 0.35)],
        "plant": [("wood", (-0.4, -0.4, -1), (0.4, 0.4, -0.4))],
        "rail": [
            (own, (-1, -1, 0.85), (1, 1, 1)),
            *((own, (x, -0.6, -1), (x + 0.06, 0.6, 0.85)) for x in (-1, -0.52, -0.03, 0.46, 0.94)),
        ],
        "figure": [
            (own, (-0.8, -0.8, -1), (0.8, 0.8, -0.75)),
            (own, (-0.5, -0.4, -0.75), (0.5, 0.4, 0.45)),
            (own, (-0.25, -0.25, 0.45), (0.25, 0.25, 1)),
        ],
        "lamp": [
            ("metal", (-0.5, -0.5, -1), (0.5, 0.5, -0.92)),
            ("metal", (-0.1, -0.1, -0.92), (0.1, 0.1, 0.1)),
            (own, (-1, -1, 0.1), (1, 1, 1)),
        ],
        "pendant": [
            ("metal", (-0.05, -0.05, 0), (0.05, 0.05, 1)),
            (own, (-1, -1, -1), (1, 1, -0.2)),
        ],
        "fan": [
            ("metal", (-0.1, -0.1, -1), (0.1, 0.1, 1)),
            (own, (-1, -0.15, -0.2), (1, 0.15, 0)),
            (own, (-0.15, -1, -0.2), (0.15, 1, 0)),
        ],
    }
    return forms.get(kind.form, [whole])


@dataclass(frozen=True, eq=False)
class Solids:
    """Objects as upright boxes along the walls of their building."""

    object_id: IntArray
    """Shape (n,)."""
    names: Sequence[str]
    storey: IntArray
    """Shape (n,): from 0 for the lowest."""
    room: IntArray
    """Shape (n,): index into the rooms of the building; -1 if its room is not drawn."""
    centre: FloatArray
    """Shape (n, 3): metres."""
    half: FloatArray
    """Shape (n, 3): half the size along each of ``axes`` and up, metres."""
    back: IntArray
    """Shape (n,): the side of its back, at a quarter turn from the first axis for each 1."""
    axes: FloatArray
    """Shape (2, 2): the directions of the walls."""

    @classmethod
    def of(
        cls,
        *,
        object_id: IntArray,
        names: Sequence[str],
        storey: IntArray,
        room: IntArray,
        centre: FloatArray,
        size: FloatArray,
        bounds: FloatArray,
        floors: FloatArray,
        axes: FloatArray,
    ) -> Self:
        """Make solids of objects that look so wide and high, shape (n, 2), metres.

        ``bounds`` of shape (n, 2, 2) has the low and the high corner of each object's room along
        the axes: solids are within, with their backs at the nearest wall. ``floors`` has the height
        of each storey. What is near the floor stands on it.
        """
        flat = centre[:, :2] @ axes.T
        to_walls = np.hstack([bounds[:, 1] - flat, flat - bounds[:, 0]])
        back = to_walls.argmin(axis=1) if len(flat) else np.zeros(0, dtype=np.int64)
        kinds = [kind_of(name) for name in names]
        is_board = np.array([kind.support == "wall" for kind in kinds], dtype=bool)
        depth = np.array([kind.depth for kind in kinds])
        across, high = np.clip(size / 2, _LEAST / 2, _MOST / 2).T
        half = np.stack([across, across, high], axis=1)
        rows = np.arange(len(half))
        half[rows, back % 2] = np.where(is_board, _THIN, across * depth)
        # What is outside of its room was seen too badly to say where it is.
        is_inside = (to_walls >= 0).all(axis=1, keepdims=True)
        middle, reach = bounds.mean(axis=1), np.maximum((bounds[:, 1] - bounds[:, 0]) / 2, _ROOM)
        half[:, :2] = np.where(is_inside, np.minimum(half[:, :2], reach), half[:, :2])
        within = middle + np.clip(flat - middle, half[:, :2] - reach, reach - half[:, :2])
        flat = np.where(is_inside, within, flat)
        floor = floors[storey]
        bottom, top = centre[:, 2] - high, centre[:, 2] + high
        stands = bottom - floor < _STANDS * 2 * high
        stands |= np.array([kind.support == "floor" for kind in kinds], dtype=bool)
        stands &= top > floor + _LEAST
        bottom = np.where(stands, floor, bottom)
        half[:, 2] = np.maximum(top - bottom, _LEAST) / 2
        up = (bottom + np.maximum(top, bottom + _LEAST)) / 2
        centre = np.column_stack([flat @ axes, up])
        return cls(object_id, names, storey, room, centre, half, back, axes)

    @property
    def frame(self) -> FloatArray:
        """Shape (3, 3): the axes of all solids, as rows."""
        frame = np.eye(3)
        frame[:2, :2] = self.axes
        return frame

    def take(self, rows: IntArray | Array) -> Self:
        """Return some of the solids."""
        return replace(
            self,
            object_id=self.object_id[rows],
            names=[self.names[row] for row in np.arange(len(self.names))[rows].tolist()],
            storey=self.storey[rows],
            room=self.room[rows],
            centre=self.centre[rows],
            half=self.half[rows],
            back=self.back[rows],
        )

    @property
    def supports(self) -> Array:
        """What each stands on or hangs from, shape (n,)."""
        return np.array([kind_of(name).support for name in self.names], dtype=np.str_)

    def moved(self, camera: FloatArray, share: FloatArray) -> Self:
        """Make the solids so many times as far from a camera, shape (n,), and as large."""
        away = (self.centre - camera) * share[:, None]
        return replace(self, centre=camera + away, half=self.half * share[:, None])

    def turned(self, back: IntArray) -> Self:
        """Turn the solids so that their backs are at these sides."""
        half = self.half.copy()
        is_across = (back - self.back) % 2 == 1
        half[is_across, :2] = half[is_across, 1::-1]
        return replace(self, half=half, back=back)

    def corners(self) -> FloatArray:
        """Return the corners of the boxes, shape (n, 8, 3)."""
        return np.asarray(self.centre[:, None] + (_CORNERS * self.half[:, None]) @ self.frame)

    def ground(self) -> FloatArray:
        """Return the corners of what is not on a wall, seen from above, shape (n, 2)."""
        return self.take(self.supports != "wall").corners()[..., :2].reshape(-1, 2)

    def parts(self) -> tuple[FloatArray, IntArray, Sequence[Material], BoolArray]:
        """Return the boxes that the solids consist of.

        Returns
        -------
        float array of shape (n_parts, 8, 3)
            Their corners.
        int array of shape (n_parts,)
            The solid of each.
        list of Material
            What each is made of.
        bool array of shape (n_parts,)
            Whether it lies on those before it.
        """
        parts = [parts_of(kind_of(name)) for name in self.names]
        row = np.repeat(np.arange(len(parts)), list(map(len, parts)))
        flat = [part for its in parts for part in its]
        if not flat:
            return np.zeros((0, 8, 3)), row, [], np.zeros(0, dtype=np.bool_)
        bounds = np.array([part[1:] for part in flat])
        local = np.where(_CORNERS[None] < 0, bounds[:, None, 0], bounds[:, None, 1])
        local = np.einsum("nij,njk->nik", local, _TURNS[self.back[row]])
        corners = self.centre[row][:, None] + (local * self.half[row][:, None]) @ self.frame
        return corners, row, [part[0] for part in flat], (np.abs(bounds) > 1).any(axis=(1, 2))

    def fitted(self, camera: FloatArray, view: IntArray, xywh: Array) -> Self:
        """Change places and sizes so that the solids look as large as they do from a viewpoint.

        Parameters
        ----------
        camera : float array of shape (3,)
            The position of the viewpoint.
        view : int array of shape (n,)
            A view of it for each solid.
        xywh : array of shape (n, 4)
            Its box there.
        """
        axes = VIEW_AXES[view]
        low = xywh[:, :2].astype(np.float64)
        size = xywh[:, 2:].astype(np.float64)
        ray = np.einsum("ni,nij->nj", rays_of(low + size / 2), axes)
        away = np.linalg.norm(self.centre - camera, axis=1) / np.linalg.norm(ray, axis=1)
        centre, half = camera + ray * np.maximum(away, _NEAR * 2)[:, None], self.half.copy()
        is_flat = np.array([kind_of(name).support == "wall" for name in self.names], dtype=bool)
        rows = np.arange(len(half))
        thick = half[rows, self.back % 2].copy()
        for _ in range(_FITS):
            solid = replace(self, centre=centre, half=half)
            seen = np.einsum("nki,nji->nkj", solid.corners() - camera, axes)
            seen[..., 2] = np.maximum(seen[..., 2], _NEAR)
            pixels = pixels_of(seen)
            first, last = pixels.min(axis=1), pixels.max(axis=1)
            wider = np.clip(size / np.maximum(last - first, 1), 1 / _CHANGE, _CHANGE)
            half = np.clip(half * wider[:, [0, 0, 1]], _LEAST / 2, _MOST)
            half[is_flat, self.back[is_flat] % 2] = thick[is_flat]
            off = (low + size / 2 - (first + last) / 2) * (1, -1) / FOCAL_LENGTH
            depth = np.einsum("ni,ni->n", centre - camera, axes[:, 2])[:, None]
            depth = np.maximum(depth, _NEAR)
            centre = centre + off[:, :1] * depth * axes[:, 0]
            centre[:, 2] += off[:, 1] * depth[:, 0] / axes[:, 1, 2]
        return replace(self, centre=centre, half=half)


_CORNERS: FloatArray = np.array(
    [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
)
SIDES: IntArray = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)
"""The corners of each side of a box: two along each axis, and then below and above."""
# Quarter turns of what is local to a solid: its back is its second coordinate.
_TURNS: FloatArray = np.array(
    [
        [(c, s, 0), (-s, c, 0), (0, 0, 1)]
        for c, s in ((0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0))
    ]
)


def sides_of(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sides of boxes, shape (n, 6, 4, 3), and their normals outwards, (n, 6, 3)."""
    sides = corners[:, SIDES]
    normal = np.cross(sides[:, :, 1] - sides[:, :, 0], sides[:, :, 3] - sides[:, :, 0])
    return sides, normal
