"""The official result format, as :mod:`reverie_eval.conversion` writes it."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

Pose = tuple[str, float, float]
"""Viewpoint id, heading and elevation in radians."""


class Prediction(BaseModel):
    """What an agent did in one episode."""

    model_config = ConfigDict(
        frozen=True, use_attribute_docstrings=True, extra="ignore", allow_inf_nan=False
    )

    instr_id: str
    """The episode: the task's id, an underscore, the instruction's number counted from 0."""
    trajectory: Annotated[list[Pose], Field(min_length=1)]
    """The agent's poses from the episode's start to its stop."""
    predObjId: Annotated[int, Field(ge=-1, lt=2**31)]  # noqa: N815  # the published name
    """The object that the agent names, by its id within the building; -1 where it names none."""


SUBMISSION = TypeAdapter(list[Prediction])
"""A submission: one prediction for every episode of a split, in any order."""
