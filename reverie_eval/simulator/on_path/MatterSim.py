"""The Matterport3D simulator from connectivity files and numpy alone.

It stands in for ``import MatterSim`` where the original cannot be built: the same classes, methods,
defaults, errors and numbers, for both generations of its interface. Pictures are rendered from the
skyboxes that ``scripts/downsize_skybox.py`` of the original makes, or in the first generation from
those that Matterport publishes, and need Pillow too; without skyboxes, switch rendering off, as
everybody does who trains on features.

The rules are those of ``src/lib/MatterSim.cpp``, ``src/lib/NavGraph.cpp`` and
``src/lib_python/MatterSimPython.cpp`` in github.com/peteanderson80/Matterport3DSimulator at 589d091
and at its tag v0.1. What is odd there is kept, and said here. This file needs Python 3.6 and numpy
1.17, or later ones, and nothing else, so it can be copied into a project.

In the first generation (v0.1: REVERIE, EnvDrop, Recurrent-VLN-BERT) there is one agent::

    sim.init()
    sim.newEpisode(scanId, viewpointId, heading, elevation)
    sim.makeAction(index, heading, elevation)
    state = sim.getState()  # a copy

In the second (HAMT, DUET, NaviLLM) there is a batch of them, so every argument is a list::

    sim.initialize()
    sim.newEpisode([scanId], [viewpointId], [heading], [elevation])
    sim.makeAction([index], [heading], [elevation])
    (state,) = sim.getState()  # the same object every time: later actions change it

``init`` or ``initialize`` chooses the generation; without them, the first ``newEpisode`` does.

REVERIE's objects are new here; the original knows nothing of them::

    sim.setObjectsPath("tasks/REVERIE/data/BBox")  # before initialize
    state.objects  # in this view, each with objectId, name and bbox2d
    state.candidates  # from this viewpoint, each with objectId, name, visible_pos and bbox2d
"""

import hashlib
import json
import math
import operator
import os
import random
import tempfile
import zipfile
import zlib
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

__all__ = ["Candidate", "Mat", "Objects", "SeenObject", "SimState", "Simulator", "ViewPoint", "cbf"]

_HEADINGS = 12
_TURN = math.pi * 2.0 / _HEADINGS
_TILT = math.pi / 6.0
_ALL_HEADINGS = [step * _TURN for step in range(_HEADINGS)]
# The environment variable that names the folder of the tables; empty for none.
_CACHE_VARIABLE = "MATTERSIM_CACHE"

Mat = np.ndarray
"""Pictures are arrays; the original's matrices offer the same buffer protocol."""


def cbf(depth: Any, intensity: Any, mask: Any, result: Any) -> None:
    """Raise NotImplementedError: the original fills holes in depth pictures."""
    raise NotImplementedError("MatterSim: only the original fills holes in depth pictures")


def _read_only(name: str, doc: str) -> property:
    return property(operator.attrgetter("_" + name), doc=doc)


class ViewPoint:
    """A viewpoint, seen from an agent.

    When the agent goes there, its relative values become zero, also in lists that were kept.
    """

    __slots__ = ("_ix", "_rel_distance", "_rel_elevation", "_rel_heading", "_viewpointId", "_xyz")

    viewpointId = _read_only("viewpointId", "Its name.")
    ix = _read_only("ix", "Its index in the connectivity file, which counts excluded ones too.")
    rel_heading = _read_only("rel_heading", "Radians to the right of the agent's heading.")
    rel_elevation = _read_only("rel_elevation", "Radians above the agent's elevation.")
    rel_distance = _read_only("rel_distance", "Metres from the agent.")
    x = property(lambda self: self._xyz[0], doc="Metres along the building's first axis.")
    y = property(lambda self: self._xyz[1], doc="Metres along its second axis.")
    z = property(lambda self: self._xyz[2], doc="Metres of height.")
    point = property(
        lambda self: list(self._xyz), doc="All three, as the first generation has them."
    )

    def __init__(
        self,
        viewpointId: str,
        ix: int,
        xyz: Tuple[float, float, float],
        rel_heading: float = 0.0,
        rel_elevation: float = 0.0,
        rel_distance: float = 0.0,
    ) -> None:
        self._viewpointId = viewpointId
        self._ix = ix
        self._xyz = xyz
        self._rel_heading = rel_heading
        self._rel_elevation = rel_elevation
        self._rel_distance = rel_distance

    def _copy(self) -> "ViewPoint":
        relative = self._rel_heading, self._rel_elevation, self._rel_distance
        return ViewPoint(self._viewpointId, self._ix, self._xyz, *relative)


class SeenObject(NamedTuple):
    """An object of REVERIE in a view."""

    objectId: int
    """Within the building."""
    name: str
    bbox2d: List[int]
    """Left, top, width and height in pixels of a view of 640 x 480 with 60 degrees from top to
    bottom, whatever the camera is set to."""


class Candidate(NamedTuple):
    """An object of REVERIE that is visible from a viewpoint, in the fields of the released files.

    The files list the objects within 3 metres of the viewpoint.
    """

    objectId: int
    name: str
    visible_pos: List[int]
    """The views that show it, 0 to 35."""
    bbox2d: List[List[int]]
    """The box of the object in each view that shows it."""


