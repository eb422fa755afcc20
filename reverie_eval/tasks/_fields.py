"""The fields of a result's records: their names, what they hold, and how people write them."""

from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta

from reverie_eval.arrays import LARGEST_OBJECT_ID
from reverie_eval.geometry import N_VIEWS
from reverie_eval.metrics import ABSTAINED


@dataclass(frozen=True, kw_only=True)
class Field:
    """A field of a record, or of a trajectory within it."""

    name: str
    """The official name."""
    also: tuple[str, ...] = ()
    """Other names by which codebases write the field; they are read without a word."""
    spellings: tuple[str, ...] = ()
    """Names that mean the field and are reported as misspelt, in lower case and without marks."""
    type: Any
    """What the field holds in the official form, with a description for the published JSON
    Schema."""
    default: Any = ...
    """What a record without the field means; by default the field is required."""

    @property
    def names(self) -> tuple[str, ...]:
        """All names that are read, the official one first."""
        return (self.name, *self.also)


ID_PREFIX = "reverie_"
"""NaviLLM mixes datasets and writes this before the ids; it is not part of them."""
ITEM_MARK = "#"
"""Between the id of an item and the index of the start, in the id of an episode."""

_EXTENT = Annotated[float, Meta(gt=0)]
_SIDE = Annotated[float, Meta(ge=1)]

INSTR_ID = Field(
    name="instr_id",
    spellings=("instrid", "instructionid", "instid", "instridx", "instidx", "episodeid", "id"),
    type=Annotated[
        str,
        Meta(
            description="The episode: the item's id, an underscore, the instruction's index from 0."
        ),
    ],
)
TRAJECTORY = Field(
    name="trajectory",
    spellings=("trajectory", "path", "predpath", "traj", "predtrajectory", "predtraj"),
    type=Annotated[
        list[tuple[str, float, float]],
        Meta(
            min_length=1,
            description="The agent's poses from the episode's start to its stop: viewpoint id, "
            "heading and elevation in radians.",
        ),
    ],
)
OBJECT = Field(
    name="predObjId",
    also=("pred_objid", "pred_obj_id"),  # DUET's, and an older spelling
    spellings=(
        *("predobjid", "predobj", "predobject", "predobjectid", "predictedobjid"),
        *("predictedobject", "predictedobjectid", "objid", "objectid", "predid", "pred"),
        "prediction",
    ),
    type=Annotated[
        int,
        Meta(
            ge=ABSTAINED,
            le=LARGEST_OBJECT_ID,
            description="The predicted object, by its id within the building; -1 for none.",
        ),
    ],
    default=ABSTAINED,
)
BOX = Field(
    name="predBox",
    spellings=("predbox", "predbbox", "predictedbox", "predictedbbox", "bbox", "box"),
    type=Annotated[
        tuple[float, float, _EXTENT, _EXTENT] | None,
        Meta(
            description="Instead of predObjId: left, top, width and height of a box around the "
            "target, in pixels."
        ),
    ],
    default=None,
)
VIEW = Field(
    name="predView",
    spellings=(
        *("predview", "predviewid", "predviewindex", "predviewidx", "viewindex", "viewid"),
        *("view", "viewidx", "pointid"),
    ),
    type=Annotated[
        Annotated[int, Meta(ge=0, lt=N_VIEWS)] | None,
        Meta(
            description="The index of the view that predBox is in; without it, the camera of the "
            "last pose."
        ),
    ],
    default=None,
)
IMAGE_SIZE = Field(
    name="predImageSize",
    spellings=("predimagesize", "predimgsize", "imagesize", "imgsize"),
    type=Annotated[
        tuple[_SIDE, _SIDE] | None,
        Meta(description="Width and height of the image of predBox, if not 640 x 480."),
    ],
    default=None,
)
HEADING = Field(
    name="obj_heading",
    spellings=("objheading", "objectheading", "predheading", "predobjheading", "heading"),
    type=float | None,
)
ELEVATION = Field(
    name="obj_elevation",
    spellings=(
        *("objelevation", "objectelevation", "predelevation", "predobjelevation", "elevation"),
    ),
    type=float | None,
)

ANSWER = (OBJECT, BOX, VIEW, IMAGE_SIZE)
"""The fields of an answer: an object's id, or a box with its view and the size of its image."""
POINT = (HEADING, ELEVATION)
"""The fields of a point, in each trajectory of an item."""
