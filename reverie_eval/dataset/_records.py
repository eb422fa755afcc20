"""The records of the dataset's published files: annotations, navigation graphs and boxes."""

import re
from typing import Annotated, Any, NamedTuple

import msgspec
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, TypeAdapter

from reverie_eval.arrays import INT32_END, LARGEST_OBJECT_ID
from reverie_eval.tasks import Annotation

FARTHEST = 1e6
"""Largest coordinate and half extent, metres. No building is that large, though coordinates in the
frame of a map may come near. A larger number was misread, and its square might overflow."""

_OBJECT_KEY = re.compile(r"0|[1-9]\d{0,9}", re.ASCII)


def object_key(text: str) -> str:
    """Return the key of a JSON object if it is an object id.

    Raises
    ------
    ValueError
        If it is not, or has a sign or leading zeros, which the published files do not write.
    """
    if _OBJECT_KEY.fullmatch(text) and int(text) <= LARGEST_OBJECT_ID:
        return text
    raise ValueError(f"expected an object id, a whole number from 0 to {LARGEST_OBJECT_ID:,}")


class ViewpointKey(NamedTuple):
    """A viewpoint of a scan."""

    scan_id: str
    viewpoint_id: str

    def __str__(self) -> str:
        return "_".join(self)


ObjectKey = Annotated[str, AfterValidator(object_key)]
Metres = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
Position = tuple[Metres, Metres, Metres]
"""A position in the scan's own frame: x, y, and z up."""


def viewpoints_of(annotation: Annotation) -> list[ViewpointKey]:
    """Return the viewpoints of the annotated path, the start first and the goal last."""
    return [ViewpointKey(annotation.scan, viewpoint_id) for viewpoint_id in annotation.reference]


def mentioned_by(annotation: Annotation) -> set[ViewpointKey]:
    """Return all viewpoints that an annotation names, of every path and of the goals."""
    paths = [annotation.reference, *annotation.further_paths.values(), annotation.goals]
    return {ViewpointKey(annotation.scan, viewpoint_id) for path in paths for viewpoint_id in path}


def target_of(annotation: Annotation) -> int:
    """Return the target object of an annotation that has one."""
    if annotation.target is None:
        raise ValueError(f"annotation {annotation.name} has no target")
    return annotation.target


class _Published(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Viewpoint(_Published):
    """One record of ``{scan}_connectivity.json``."""

    image_id: Annotated[str, StringConstraints(pattern=r"^[^/\\]+$")]
    """Part of the names of files."""
    pose: Annotated[list[Metres], Field(min_length=16, max_length=16)]
    """Row-major 4 x 4 matrix from the camera's frame to the scan's. Its last column, elements 3, 7
    and 11, is the camera's position in metres."""
    included: bool
    unobstructed: list[bool]
    """Which viewpoints of the same file an agent can walk to from here."""

    @property
    def position(self) -> Position:
        """The camera's position in the scan's frame, metres."""
        return self.pose[3], self.pose[7], self.pose[11]


_Number = Annotated[int, msgspec.Meta(ge=-INT32_END, lt=INT32_END)]


class ObjectRecord(msgspec.Struct, frozen=True):
    """An object listed at a viewpoint. Only types are checked here; rules check the values."""

    visible_pos: list[_Number]
    """The views that show the object. If empty, the object is listed but not visible."""
    bbox2d: list[tuple[_Number, _Number, _Number, _Number]]
    """Left, top, width, height in pixels, in the order of the views."""
    name: str = ""


ANNOTATIONS = TypeAdapter(Annotated[list[Any], Field(min_length=1)])
"""An annotation file, whose records are read one by one as the task's annotations."""
CONNECTIVITY = TypeAdapter(list[Viewpoint])
BOXES = TypeAdapter(dict[str, dict[str, Any]])
"""A file of the ``BBox`` folder (key: viewpoint) or ``BBoxes.json`` (key: ``scan_viewpoint``); its
entries are read one by one as :class:`ObjectRecord`."""
OBJECT_POSITIONS = TypeAdapter(dict[str, dict[ObjectKey, Position]])
"""``objpos.json``: the centre of every object by scan and object id."""