class SimState:
    """Where an agent is, where it looks, and where it can go."""

    __slots__ = (
        "_candidates",
        "_depth",
        "_elevation",
        "_heading",
        "_location",
        "_navigable",
        "_objects",
        "_rgb",
        "_scanId",
        "_step",
        "_viewIndex",
    )

    scanId = _read_only("scanId", "The building; empty before the first episode.")
    step = _read_only("step", "Actions since the episode began.")
    rgb = _read_only("rgb", "uint8 of shape (height, width, 3), blue first; black if not rendered.")
    depth = _read_only("depth", "uint16 of shape (height, width, 1); zero if not rendered.")
    location = _read_only("location", "The agent's viewpoint; None before the first episode.")
    heading = _read_only("heading", "Radians to the right of the building's second axis, from 0.")
    elevation = _read_only("elevation", "Radians above the horizon.")
    viewIndex = _read_only("viewIndex", "With discretized angles 0 to 35, from the lowest row.")
    navigableLocations = property(
        lambda self: list(self._navigable),
        doc="The agent's viewpoint, then others it can go to, the nearest to the centre first.",
    )

    candidates = property(
        lambda self: list(self._candidates),
        doc="The objects that are visible from the viewpoint; none without setObjectsPath.",
    )
    objects = property(
        lambda self: list(self._objects),
        doc="Those in this view; none without setDiscretizedViewingAngles(True).",
    )

    def __init__(self, width: int, height: int) -> None:
        self._scanId = ""
        self._step = 0
        self._rgb = np.zeros((height, width, 3), np.uint8)
        self._depth = np.zeros((height, width, 1), np.uint16)
        self._location: Optional[ViewPoint] = None
        self._heading = 0.0
        self._elevation = 0.0
        self._viewIndex = 0
        self._navigable: List[ViewPoint] = []
        self._candidates: List[Candidate] = []
        self._objects: List[SeenObject] = []

    def _copy(self) -> "SimState":
        copy = SimState.__new__(SimState)
        for name in self.__slots__:
            setattr(copy, name, getattr(self, name))
        copy._location = self._location._copy() if self._location else None
        copy._navigable = [each._copy() for each in self._navigable]
        return copy


