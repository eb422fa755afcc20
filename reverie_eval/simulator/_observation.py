"""What an agent observes, with the pictures that skyboxes show, and what it can do."""

from base64 import b64encode
from dataclasses import dataclass, field, replace
from functools import cache
from io import BytesIO
from typing import Any, Generic, Literal, NamedTuple, TypeAlias, TypeVar, overload

import numpy as np

from reverie_eval.arrays import Array, FloatArray
from reverie_eval.errors import ReverieEvalError, naming_missing_parts
from reverie_eval.geometry import FIELD_OF_VIEW, HEIGHT, WIDTH, view_angles
from reverie_eval.simulator.on_path.MatterSim import _blended, _packed, _Renderer, _sight_of

Part: TypeAlias = Literal["instruction", "geometry", "names", "boxes", "pictures"]
"""A part of an observation of which it is noted whether the agent read it."""

T = TypeVar("T")


class Notes(set[Part]):
    """The parts that were read; copies of observations note in the same place."""

    def __deepcopy__(self, memo: dict[int, Any]) -> "Notes":
        return self


class _Noted(Generic[T]):
    """A field of a dataclass that notes when it is read: also by ``repr`` and ``==``."""

    def __init__(self, part: Part) -> None:
        self._part = part

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, of: None, owner: type) -> "_Noted[T]": ...

    @overload
    def __get__(self, of: object, owner: type) -> T: ...

    def __get__(self, of: Any, owner: type) -> "_Noted[T] | T":
        if of is None:  # the dataclass asks for a default
            raise AttributeError(self._name)
        of.notes.add(self._part)
        value: T = vars(of)[self._name]
        return value

    def __set__(self, of: object, value: T) -> None:
        vars(of)[self._name] = value


class Box(NamedTuple):
    """An annotated box in one of the 36 views."""

    view: int
    """0 to 35."""
    xywh: tuple[int, int, int, int]
    """Left, top, width and height in pixels of the 640 x 480 view."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """An object that is visible from the agent's viewpoint, in any direction."""

    object_id: int
    """Within the building."""
    name: _Noted[str] = _Noted("names")
    """The object's annotated category; empty if there is none."""
    boxes: _Noted[tuple[Box, ...]] = _Noted("boxes")
    """One for each view that shows it."""
    notes: Notes = field(repr=False, compare=False)


@dataclass(frozen=True, kw_only=True)
class Neighbour:
    """A viewpoint to which the agent can go."""

    viewpoint_id: str
    """The viewpoint."""
    relative_heading: _Noted[float] = _Noted("geometry")
    """Radians to the right of the agent's heading, in [-pi, pi]."""
    relative_elevation: _Noted[float] = _Noted("geometry")
    """Radians above the agent's elevation."""
    distance: _Noted[float] = _Noted("geometry")
    """Metres."""
    view: _Noted[int] = _Noted("geometry")
    """The view of the 36 in which it appears nearest to the centre."""
    notes: Notes = field(repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture that is rendered when an agent asks for it."""

    skybox: str | None
    """The file; None if the environment was given no pictures."""
    rotation: FloatArray
    """Shape (3, 3), from the skybox's frame to the building's."""
    heading: float
    """Radians."""
    elevation: float
    """Radians."""

    def render(self) -> Array:
        """Return the picture, or raise what :meth:`Observation.image` raises."""
        if self.skybox is None:
            raise ReverieEvalError("no pictures here; Environment(..., pictures=folder) has them")
        sight = _renderer().look(self.rotation, self.heading, self.elevation)
        return _renderer().colours(self.skybox, sight)[..., ::-1]  # not blue first


@cache
def _renderer() -> _Renderer:
    return _Renderer(WIDTH, HEIGHT, FIELD_OF_VIEW)


def jpeg_url(pixels: Array, quality: int) -> str:
    """Return a picture, shape (height, width, 3), red first, as the ``data:`` URL of a JPEG.

    Raises MissingPartError if Pillow is not installed.
    """
    with naming_missing_parts():
        from PIL import Image

    file = BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return f"data:image/jpeg;base64,{b64encode(file.getvalue()).decode()}"


def colours_of_skybox(strip: Array, direction: FloatArray) -> Array:
    """Return the colours that a skybox shows in each direction, as ``MatterSim`` blends them.

    Parameters
    ----------
    strip : uint8 array of shape (size, 6 * size, 3)
        The six faces beside each other, red first.
    direction : float array of shape (..., 3)
        In the frame of the skybox's camera: right, down, forward.

    Returns
    -------
    uint8 array of shape (..., 3)
        Red first.
    """
    # The axes of the cube map are opposite to those of the camera.
    x, y, z = -direction.reshape(-1, 3).T
    return _blended(_packed(strip), _sight_of(x, y, z))[:, ::-1].reshape(direction.shape)


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What an agent observes. It has no id of the episode, because REVERIE's contain the target's.

    The values are frozen: later steps do not change them.
    """

    instruction: _Noted[str] = _Noted("instruction")
    language: str
    """The language of the instruction, such as ``en-US``; empty in a task of one language."""
    scan_id: str
    """The building."""
    viewpoint_id: str
    """The place in it where the agent is."""
    heading: float
    """Radians from the building's y axis towards its x axis, in [0, 2 pi)."""
    elevation: float
    """Radians above the horizon."""
    neighbours: tuple[Neighbour, ...]
    """The viewpoints to which one can move, in the order of the connectivity file."""
    candidates: tuple[Candidate, ...]
    """The visible objects by object id; empty if the environment was given no boxes."""
    is_over: bool
    """Whether the agent ended the episode."""
    picture: Picture = field(repr=False, compare=False)
    notes: Notes = field(repr=False, compare=False)

    def image(self, view: int | None = None) -> Array:
        """Return what the camera shows, or one of the 36 views from the same viewpoint.

        Returns
        -------
        uint8 array of shape (480, 640, 3)
            Red, green and blue.

        Raises
        ------
        ReverieEvalError
            If the environment was given no pictures.
        ValueError
            If there is no skybox of this viewpoint.
        """
        self.notes.add("pictures")
        picture = self.picture
        if view is not None:
            heading, elevation = view_angles(np.array([view]))[0].tolist()
            picture = replace(picture, heading=heading, elevation=elevation)
        return picture.render()


@dataclass(frozen=True, slots=True)
class Go:
    """Go to a neighbour, and face the direction of travel."""

    viewpoint_id: str
    """The neighbour."""


@dataclass(frozen=True, slots=True)
class Turn:
    """Face a direction, in radians as the observation has it; the last pose has it then."""

    heading: float
    """Radians; any number of turns."""
    elevation: float = 0.0
    """Radians, in [-pi / 2, pi / 2]."""


@dataclass(frozen=True, slots=True)
class Stop:
    """End the episode without an answer."""


@dataclass(frozen=True, slots=True)
class Answer:
    """End the episode, and predict an object."""

    object_id: int
    """The object: one of the candidates, if the environment was given boxes."""


@dataclass(frozen=True, slots=True)
class AnswerBox:
    """End the episode, and predict a box in one of the 36 views."""

    view: int
    """0 to 35."""
    xywh: tuple[float, float, float, float]
    """Left, top, width and height in pixels of the 640 x 480 view."""


@dataclass(frozen=True, slots=True)
class Point:
    """End the episode, and point in a direction in which the target is: the answer of SOON."""

    heading: float
    """Radians."""
    elevation: float
    """Radians."""


Action: TypeAlias = Go | Turn | Stop | Answer | AnswerBox | Point
