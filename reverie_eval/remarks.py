"""Remarks on submissions that are sound, and perhaps not what was meant."""

from collections.abc import Iterator

import numpy as np

from reverie_eval.alignment import AlignedSubmission
from reverie_eval.arrays import last_of
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading import BoxAnswers, Predictions

_SUSPICIOUS_SHARE = 0.5
"""Of answers or headings; a sound submission stays far below it."""


def how_it_was_read(predictions: Predictions) -> Iterator[str]:
    """Say what was read although it is not the official form."""
    if predictions.read_as:
        yield f"read as: {'; '.join(predictions.read_as)}"


def about_answers(submission: AlignedSubmission) -> Iterator[str]:
    """Say what in sound answers will cost points, a sentence each, whatever the right ones are."""
    if submission.abstained.all():
        yield "no answer names an object: RGS will be 0"
    if submission.boxes.row.size:
        yield from _about_boxes(submission.boxes)
    if (submission.predicted_object == 0).mean() > _SUSPICIOUS_SHARE:
        yield (
            "most answers name object 0, which is an object like any other; write -1 where the "
            "agent names none"
        )


def about_candidates(submission: AlignedSubmission, ground_truth: GroundTruth) -> Iterator[str]:
    """Say what in sound answers will cost points because of what is visible, if that is known."""
    named = submission.predicted_object != ABSTAINED
    if ground_truth.answers is None or named.sum() <= len(submission.boxes.row):
        return
    stop = submission.viewpoint[last_of(submission.offsets)]
    is_candidate = ground_truth.answers.is_visible(submission.predicted_object, stop)
    if not is_candidate[named].any():
        yield (
            "no answer is among the objects visible where its agent stops; ids are those of "
            "the box files, numbered within each building"
        )


def _about_boxes(boxes: BoxAnswers) -> Iterator[str]:
    x, y, width, height = boxes.xywh.T
    if (np.maximum(x + width, y + height) <= 1).mean() > _SUSPICIOUS_SHARE:
        yield (
            "most boxes lie within one pixel of the upper left corner; for fractions of the "
            'picture add "predImageSize": [1, 1]'
        )
    if boxes.is_cut.mean() > _SUSPICIOUS_SHARE:
        yield (
            "most boxes reach beyond the picture; predBox is [x, y, width, height], not two "
            "corners, in a picture of 640 x 480 unless predImageSize says otherwise"
        )


def about_trajectories(predictions: Predictions, submission: AlignedSubmission) -> Iterator[str]:
    """Say what in sound trajectories was probably not meant, a sentence each."""
    if (np.diff(submission.offsets) == 1).all():
        yield "every trajectory has a single pose: no agent moves"
    if (np.abs(predictions.stop_angles) > 2 * np.pi).any(axis=1).mean() > _SUSPICIOUS_SHARE:
        yield "most headings or elevations are beyond a full turn: angles are radians, not degrees"