class Simulator:
    """Agents that walk through buildings."""

    def __init__(self) -> None:
        self._width, self._height, self._vfov = 320, 240, 0.8
        self._lowest, self._highest = -0.94, 0.94
        self._path = "./connectivity"
        self._dataset_path: Optional[str] = None
        """None for the default, which is another one in each generation."""
        self._is_rendering, self._has_depth = True, False
        self._is_discretized = False
        self._is_restricted = True
        self._batch_size = 1
        self._random = random.Random(1)
        self._generation = 0
        """0 until it is initialized, and again after :meth:`close`."""
        self._buildings: Optional[_Buildings] = None
        self._renderer: Optional[_Renderer] = None
        self._objects: Optional[Objects] = None
        self._states: List[SimState] = []

    # Camera and elevation limits can change at any time. What else is set after initialization is
    # ignored without a word, except that the first generation takes another path of graphs.

    def setDatasetPath(self, path: str) -> None:
        """Set the folder of the scans; in the first generation, the one that has ``v1/scans``."""
        if self._generation != 2:
            self._dataset_path = _text(path)

    def setNavGraphPath(self, path: str) -> None:
        """Set the folder with the connectivity files."""
        if self._generation != 2:
            self._path = _text(path)

    def setObjectsPath(self, path: str) -> None:
        """Set where objects are visible, as :class:`Objects` reads it; at first, there are none."""
        if not self._generation:
            self._objects = Objects(_text(path))

    def setRenderingEnabled(self, value: bool) -> None:
        """Set whether pictures are rendered; at first, they are."""
        if not self._generation:
            self._is_rendering = bool(value)

    def setCameraResolution(self, width: int, height: int) -> None:
        """Set the pixels of pictures; together with the field of view, they decide what is seen."""
        self._width, self._height = operator.index(width), operator.index(height)

    def setCameraVFOV(self, vfov: float) -> None:
        """Set the vertical field of view in radians; the horizontal one follows from the pixels."""
        self._vfov = _number(vfov)

    def setElevationLimits(self, min: float, max: float) -> bool:
        """Set the lowest and the highest elevation in radians, for angles that are not discretized.

        Returns False, and changes nothing, unless -pi/2 < min < 0 < max < pi/2.
        """
        lowest, highest = _number(min), _number(max)
        is_possible = -math.pi / 2.0 < lowest < 0.0 < highest < math.pi / 2.0
        if is_possible:
            self._lowest, self._highest = lowest, highest
        return is_possible

    def setDiscretizedViewingAngles(self, value: bool) -> None:
        """Set whether angles are multiples of 30 degrees; at first, they are not."""
        if not self._generation:
            self._is_discretized = bool(value)

    def setRestrictedNavigation(self, value: bool) -> None:
        """Set whether one can go only where one looks; at first, one can."""
        if not self._generation:
            self._is_restricted = bool(value)

    def setBatchSize(self, size: int) -> None:
        """Set the number of agents."""
        if not self._generation:
            self._batch_size = _count(size)

    def setSeed(self, seed: int) -> None:
        """Set the seed for random viewpoints and headings, which are not those of the original."""
        if self._generation != 2:
            self._random = random.Random(operator.index(seed))

    def setDepthEnabled(self, value: bool) -> None:
        """Set whether depth is rendered, from skyboxes with depth; at first, it is not."""
        if not self._generation:
            self._has_depth = bool(value)

    def setPreloadingEnabled(self, value: bool) -> None:
        """Do nothing: skyboxes are read when an agent comes to them."""

    def setCacheSize(self, size: int) -> None:
        """Do nothing: the skyboxes of the last few viewpoints are kept."""

    def init(self) -> None:
        """Begin in the first generation. Raises ImportError if rendering is on, without Pillow."""
        self._begin(1)

    def initialize(self) -> None:
        """Begin in the second generation. Raises ImportError if rendering is on, without Pillow."""
        self._begin(2)

    def _begin(self, generation: int) -> None:
        if self._is_rendering:
            self._renderer = _Renderer(self._width, self._height, self._vfov)
        # In the second generation, a second call adds as many agents again, as in the original.
        number = self._batch_size if generation == 2 else 1 - len(self._states)
        self._states += [SimState(self._width, self._height) for _ in range(number)]
        self._generation = generation

    def newEpisode(
        self, scanId: Any, viewpointId: Any = "", heading: Any = 0.0, elevation: Any = 0.0
    ) -> None:
        """Begin an episode; in the first generation, at a random viewpoint if none is given.

        Raises
        ------
        ValueError
            If there is no connectivity file, or it is broken, lacks the viewpoint or excludes it.
        IndexError
            In the second generation: if ``scans.txt`` has no such building, or a list is shorter
            than the batch. Agents have turned then, and those before have moved.
        TypeError
            If an argument is of the other generation.
        """
        if not self._generation:
            self._begin(1 if isinstance(scanId, str) else 2)
        if self._generation == 1:
            scans, viewpoints = [_text(scanId)], [_text(viewpointId)]
            headings, elevations = [_number(heading)], [_number(elevation)]
        else:
            scans, viewpoints = _list(_text, scanId), _list(_text, viewpointId)
            headings, elevations = _list(_number, heading), _list(_number, elevation)
        self._look(headings, elevations)
        for number, state in enumerate(self._states):
            state._step = 0
            state._scanId = scans[number]
            building = self._building(state._scanId)
            if self._generation == 1 and not viewpoints[number]:
                viewpoints[number] = building.random_viewpoint(self._random)
            state._location = building.viewpoint(viewpoints[number])
        self._see()

    def newRandomEpisode(self, scanIds: Any) -> None:
        """Begin an episode of the second generation at random viewpoints, with random headings."""
        if not self._generation:
            self._begin(2)
        scans = _list(_text, scanIds)
        viewpoints = [self._building(scan).random_viewpoint(self._random) for scan in scans]
        headings = [self._random.uniform(0.0, math.pi * 2.0) for _ in scans]
        self.newEpisode(scans, viewpoints, headings, [0.0] * len(scans))

    def getState(self) -> Any:
        """Return a copy of the state; in the second generation, a list of the states themselves."""
        return self._states[0]._copy() if self._generation == 1 else list(self._states)

    def makeAction(self, index: Any, heading: Any, elevation: Any) -> None:
        """Go to ``navigableLocations[index]``, where 0 is to stay, and turn.

        ``heading`` and ``elevation`` are radians. With discretized angles, each counts by its sign
        only, as 30 degrees.

        Raises
        ------
        ValueError
            If there is no such index; agents before in the batch have moved then, but not turned.
        IndexError
            If a list is shorter than the batch.
        RuntimeError
            In the second generation: before initialization.
        TypeError
            If an argument is of the other generation.
        """
        if self._generation == 1:
            indices, headings = [operator.index(index)], [_number(heading)]
            elevations = [_number(elevation)]
        else:
            indices, headings = _list(_count, index), _list(_number, heading)
            elevations = _list(_number, elevation)
            if not self._generation:
                raise RuntimeError("MatterSim: newEpisode must be called before makeAction")
        looks = []
        for number, state in enumerate(self._states):
            if not 0 <= indices[number] < len(state._navigable):
                raise ValueError(self._no_such_index(indices[number], number))
            location = state._location = state._navigable[indices[number]]
            location._rel_heading = location._rel_elevation = location._rel_distance = 0.0
            state._step += 1
            turn, tilt = headings[number], elevations[number]
            if self._is_discretized:
                turn, tilt = _sign(turn) * _TURN, _sign(tilt) * _TILT
            looks.append((state._heading + turn, state._elevation + tilt))
        self._look(*zip(*looks))
        self._see()

    def _no_such_index(self, index: int, number: int) -> str:
        message = f"MatterSim: Invalid action index: {index}"
        if self._generation == 1:
            return message
        return f"{message} in environment {number} of {self._batch_size}"

    def close(self) -> None:
        """End; what is set afterwards counts again."""
        self._generation = 0

    def resetTimers(self) -> None:
        """Do nothing: no time is taken."""

    def timingInfo(self) -> str:
        """Return that no time is taken."""
        return "MatterSim: no time is taken"

    def _look(self, headings: Any, elevations: Any) -> None:
        """Set the agents' headings and elevations, which may be any radians."""
        for number, state in enumerate(self._states):
            heading = math.fmod(headings[number], math.pi * 2.0)
            while heading < 0.0:
                heading += math.pi * 2.0
            elevation = elevations[number]
            if not self._is_discretized:
                state._heading = heading
                state._elevation = max(min(elevation, self._highest), self._lowest)
                continue
            turns = heading / _TURN
            step = int(turns) + (turns - int(turns) >= 0.5)  # halves away from zero
            step = 0 if step == _HEADINGS else step
            row = 0 if elevation < -_TILT / 2.0 else 2 if elevation > _TILT / 2.0 else 1
            state._heading = step * _TURN
            state._elevation = (row - 1) * _TILT
            state._viewIndex = row * _HEADINGS + step

    def _see(self) -> None:
        """Set where the agents can go."""
        least = -math.inf
        if self._is_restricted:
            least = math.cos(self._vfov * self._width / self._height / 2.0)
        for state in self._states:
            building, location = self._building(state._scanId), state._location
            if location is None:  # its newEpisode failed
                continue
            seen = []
            for near, rel_heading in building.seen(
                location._ix, state._heading, least, keep=self._is_discretized
            ):
                relative = rel_heading, near.elevation - state._elevation, near.distance
                seen.append(ViewPoint(near.viewpointId, near.ix, near.xyz, *relative))
            state._navigable = [location, *sorted(seen, key=_from_centre)]
            if self._objects is not None:
                self._find_objects(self._objects, state, location)
            if self._is_rendering and self._renderer is not None:
                self._render(self._renderer, state, location, building.rotation(location._ix))

    def _find_objects(self, objects: "Objects", state: SimState, location: ViewPoint) -> None:
        """Set the objects of a state."""
        state._candidates = objects.visible_from(state._scanId, location._viewpointId)
        state._objects = [
            SeenObject(each.objectId, each.name, box)
            for each in state._candidates
            for view, box in zip(each.visible_pos, each.bbox2d)
            if self._is_discretized and view == state._viewIndex
        ]

    def _render(
        self, renderer: "_Renderer", state: SimState, location: ViewPoint, rotation: np.ndarray
    ) -> None:
        """Set the pictures of a state."""
        skybox = f"{state._scanId}/matterport_skybox_images/{location._viewpointId}_skybox"
        sight = renderer.look(rotation, state._heading, state._elevation)
        if self._generation == 1:
            folder = "./data" if self._dataset_path is None else self._dataset_path
            state._rgb = renderer.colours(f"{folder}/v1/scans/{skybox}{_ANY_FACE}_sami.jpg", sight)
            return
        folder = "./data/v1/scans/" if self._dataset_path is None else self._dataset_path
        state._rgb = renderer.colours(f"{folder}/{skybox}_small.jpg", sight)
        if self._has_depth:
            state._depth = renderer.depths(f"{folder}/{skybox}_depth_small.png", sight)

    def _building(self, scan: str) -> "_Building":
        if self._generation == 1:
            return _first_generation(self._path, scan)
        if self._buildings is None:
            self._buildings = _Buildings.shared(self._path)
        return self._buildings.building(scan)


