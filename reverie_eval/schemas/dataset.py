"""The dataset's published files: annotations, navigation graphs and boxes."""

import re
from typing import Annotated, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    TypeAdapter,
    model_validator,
)

from reverie_eval.geometry import HEIGHT, N_VIEWS, WIDTH
from reverie_eval.limits import FARTHEST, LARGEST_OBJECT_ID

_OBJECT_KEY = re.compile(r"0|[1-9]\d{0,9}", re.ASCII)


def object_key(text: str) -> str:
    """Return the key of a JSON object if it is an object id.

    Raises
    ------
    ValueError
        If it is none, or not written as the published files do: without a sign or leading zeros.
    """
    if _OBJECT_KEY.fullmatch(text) and int(text) <= LARGEST_OBJECT_ID:
        return text
    raise ValueError(f"expected an object id, a whole number from 0 to {LARGEST_OBJECT_ID:,}")


Name = Annotated[str, StringConstraints(min_length=1)]
ObjectId = Annotated[int, Field(ge=0, le=LARGEST_OBJECT_ID, strict=True)]
ObjectKey = Annotated[str, AfterValidator(object_key)]
ViewIndex = Annotated[int, Field(ge=0, lt=N_VIEWS)]
Offset = Annotated[int, Field(ge=0)]
Extent = Annotated[int, Field(ge=1)]
Metres = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]

Position = tuple[Metres, Metres, Metres]
"""In the scan's own frame, z up."""


class _Published(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Task(_Published):
    """One record of ``REVERIE_{split}.json``: a path, a target and up to three instructions."""

    scan: Name
    id: Annotated[str, Field(coerce_numbers_to_str=True, min_length=1)]
    """The published id; episode ``k`` of the task is ``{id}_{k}``."""
    path: Annotated[list[Name], Field(min_length=1)]
    """Viewpoints of the annotated path. A public test file gives the start alone."""
    instructions: Annotated[list[str], Field(min_length=1)]
    objId: ObjectId | None = None  # noqa: N815  # the published name
    """The target object's id within the scan; absent from a public test file."""

    @property
    def instr_ids(self) -> list[str]:
        """The ids of the task's episodes, one per instruction."""
        return [f"{self.id}_{index}" for index in range(len(self.instructions))]


class Viewpoint(_Published):
    """One record of ``{scan}_connectivity.json``."""

    image_id: Annotated[str, StringConstraints(pattern=r"^[^/\\]+$")]
    """It is a part of the names of files."""
    pose: Annotated[list[Metres], Field(min_length=16, max_length=16)]
    """Row-major 4 x 4 camera-to-world matrix; metres in elements 3, 7 and 11."""
    included: bool
    unobstructed: list[bool]
    """Which viewpoints of the same file can be walked to from here."""

    @property
    def position(self) -> Position:
        """The camera's place in the world, in metres."""
        return self.pose[3], self.pose[7], self.pose[11]


class ObjectBoxes(_Published):
    """One object as seen from one viewpoint: a box in every view that shows it."""

    name: str = ""
    visible_pos: list[ViewIndex]
    """The views that show the object. Empty: listed, but not visible."""
    bbox2d: list[tuple[Offset, Offset, Extent, Extent]]
    """Left, top, width, height in pixels, in the order of the views; within the picture."""

    @model_validator(mode="after")
    def _one_box_per_view(self) -> Self:
        if len(self.visible_pos) != len(self.bbox2d):
            raise ValueError(f"views: {len(self.visible_pos)}, boxes: {len(self.bbox2d)}")
        if len(set(self.visible_pos)) < len(self.visible_pos):
            raise ValueError("two boxes in one view")
        return self

    @model_validator(mode="after")
    def _boxes_within_picture(self) -> Self:
        for left, top, width, height in self.bbox2d:
            if left + width > WIDTH or top + height > HEIGHT:
                box = [left, top, width, height]
                raise ValueError(f"{box} reaches beyond the {WIDTH} x {HEIGHT} picture")
        return self


ANNOTATIONS = TypeAdapter(Annotated[list[Task], Field(min_length=1)])
CONNECTIVITY = TypeAdapter(list[Viewpoint])
BOXES = TypeAdapter(dict[str, dict[ObjectKey, ObjectBoxes]])
"""A file of the ``BBox`` folder (key: viewpoint) or ``BBoxes.json`` (key: ``scan_viewpoint``)."""

OBJECT_POSITIONS = TypeAdapter(dict[str, dict[ObjectKey, Position]])
"""``objpos.json``: the centre of every object by scan and object id."""
