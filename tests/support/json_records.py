"""Records as JSON text, and what reading makes of them in a form that compares."""

import json
from dataclasses import fields
from typing import NamedTuple

from reverie_eval import Problem, SubmissionError
from reverie_eval.submissions import (
    Predictions,
    Submission,
    read_predictions,
)

RIGHT = {"instr_id": '"7_1_0"', "trajectory": '[["hall", 1.5, 0]]', "predObjId": "3"}


class Columns(NamedTuple):
    """Everything that predictions say, in a form that compares."""

    instr_ids: list[str | None]
    viewpoint_ids: list[str | None]
    offsets: list[int]
    predicted_object: list[int]
    has_degrees: bool


def record(**fields: str) -> str:
    """Return the text of a right record, with other texts for some of its fields."""
    return "{" + ", ".join(f'"{name}": {text}' for name, text in (RIGHT | fields).items()) + "}"


def without(field: str) -> str:
    """Return the text of a record that lacks a field."""
    return json.dumps({name: json.loads(text) for name, text in RIGHT.items() if name != field})


def ending_in(pose: str) -> str:
    """Return the text of a record whose trajectory ends in this pose."""
    return record(trajectory=f'[["hall", 1.5, 0], {pose}]')


def document(*records: str) -> bytes:
    """Return the content of a file with these records."""
    return f"[{', '.join(records)}]".encode()


def problems_of(submission: Submission) -> tuple[Problem, ...]:
    """Return what reading finds, in the order in which it is told."""
    try:
        return SubmissionError(read_predictions(submission).problems).problems
    except SubmissionError as error:
        return error.problems


def columns_of(predictions: Predictions) -> Columns:
    """Return the columns of predictions."""
    return Columns(
        list(predictions.instr_ids),
        list(predictions.viewpoint_ids),
        predictions.offsets.tolist(),
        predictions.predicted_object.tolist(),
        predictions.has_degrees,
    )


def hops_of(predictions: Predictions) -> list[bool]:
    """Return whether each pose continues a hop."""
    if predictions.continues_hop is None:
        return [False] * len(predictions.viewpoint_ids)
    return list(predictions.continues_hop)


def boxes_of(predictions: Predictions) -> list[tuple[object, ...]]:
    """Return the boxes of predictions, each with all that is known of it; NaN as text."""
    boxes = predictions.boxes
    columns = (getattr(boxes, field.name).tolist() for field in fields(boxes))
    return [tuple(map(str, each)) for each in zip(*columns, strict=True)]


def places_of(predictions: Predictions) -> list[tuple[str, list[tuple[int, ...]]]]:
    """Return where each record is in its file, and where its poses are in its trajectory."""
    return [
        (
            str(predictions.location(row)),
            [
                predictions.pose_location(row, pose)
                for pose in range(*predictions.offsets[row : row + 2].tolist())
            ],
        )
        for row in range(len(predictions.instr_ids))
    ]