def _from_centre(viewpoint: ViewPoint) -> float:
    heading, elevation = viewpoint._rel_heading, viewpoint._rel_elevation
    return math.sqrt(heading * heading + elevation * elevation)


class _Neighbour(NamedTuple):
    """A viewpoint beside another one."""

    viewpointId: str
    ix: int
    xyz: Tuple[float, float, float]
    elevation: float
    """Radians above the other one's horizon."""
    distance: float


class _Neighbours(NamedTuple):
    """The viewpoints that one can reach from another one; all arrays are float32."""

    found: List[_Neighbour]
    x: np.ndarray
    y: np.ndarray
    unit_x: np.ndarray
    """With ``unit_y``, the horizontal direction, of length 1; NaN for a viewpoint straight above or
    below, which is therefore never seen."""
    unit_y: np.ndarray


class _Building:
    """The viewpoints of a building.

    The original computes in float32 what comes from positions, and in double precision what comes
    from angles; each step here has the type that it has there, so all numbers are the same.
    """

    def __init__(self, table: np.ndarray) -> None:
        self._ids: List[str] = [name.decode() for name in table["id"].tolist()]
        self._indices = {name: ix for ix, name in reversed(list(enumerate(self._ids)))}
        self._included = table["included"]
        self._xyz = table["xyz"]
        self._rotation = table["rotation"]
        self._unobstructed = table["unobstructed"]
        self._neighbours: Dict[int, _Neighbours] = {}
        self._seen: Dict[Tuple[int, float, float], List[Tuple[_Neighbour, float]]] = {}

    def viewpoint(self, viewpointId: str) -> ViewPoint:
        """Return a viewpoint as seen from itself. Raises ValueError if one cannot be there."""
        ix = self._indices.get(viewpointId)
        if ix is None:
            raise ValueError(
                f"MatterSim: Could not find viewpointId: {viewpointId}, is viewpoint id valid?"
            )
        if not self._included[ix]:
            raise ValueError(
                f"MatterSim: ViewpointId: {viewpointId}, is excluded from the connectivity graph."
            )
        return ViewPoint(viewpointId, ix, tuple(self._xyz[ix].tolist()))

    def rotation(self, ix: int) -> np.ndarray:
        """Return how the skybox of a viewpoint is turned, shape (3, 3)."""
        rotation: np.ndarray = self._rotation[ix].reshape(3, 3)
        return rotation

    def random_viewpoint(self, source: random.Random) -> str:
        """Return any viewpoint where one can be. Raises RuntimeError if there is none."""
        names = [name for name, ix in self._indices.items() if self._included[ix]]
        if not names:
            raise RuntimeError("MatterSim: a building has no included viewpoints!")
        return names[source.randrange(len(names))]

    def seen(
        self, ix: int, heading: float, least: float, keep: bool
    ) -> List[Tuple[_Neighbour, float]]:
        """Return the viewpoints that one can reach and see, with their relative headings.

        Parameters
        ----------
        ix : int
            Where one stands.
        heading : float
            Where one looks, in radians.
        least : float
            The cosine of the angle up to which one sees; from -inf, everything is seen.
        keep : bool
            Whether to keep what was found, because there are few headings.
        """
        if not keep:
            return self._find(ix, [heading], least)[0]
        key = ix, heading, least
        if key not in self._seen:
            for each, found in zip(_ALL_HEADINGS, self._find(ix, _ALL_HEADINGS, least)):
                self._seen[ix, each, least] = found
        return self._seen[key]

    def _find(
        self, ix: int, headings: List[float], least: float
    ) -> List[List[Tuple[_Neighbour, float]]]:
        near = self._neighbours.get(ix)
        if near is None:
            near = self._neighbours[ix] = self._reachable(ix)
        angles = [math.pi / 2.0 - heading for heading in headings]
        cosine = np.array([[math.cos(angle)] for angle in angles], np.float32)
        sine = np.array([[math.sin(angle)] for angle in angles], np.float32)
        to_right = near.x * sine - near.y * cosine
        rel_headings = _atan2f(to_right, near.x * cosine + near.y * sine).tolist()
        if least == -math.inf:
            return [list(zip(near.found, row)) for row in rel_headings]
        cosines = (near.unit_x * cosine + near.unit_y * sine).tolist()
        return [
            [(each, rel) for each, rel, along in zip(near.found, *rows) if along >= least]
            for rows in zip(rel_headings, cosines)
        ]

    def _reachable(self, ix: int) -> _Neighbours:
        is_reachable = self._included & self._unobstructed[ix]
        is_reachable[ix] = False
        (indices,) = is_reachable.nonzero()
        x, y, z = (self._xyz[indices] - self._xyz[ix]).T
        across = x * x + y * y
        with np.errstate(divide="ignore", invalid="ignore"):
            per_length = np.float32(1.0) / np.sqrt(across)
            unit_x, unit_y = x * per_length, y * per_length
        elevations = map(math.atan2, z.tolist(), np.sqrt(across).tolist())
        distances = np.sqrt(across + z * z).tolist()
        names = [self._ids[each] for each in indices]
        positions = map(tuple, self._xyz[indices].tolist())
        found = list(map(_Neighbour, names, indices.tolist(), positions, elevations, distances))
        return _Neighbours(found, x, y, unit_x, unit_y)


