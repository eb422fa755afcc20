"""Hints about valid submissions that are probably not what their authors meant.

:func:`submission_hints` needs the file alone. :func:`answer_hints` compares what is predicted with
the annotated objects that the agent sees, whichever of them is the target.
"""

from collections.abc import Iterator
from operator import itemgetter

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.geometry import HEIGHT, N_HEADINGS, N_VIEWS, WIDTH, snap
from reverie_eval.ground_truth import CandidateBoxes, GroundTruth
from reverie_eval.metrics import ABSTAINED, box_match
from reverie_eval.submissions._answers import ENOUGH_BOXES
from reverie_eval.submissions._predictions import MOST, BoxAnswers, Predictions, SubmissionColumns
from reverie_eval.text import first_few, printable

# Letters of a field's name that are shown.
_LONGEST = 40
_MOST_FIELDS = 8
# The share of predicted objects that must be visible where the agents stop; below it, the ids
# probably mean something else, or are in another order: agents choose among what they see.
_FEW = 0.25

UNNAMED_ANSWERS = (
    "no record has predObjId or predBox; if one of these fields is the predicted object, rename it "
    "to predObjId"
)
"""About a file without answers whose records have fields that are not read."""


def submission_hints(
    predictions: Predictions, submission: SubmissionColumns, *, answers_only: bool
) -> Iterator[str]:
    """Yield hints that do not depend on the solution, a sentence each.

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


def answer_hints(submission: SubmissionColumns, ground_truth: GroundTruth) -> Iterator[str]:
    """Yield hints that depend on the annotated objects, if the ground truth has the solution."""
    if ground_truth.solution is None:
        return
    boxes, stop = submission.boxes, submission.stop
    yield from _reading_hints(boxes, stop[boxes.row], ground_truth.solution.boxes)
    predicted = submission.predicted_object != ABSTAINED
    # In a file that answers mostly by box, the few object ids that are left say too little.
    if predicted.sum() <= len(boxes.row):
        return
    is_candidate = ground_truth.solution.is_visible(submission.predicted_object, stop)
    seen, count = int(is_candidate[predicted].sum()), int(predicted.sum())
    if seen >= _FEW * count:
        return
    found = "no predicted object is visible where its agent stops"
    if seen:
        found = f"of {count:,} predicted objects, only {seen:,} can be seen where the agent stops"
    yield f"{found}; object ids are those of the box files, numbered within each building"


# More boxes are not compared with the annotation.
_SAMPLE = 500
# Pixels: the largest square that vision models usually take. Of the annotated boxes of val_unseen,
# five in six reach beyond its right or lower edge.
_SMALL_IMAGE = 384
# Share of the boxes by which another reading must fit better than the one that was used.
_BETTER = 0.25


def box_hints(boxes: BoxAnswers) -> Iterator[str]:
    """Yield hints that need nothing but the boxes, a sentence each."""
    x, y, width, height = boxes.xywh.T
    right, lower = x + width, y + height
    # Corners in fractions, read as width and height, reach up to 2.
    if (np.maximum(right, lower) <= 2).mean() > MOST:
        yield (
            "most boxes lie within two pixels of the upper left corner; if they are fractions of "
            'the image, add "predImageSize": [1, 1]; predBox is [x, y, width, height], not two '
            "corners"
        )
    elif len(boxes.row) >= ENOUGH_BOXES and max(right.max(), lower.max()) <= _SMALL_IMAGE:
        yield (
            f"no box reaches beyond {max(right.max(), lower.max()):.0f} pixels of an image of "
            f"{WIDTH} x {HEIGHT}; if the images were smaller, give their size in predImageSize"
        )
    if boxes.is_cut.mean() > MOST:
        yield (
            "most boxes reach beyond the image; predBox is [x, y, width, height], not two "
            "corners, in an image of 640 x 480 unless predImageSize says otherwise"
        )
    view = boxes.view
    if len(boxes.row) >= ENOUGH_BOXES and (view == view[0]).all():
        yield (
            f"all {len(boxes.row):,} boxes are in view {view[0]}; predView is the view that "
            "the box is in, and without it the last pose has to look there"
        )


def _reading_hints(
    boxes: BoxAnswers, viewpoint: IntArray, annotated: CandidateBoxes
) -> Iterator[str]:
    """Yield a hint if the boxes fit annotated objects much better when they are read otherwise.

    ``viewpoint``, shape (n_boxes,), is where the agents stop. Which of the annotated objects are
    targets is not looked at.
    """
    if len(boxes.row) < ENOUGH_BOXES:
        return
    # Spread over the file, whose records may be sorted by building.
    count = len(boxes.row)
    sample = np.linspace(0, count - 1, min(count, _SAMPLE)).astype(np.int64)
    boxes, viewpoint = boxes.take(sample), viewpoint[sample]
    xywh, view = boxes.uncut_xywh, boxes.view
    pairs = annotated.pair_with_all(viewpoint, view)
    as_given = _fits(xywh, pairs, annotated).mean()
    if as_given + _BETTER >= 1:
        return  # no other reading fits so much better
    views = _other_views(view)
    if np.isfinite(boxes.stop_angles).all():
        views["boxes in the view of the last pose"] = snap(boxes.stop_angles)
    others = dict(_other_boxes(xywh))
    # Other boxes are compared with the same annotated ones, so they are paired with them once.
    index, row = pairs
    steps = len(view) * np.arange(len(others))[:, None]
    as_boxes = (index + steps).ravel(), np.tile(row, len(others))
    as_views = annotated.pair_with_all(np.tile(viewpoint, len(views)), np.hstack([*views.values()]))
    fits = [
        _fits(np.vstack([*others.values()]), as_boxes, annotated),
        _fits(np.tile(xywh, (len(views), 1)), as_views, annotated),
    ]
    shares = np.concatenate(fits).reshape(-1, len(view)).mean(axis=1).tolist()
    share, what = max(zip(shares, [*others, *views], strict=True), key=itemgetter(0))
    if share > max(MOST, as_given + _BETTER):
        yield (
            f"{100 * as_given:.0f} % of the boxes fit an annotated object; read as {what}, "
            f"{100 * share:.0f} % would; predBox is [x, y, width, height] in the image of "
            "predView"
        )


def _fits(
    xywh: FloatArray, pairs: tuple[IntArray, IntArray], annotated: CandidateBoxes
) -> BoolArray:
    """Whether each box fits some object that it is paired with."""
    index, row = pairs
    # Corners read as [x, y, width, height], or the other way round, may give sides below 0.
    has_area = np.logical_and(*(xywh[:, 2:] > 0).T)[index]
    index, row = index[has_area], row[has_area]
    fits = box_match(xywh.take(index, axis=0), annotated.xywh.take(row, axis=0))
    return np.bincount(index, weights=fits, minlength=len(xywh)) > 0


def _other_boxes(xywh: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield boxes as they would be if they were meant otherwise."""
    x, y, width, height = xywh.T
    boxes = {
        "[left, top, right, bottom]": (x, y, width - x, height - y),
        "[centre x, centre y, width, height]": (x - width / 2, y - height / 2, width, height),
        "[y, x, height, width]": (y, x, height, width),
        "x measured from the right edge": (WIDTH - x - width, y, width, height),
        "y measured from the lower edge": (x, HEIGHT - y - height, width, height),
    }
    for what, columns in boxes.items():
        yield what, np.column_stack(columns)
    # What vision models scale images to; some language models give boxes in thousandths of a side.
    for side in (224, 336, 384, 1000):
        scaled = xywh * np.array([WIDTH, HEIGHT, WIDTH, HEIGHT]) / side
        yield f"boxes of {side} x {side} images", scaled


def _other_views(view: IntArray) -> dict[str, IntArray]:
    """Return views as they would be if they were meant otherwise."""
    row, column = np.divmod(view, N_HEADINGS)
    return {
        "views counted from 1": (view - 1) % N_VIEWS,
        "views one too low": (view + 1) % N_VIEWS,
        "views whose first row looks up": (2 - row) * N_HEADINGS + column,
    }
