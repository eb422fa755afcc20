"""Hints about valid submissions that are probably not what their authors meant."""

from collections.abc import Iterator

import numpy as np

from reverie_eval.arrays import FloatArray, last_of
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions._alignment import AlignedSubmission
from reverie_eval.submissions._box_hints import box_hints, reading_hints
from reverie_eval.submissions._predictions import MOST, Predictions
from reverie_eval.text import first_few, printable

_LONGEST = 40
"""Letters of a field's name that are shown."""
_MOST_FIELDS = 8
_FEW = 0.25
"""If a smaller share of the predicted objects is visible where the agents stop, the ids probably
mean something else, or are in another order: agents choose among what they see."""

UNNAMED_ANSWERS = (
    "no record has predObjId or predBox; if one of these fields is the predicted object, rename it "
    "to predObjId"
)
"""About a file without answers whose records have fields that are not read."""


def submission_hints(
    predictions: Predictions, submission: AlignedSubmission, *, answers_only: bool
) -> Iterator[str]:
    """Yield hints that do not depend on the correct answers, a sentence each.

    With ``answers_only``, trajectories were not read.
    """
    if predictions.read_as:
        yield f"read as: {'; '.join(predictions.read_as)}"
    if predictions.ignored_fields:
        fields = first_few(predictions.ignored_fields.items(), _MOST_FIELDS, _field_text)
        yield f"ignored fields: {fields}"
        if predictions.differences.get("navigation only"):
            yield UNNAMED_ANSWERS
    if submission.abstained.all() and not submission.is_navigation_only:
        yield "no answer predicts an object: RGS will be 0"
    yield from _point_hints(submission.point)
    if submission.boxes.row.size:
        yield from box_hints(submission.boxes)
    if (submission.predicted_object == 0).mean() > MOST:
        yield (
            "most answers predict object 0, which is an object like any other; write -1 where the "
            "agent predicts no object"
        )
    if answers_only:
        return
    if (np.diff(submission.offsets) == 1).all():
        yield "every trajectory has a single pose: no agent moves"
    if predictions.has_degrees:
        yield "most headings or elevations exceed a full turn: angles are radians, not degrees"


def _point_hints(point: FloatArray | None) -> Iterator[str]:
    if point is None:
        return
    has_point = ~np.isnan(point).any(axis=1)
    if not has_point.any():
        yield "no trajectory has a point: SFPL will be 0"
        return
    is_scaled = ((point >= 0) & (point <= 1)).all(axis=1)
    if (has_point & ~is_scaled).sum() > MOST * has_point.sum():
        yield (
            "most points are not within 0 and 1: obj_heading is heading / (2 pi), obj_elevation "
            "(elevation + pi) / (2 pi), of angles in radians"
        )


def _field_text(field: tuple[str, int]) -> str:
    name, count = field
    return f"{printable(str(name))[:_LONGEST]} ({count:,})"


def answer_hints(submission: AlignedSubmission, ground_truth: GroundTruth) -> Iterator[str]:
    """Yield hints that depend on the annotated objects, if the ground truth has answers."""
    if ground_truth.answers is None:
        return
    stop = submission.viewpoint[last_of(submission.offsets)]
    boxes = submission.boxes
    yield from reading_hints(boxes, stop[boxes.row], ground_truth.answers.boxes)
    predicted = submission.predicted_object != ABSTAINED
    # In a file that answers mostly by box, the few object ids that are left say too little.
    if predicted.sum() <= len(boxes.row):
        return
    is_candidate = ground_truth.answers.is_visible(submission.predicted_object, stop)
    seen, count = int(is_candidate[predicted].sum()), int(predicted.sum())
    if seen >= _FEW * count:
        return
    found = "no predicted object is visible where its agent stops"
    if seen:
        found = f"of {count:,} predicted objects, only {seen:,} can be seen where the agent stops"
    yield f"{found}; object ids are those of the box files, numbered within each building"
