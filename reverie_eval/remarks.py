"""Remarks on submissions that are sound, and perhaps not what was meant."""

from collections.abc import Iterator

import numpy as np

from reverie_eval.alignment import AlignedSubmission
from reverie_eval.arrays import last_of
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading import Predictions

_SUSPICIOUS_SHARE = 0.5
"""Of answers or headings; a sound submission stays far below it."""


def how_it_was_read(predictions: Predictions) -> Iterator[str]:
    """Say what was read although it is not the official form."""
    if predictions.read_as:
        yield f"read as: {'; '.join(predictions.read_as)}"


def about_answers(submission: AlignedSubmission, ground_truth: GroundTruth) -> Iterator[str]:
    """Say what in sound answers will cost points, a sentence each."""
    named = submission.predicted_object != ABSTAINED
    if not named.any():
        yield "no answer names an object: RGS will be 0"
        return
    if (submission.predicted_object == 0).mean() > _SUSPICIOUS_SHARE:
        yield (
            "most answers name object 0, which is an object like any other; write -1 where the "
            "agent names none"
        )
    if ground_truth.answers is not None:
        stop = submission.viewpoint[last_of(submission.offsets)]
        is_candidate = ground_truth.answers.is_visible(submission.predicted_object, stop)
        if not is_candidate[named].any():
            yield (
                "no answer is among the objects visible where its agent stops; ids are those of "
                "the box files, numbered within each building"
            )


def about_trajectories(predictions: Predictions, submission: AlignedSubmission) -> Iterator[str]:
    """Say what in sound trajectories was probably not meant, a sentence each."""
    if (np.diff(submission.offsets) == 1).all():
        yield "every trajectory has a single pose: no agent moves"
    if (np.abs(predictions.stop_angles) > 2 * np.pi).any(axis=1).mean() > _SUSPICIOUS_SHARE:
        yield "most headings or elevations are beyond a full turn: angles are radians, not degrees"