def _constants(*values: float) -> np.ndarray:
    return np.array(values, np.float32)


# Between the ranges that have a formula each: (a x + b) / (c x + d) has an arctangent by the
# polynomial, which is less than that of x by an angle given in two parts.
_EDGES = _constants(7 / 16, 11 / 16, 19 / 16, 39 / 16)
_A, _B = _constants(1, 2, 1, 1, 0), _constants(0, -1, -1, -1.5, -1)
_C, _D = _constants(0, 1, 1, 1.5, 1), _constants(1, 2, 1, 1, 0)
_HIGH = _constants(0, 4.6364760399e-01, 7.8539812565e-01, 9.8279368877e-01, 1.5707962513)
_LOW = _constants(0, 5.0121582440e-09, 3.7748947079e-08, 3.4473217170e-08, 7.5497894159e-08)
_POLYNOMIAL = _constants(
    3.3333334327e-01,
    -2.0000000298e-01,
    1.4285714924e-01,
    -1.1111110449e-01,
    9.0908870101e-02,
    -7.6918758452e-02,
    6.6610731184e-02,
    -5.8335702866e-02,
    4.9768779427e-02,
    -3.6531571299e-02,
    1.6285819933e-02,
)
_PI, _REST_OF_PI = _constants(3.1415927410, -8.7422776573e-08)


