"""The official result format, as :mod:`reverie_eval.conversion` writes it."""

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, model_validator

from reverie_eval.geometry import N_VIEWS
from reverie_eval.limits import LARGEST_OBJECT_ID

Pose = tuple[str, float, float]
"""Viewpoint id, heading and elevation in radians."""

Extent = Annotated[float, Field(gt=0)]
ImageSide = Annotated[float, Field(ge=1)]


class Prediction(BaseModel):
    """What an agent did in one episode."""

    model_config = ConfigDict(
        frozen=True,
        use_attribute_docstrings=True,
        extra="ignore",
        allow_inf_nan=False,
        json_schema_extra={
            "anyOf": [{"required": ["predObjId"]}, {"required": ["predBox"]}],
            "not": {
                "required": ["predObjId", "predBox"],
                "properties": {"predObjId": {"minimum": 0}, "predBox": {"type": "array"}},
            },
        },
    )

    instr_id: str
    """The episode: the task's id, an underscore, the instruction's number counted from 0."""
    trajectory: Annotated[list[Pose], Field(min_length=1)]
    """The agent's poses from the episode's start to its stop."""
    predObjId: Annotated[int, Field(ge=-1, le=LARGEST_OBJECT_ID)] = -1  # noqa: N815  # the published name
    """The object that the agent names, by its id within the building; -1 where it names none."""
    predBox: tuple[float, float, Extent, Extent] | None = None  # noqa: N815
    """In place of predObjId: left, top, width and height of a box around the target, in pixels."""
    predView: Annotated[int, Field(ge=0, lt=N_VIEWS)] | None = None  # noqa: N815
    """The view that predBox is drawn in, 0 to 35; without it the camera of the last pose."""
    predImageSize: tuple[ImageSide, ImageSide] | None = None  # noqa: N815
    """Width and height of the picture that predBox is drawn in, if not 640 x 480."""

    @model_validator(mode="after")
    def _one_answer(self) -> Self:
        if not self.model_fields_set & {"predObjId", "predBox"}:
            raise ValueError("an episode has an answer: predObjId or predBox")
        if self.predBox is not None and self.predObjId != -1:
            raise ValueError("an episode has one answer: predObjId or predBox")
        return self


SUBMISSION = TypeAdapter(list[Prediction])
"""A submission: one prediction for every episode of a split, in any order."""