def _atan2f(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return what ``atan2f`` of the GNU C library gave the original, to the last bit.

    The method and its constants are those of ``s_atanf.c`` and ``e_atan2f.c`` in glibc up to 2.40,
    by Sun Microsystems. ``numpy.arctan2`` has other last bits on some processors, for two in five.
    """
    with np.errstate(all="ignore"):
        ratio = np.abs(y / x)
    ratio[np.isnan(ratio)] = 0  # both are zero
    is_finite = ratio < np.inf
    finite = np.where(is_finite, ratio, np.float32(1))
    part = np.where(is_finite, np.searchsorted(_EDGES, ratio, side="right"), 4)
    reduced = (_A[part] * finite + _B[part]) / (_C[part] * finite + _D[part])
    reduced[~is_finite] = 0
    square = reduced * reduced
    fourth = square * square
    odd, even = _POLYNOMIAL[-1], _POLYNOMIAL[-2]
    for coefficient in _POLYNOMIAL[-3::-2]:
        odd = coefficient + fourth * odd
    for coefficient in _POLYNOMIAL[-4::-2]:
        even = coefficient + fourth * even
    series = square * odd + fourth * even
    angle = _HIGH[part] - ((reduced * series - _LOW[part]) - reduced)
    angle = np.where(np.signbit(x), _PI - (angle - _REST_OF_PI), angle)
    signed: np.ndarray = np.copysign(angle, y)
    return signed


# Pictures. A skybox is a strip of six square faces of a cube around the viewpoint. In the first
# generation, each face has a file of its own, as Matterport publishes them.

# In the name of a skybox, stands for the position of each face in the strip.
_ANY_FACE = "*"

# The position of each face in the strip, in the cube's own directions: y, z, x, -z, -x and -y.
_UP, _FRONT, _RIGHT, _BACK, _LEFT, _DOWN = range(6)
# Pixels are blended from their four neighbours in this many steps along each side.
_STEPS = 64
# Bits that two numbers of steps add to a colour that is multiplied by both.
_BITS = 12
# The first bits of red, green and blue in an integer of 64 bits: one product blends all three.
_LANES = 0, 21, 42
_SKYBOXES_KEPT = 8


class _Sight(NamedTuple):
    """Where each pixel of a view is in the strip, arrays of shape (height * width,)."""

    face: np.ndarray
    across: np.ndarray
    """In [-1, 1] from the left edge of the face to the right one."""
    down: np.ndarray


class _Renderer:
    """Renders views of skyboxes, as the original does by a cube map."""

    def __init__(self, width: int, height: int, vfov: float) -> None:
        try:
            from PIL import Image
        except ImportError:
            raise ImportError(
                "MatterSim: pictures need Pillow (pip install pillow); without them, call "
                "setRenderingEnabled(False) before init or initialize"
            ) from None
        self._open = Image.open
        self._shape = height, width
        # Of the ray through each pixel: to the right and upwards, for each metre forwards.
        slope = math.tan(vfov / 2.0)
        right = ((np.arange(width) + 0.5) * 2.0 / width - 1.0) * slope * width / height
        upwards = ((np.arange(height) + 0.5) * 2.0 / height - 1.0) * slope
        self._right, self._upwards = right.astype(np.float32), upwards.astype(np.float32)[:, None]
        self._skyboxes: Dict[str, np.ndarray] = {}

    def look(self, rotation: np.ndarray, heading: float, elevation: float) -> _Sight:
        """Return where the pixels are of a view with this heading and elevation."""
        # The original turns the camera upside down, because OpenGL's first row is the lowest.
        view = _turned(0, elevation - math.pi / 2.0).dot(_turned(2, math.pi + heading))
        x, y, z = (
            (right * self._right + (up * self._upwards - forwards)).ravel()
            for right, up, forwards in view.dot(rotation).T.astype(np.float32)
        )
        return _sight_of(x, y, z)

    def colours(self, file: str, sight: _Sight) -> np.ndarray:
        """Return a view in colours, blue first."""
        return _blended(self._strip(file, "RGB"), sight).reshape(*self._shape, 3)

    def depths(self, file: str, sight: _Sight) -> np.ndarray:
        """Return a view in depth along the camera's axis: skyboxes have it along each ray."""
        strip = self._strip(file, "I")
        size = len(strip)
        row, column = (
            np.clip((side + 1) * (size / 2), 0, size - 1).astype(np.int32)
            for side in (sight.down, sight.across)
        )
        along_axis = 1.0 / np.sqrt(1.0 + self._right**2 + self._upwards**2)
        view = strip[row, sight.face * size + column].reshape(self._shape) * along_axis
        rounded: np.ndarray = (view + 0.5).astype(np.uint16)[..., None]
        return rounded

    def _strip(self, file: str, mode: str) -> np.ndarray:
        strip = self._skyboxes.pop(file, None)
        if strip is None:
            strip = self._read(file, mode)
        while len(self._skyboxes) >= _SKYBOXES_KEPT:
            del self._skyboxes[next(iter(self._skyboxes))]  # used longest ago
        self._skyboxes[file] = strip
        return strip

    def _read(self, file: str, mode: str) -> np.ndarray:
        names = [file]
        if _ANY_FACE in file:
            names = [file.replace(_ANY_FACE, str(face)) for face in range(6)]
        try:
            parts = []
            for name in names:
                with self._open(name) as opened:
                    parts.append(np.asarray(opened.convert(mode)))
        except OSError:
            kind = "depth " if mode == "I" else "RGB " if len(names) == 1 else ""
            raise ValueError(f"MatterSim: Could not open skybox {kind}files at: {file}") from None
        for part in parts:
            height, width = part.shape[:2]
            if width * len(parts) != 6 * height or part.shape != parts[0].shape:
                raise ValueError(
                    f"MatterSim: {file} has {width} x {height} pixels; expected six square faces "
                    + ("beside each other" if len(parts) == 1 else "of one size")
                )
        strip = np.concatenate(parts, axis=1)
        return strip if mode == "I" else _packed(strip)


def _sight_of(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> _Sight:
    """Return where in a skybox the rays are that have these coordinates in the cube map."""
    along_x, along_y, along_z = np.abs(x), np.abs(y), np.abs(z)
    face = np.where(z > 0, _FRONT, _BACK).astype(np.int32)
    across, down, depth = np.where(z > 0, x, -x), -y, along_z
    (side,) = np.nonzero((along_x >= along_y) & (along_x >= along_z))
    is_right = x[side] > 0
    face[side] = np.where(is_right, _RIGHT, _LEFT)
    across[side] = np.where(is_right, -z[side], z[side])
    depth[side] = along_x[side]
    (level,) = np.nonzero((along_y >= along_z) & (along_y > along_x))
    is_up = y[level] > 0
    face[level] = np.where(is_up, _UP, _DOWN)
    across[level] = x[level]
    down[level] = np.where(is_up, z[level], -z[level])
    depth[level] = along_y[level]
    return _Sight(face, across / depth, down / depth)


def _packed(strip: np.ndarray) -> np.ndarray:
    """Return the three colours of each pixel in one number, so that one product blends all."""
    packed = np.zeros(strip.shape[:2], np.uint64)
    for channel, lane in enumerate(_LANES):
        packed |= strip[..., channel].astype(np.uint64) << np.uint64(lane)
    return packed


def _blended(packed: np.ndarray, sight: _Sight) -> np.ndarray:
    """Return the colours of rays, blue first, shape (n, 3), blended from neighbours in a face."""
    size = len(packed)
    column, right = _pixels(sight.across, size)
    row, lower = _pixels(sight.down, size)
    index = (row * 6 + sight.face) * size + column
    left, upper = np.uint64(_STEPS) - right, np.uint64(_STEPS) - lower
    pixels = packed.ravel()
    above = pixels.take(index) * left + pixels.take(index + 1) * right
    index += 6 * size
    below = pixels.take(index) * left + pixels.take(index + 1) * right
    blended = above * upper + below * lower
    blended += np.uint64(sum(1 << (_BITS - 1 + lane) for lane in _LANES))  # to round
    colours = np.empty((len(blended), 3), np.uint8)
    for channel, lane in enumerate(reversed(_LANES)):
        shifted = blended >> np.uint64(_BITS + lane)
        colours[:, channel] = shifted.astype(np.uint8)
    return colours


def _turned(axis: int, angle: float) -> np.ndarray:
    """Return a rotation about an axis, shape (3, 3)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[first, first] = rotation[second, second] = cosine
    rotation[first, second], rotation[second, first] = -sine, sine
    return rotation


def _pixels(side: np.ndarray, size: int) -> Tuple[np.ndarray, np.ndarray]:
    """Return the pixel at or before each position along a face, and how many steps follow it."""
    steps = np.clip((side + 1) * (size / 2) - 0.5, 0, size - 1) * _STEPS + 0.5
    whole = steps.astype(np.int32)
    pixel = np.minimum(whole // _STEPS, size - 2)
    return pixel, (whole - pixel * _STEPS).astype(np.uint64)


class _Buildings:
    """The buildings of a folder, each read when somebody first enters it."""

    _first: Optional["_Buildings"] = None

    def __init__(self, path: str) -> None:
        listed = path + "/scans.txt"
        try:
            with open(listed, encoding="utf-8") as file:
                scans = file.read().split()
        except OSError:
            raise ValueError(
                f"MatterSim: Could not open list of scans at: {listed}, is path valid?"
            ) from None
        for scan in scans:
            if not os.path.isfile(_file_of(path, scan)):
                raise _no_file(_file_of(path, scan), "path")
        self._path = path
        self._scans = frozenset(scans)

    @classmethod
    def shared(cls, path: str) -> "_Buildings":
        """Return the first that were asked for, whatever the path: as in the original."""
        if cls._first is None:
            cls._first = cls(path)
        return cls._first

    def building(self, scan: str) -> _Building:
        """Return a building. Raises IndexError without it, and ValueError if it is broken."""
        if scan not in self._scans:
            raise IndexError(f"map::at: no building {scan!r} in {self._path}/scans.txt")
        return _building(_file_of(self._path, scan))


def _first_generation(path: str, scan: str) -> _Building:
    file = _file_of(path, scan)
    if file not in _BUILDINGS and not os.path.isfile(file):
        raise _no_file(file, "scan id")
    return _building(file)


def _file_of(path: str, scan: str) -> str:
    return f"{path}/{scan}_connectivity.json"


def _no_file(file: str, what: str) -> ValueError:
    return ValueError(f"MatterSim: Could not open navigation graph file: {file}, is {what} valid?")


# By file, for all simulators of the process.
_BUILDINGS: Dict[str, _Building] = {}


def _building(file: str) -> _Building:
    building = _BUILDINGS.get(file)
    if building is None:
        building = _BUILDINGS[file] = _Building(_table(file))
    return building


# The version of the kept tables: another number when they have other fields.
_FORMAT = 1


def _table(file: str) -> np.ndarray:
    """Read a connectivity file, or the table that was made of it earlier."""
    status = os.stat(file)
    of = f"{_FORMAT}\0{os.path.abspath(file)}\0{status.st_size}\0{status.st_mtime_ns}"
    folder = _cache_folder()
    cached = folder and os.path.join(folder, hashlib.sha256(of.encode()).hexdigest() + ".npy")
    try:
        table: np.ndarray = np.load(cached)
    except (EOFError, OSError, TypeError, ValueError):  # there is none, or it was cut off
        table = _parse(file)
        if cached:
            _write(cached, table)
    return table


def _cache_folder() -> str:
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser(os.path.join("~", ".cache"))
    return os.environ.get(_CACHE_VARIABLE, os.path.join(base, "mattersim"))


def _write(cached: str, table: np.ndarray) -> None:
    """Keep a table, if there is a folder for it."""
    folder = os.path.dirname(cached)
    try:
        os.makedirs(folder, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as hidden:
            part = os.path.join(hidden, "table.npy")
            np.save(part, table)
            os.replace(part, cached)
    except OSError:
        pass


def _parse(file: str) -> np.ndarray:
    """Read a connectivity file. Raises ValueError with its first fault."""
    try:
        with open(file, encoding="utf-8") as opened:
            viewpoints = json.load(opened)
        rows = _rows(viewpoints)
        width = max([1] + [len(row[0]) for row in rows])
        fields: Any = [
            ("id", f"S{width}"),
            ("included", "?"),
            ("xyz", "<f4", 3),
            ("rotation", "<f4", 9),
            ("unobstructed", "?", (len(rows),)),
        ]
        return np.array(rows, fields)
    except ValueError as error:
        raise ValueError(f"MatterSim: {file}: {error}") from None


def _rows(viewpoints: Any) -> List[Any]:
    if not isinstance(viewpoints, list):
        raise ValueError("it is not a list of viewpoints")
    return [_row(len(viewpoints), *each) for each in enumerate(viewpoints)]


def _row(number: int, ix: int, viewpoint: Any) -> Tuple[Any, ...]:
    where = f"viewpoint {ix}: "
    if not isinstance(viewpoint, dict):
        raise ValueError(where + "it is not an object")
    missing = [name for name in _FIELDS if name not in viewpoint]
    if missing:
        raise ValueError(where + "it has no {}".format(" and no ".join(missing)))
    name, included, pose, unobstructed = (viewpoint[name] for name in _FIELDS)
    where = f"viewpoint {ix} ({name}): "
    if not isinstance(name, str):
        raise ValueError(where + "image_id is not a string")
    if not (isinstance(pose, list) and len(pose) == 16 and all(map(_is_number, pose))):
        raise ValueError(where + "pose has no 16 numbers")
    if not (isinstance(unobstructed, list) and len(unobstructed) == number):
        raise ValueError(where + f"unobstructed has no value for each of {number} viewpoints")
    rotation = [*pose[0:3], *pose[4:7], *pose[8:11]]
    return name.encode(), bool(included), pose[3:12:4], rotation, list(map(bool, unobstructed))


_FIELDS = "image_id", "included", "pose", "unobstructed"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


class Objects:
    """Where REVERIE's objects are visible.

    Parameters
    ----------
    path : str
        The released folder ``BBox``, one file with all of it (``BBoxes.json``), or a bundle with
        the solution that ``reverie-eval compile`` wrote.

    Raises
    ------
    ValueError
        If there is no such file or folder, or it has no objects in one of these forms.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._records: Dict[str, Any] = {}
        self._is_folder = os.path.isdir(path)
        if self._is_folder:
            if not any(name.endswith(".json") for name in os.listdir(path)):
                raise ValueError(f"MatterSim: {path}: it has no file of a viewpoint's objects")
        else:
            read = _bundled_objects if path.endswith(".npz") else _read_objects
            self._records = read(path)

    def visible_from(self, scanId: str, viewpointId: str) -> List[Candidate]:
        """Return the objects that are visible from a viewpoint, by id; of others, none.

        Raises ValueError if the objects of a viewpoint have not the fields of the released files.
        """
        key = f"{scanId}_{viewpointId}"
        if self._is_folder and key not in self._records:
            file = os.path.join(self._path, key + ".json")
            content = _read_objects(file) if os.path.isfile(file) else {}
            self._records[key] = content.get(viewpointId, {})
        try:
            listed = [_candidate(*each) for each in self._records.get(key, {}).items()]
        except (AttributeError, KeyError, TypeError, ValueError):
            raise ValueError(
                f"MatterSim: {self._path}: an object of {key} has not an id, and as many bbox2d as "
                "visible_pos"
            ) from None
        return sorted(each for each in listed if each.visible_pos)


def _candidate(name: str, record: Dict[str, Any]) -> Candidate:
    views, boxes = record["visible_pos"], record["bbox2d"]
    if len(views) != len(boxes):
        raise ValueError
    return Candidate(int(name), record.get("name", ""), list(views), list(map(list, boxes)))


def _read_objects(file: str) -> Dict[str, Any]:
    try:
        with open(file, encoding="utf-8") as opened:
            content = json.load(opened)
    except OSError:
        raise ValueError(f"MatterSim: Could not open objects at: {file}") from None
    except ValueError as error:
        raise ValueError(f"MatterSim: {file}: {error}") from None
    if not isinstance(content, dict):
        raise ValueError(f"MatterSim: {file}: it is not an object with a key for each viewpoint")
    return content


def _bundled_objects(file: str) -> Dict[str, Any]:
    """Return what a bundle has, in the form of the released files."""
    try:
        # numpy leaves a damaged file open that it opened itself.
        with open(file, "rb") as opened, np.load(opened) as bundle:
            ids, scans = bundle["viewpoint_id"], bundle["scan_id"][bundle["viewpoint_scan"]]
            viewpoints = bundle["candidate_viewpoint"].tolist()
            objects = bundle["candidate_object"].tolist()
            names = [""] * len(objects)
            if "text/candidate_category" in bundle:
                names = json.loads(bundle["text/candidate_category"].tobytes().decode())
            boxes = [bundle[name].tolist() for name in ("box_candidate", "box_view", "box_xywh")]
    except OSError:
        raise ValueError(f"MatterSim: Could not open objects at: {file}") from None
    except (EOFError, KeyError, RuntimeError, ValueError, zipfile.BadZipFile, zlib.error):
        raise ValueError(f"MatterSim: {file}: it is not a bundle with the solution") from None
    records = [{"name": name, "visible_pos": [], "bbox2d": []} for name in names]
    for candidate, view, box in zip(*boxes):
        records[candidate]["visible_pos"].append(view)
        records[candidate]["bbox2d"].append(box)
    found: Dict[str, Any] = {}
    for viewpoint, number, record in zip(viewpoints, objects, records):
        key = f"{scans[viewpoint]}_{ids[viewpoint]}"
        found.setdefault(key, {})[number] = record
    return found


# Arguments, with the types that the original takes. Others raise TypeError.


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"MatterSim: expected a string, not {value!r}")
    return str(value)


def _number(value: Any) -> float:
    if isinstance(value, (str, bytes)):
        raise TypeError(f"MatterSim: expected a number, not {value!r}")
    return float(value)


def _count(value: Any) -> int:
    number = operator.index(value)
    if number < 0:
        raise TypeError(f"MatterSim: expected a number from 0, not {value!r}")
    return number


def _list(convert: Callable[[Any], Any], values: Any) -> List[Any]:
    is_list = hasattr(values, "__getitem__") and hasattr(values, "__len__")
    if not is_list or isinstance(values, (str, bytes, dict)):
        raise TypeError(
            f"MatterSim: expected a list with a value for each agent, not {values!r}; after init, "
            "which is not initialize, there is one agent, and there are no lists"
        )
    return [convert(value) for value in values]


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)
