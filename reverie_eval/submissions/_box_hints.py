"""Predicted boxes that were probably not meant as they were read.

Boxes that can match nothing are problems, others give hints. Those of :func:`box_hints` need the
file alone. :func:`reading_hints` compares boxes with the annotated boxes of all objects in the same
view, whichever of them is the target.
"""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import TypeAlias

import numpy as np

from reverie_eval.arrays import FloatArray, IntArray
from reverie_eval.errors import Problem
from reverie_eval.geometry import HEIGHT, WIDTH, snap
from reverie_eval.geometry._views import N_HEADINGS
from reverie_eval.ground_truth import CandidateBoxes
from reverie_eval.metrics import box_match
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._predictions import MOST, BoxAnswers

_ENOUGH = 20
"""Fewer boxes say nothing about how they were meant."""
_SAMPLE = 500
"""More boxes are not compared with the annotation."""
_SMALL_IMAGE = 384
"""Pixels: the largest square that vision models usually take. Of the annotated boxes of val_unseen,
five in six reach beyond its right or lower edge."""
_TINY = 2
"""Pixels: fractions of an image reach no farther, as sides or as corners."""
_BETTER = 0.25
"""Share of the boxes by which another reading must fit better than the one that was used."""

_Drawn: TypeAlias = tuple[FloatArray, IntArray]
"""Boxes, shape (n, 4), and their views, shape (n,)."""


def box_scale_problems(boxes: BoxAnswers) -> Iterator[Problem]:
    """Yield a problem if most boxes cannot match anything, so that their scale must be wrong."""
    if len(boxes.row) < _ENOUGH:
        return
    is_outside = (boxes.xywh[:, 2:] == 0).any(axis=1)
    is_tiny = (boxes.uncut_xywh[:, 2:] <= _TINY).all(axis=1)
    for is_wrong, problem in (
        (is_outside, problems.boxes_outside),
        (is_tiny & ~is_outside, problems.tiny_boxes),
    ):
        if is_wrong.mean() > MOST:
            yield problem(int(is_wrong.sum()), len(is_wrong))


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
    elif len(boxes.row) >= _ENOUGH and max(right.max(), lower.max()) <= _SMALL_IMAGE:
        yield (
            f"no box reaches beyond {max(right.max(), lower.max()):.0f} pixels of an image of "
            f"{WIDTH} x {HEIGHT}; if the images were smaller, give their size in predImageSize"
        )
    if boxes.is_cut.mean() > MOST:
        yield (
            "most boxes reach beyond the image; predBox is [x, y, width, height], not two "
            "corners, in an image of 640 x 480 unless predImageSize says otherwise"
        )
    views = set(snap(boxes.camera).tolist())
    if len(boxes.row) >= _ENOUGH and len(views) == 1:
        yield (
            f"all {len(boxes.row):,} boxes are in view {views.pop()}; predView is the view that "
            "the box is in, and without it the last pose has to look there"
        )


def reading_hints(
    boxes: BoxAnswers, viewpoint: IntArray, annotated: CandidateBoxes
) -> Iterator[str]:
    """Yield a hint if the boxes fit annotated objects much better when they are read otherwise.

    ``viewpoint``, shape (n_boxes,), is where the agents stop. Which of the annotated objects are
    targets is not looked at.
    """
    if len(boxes.row) < _ENOUGH:
        return
    sample = np.unique(np.linspace(0, len(boxes.row) - 1, _SAMPLE).astype(np.int64))
    boxes, viewpoint = boxes.take(sample), viewpoint[sample]
    given = boxes.uncut_xywh, snap(boxes.camera)
    share = partial(_share_of_fits, viewpoint=viewpoint, annotated=annotated)
    as_given = share(given)
    readings = {what: share(read) for what, read in _other_readings(*given).items()}
    if np.isfinite(boxes.stop_angles).all():
        readings["boxes in the view of the last pose"] = share((given[0], snap(boxes.stop_angles)))
    what = max(readings, key=lambda each: readings[each])
    if readings[what] > max(MOST, as_given + _BETTER):
        yield (
            f"{100 * as_given:.0f} % of the boxes fit an annotated object; read as {what}, "
            f"{100 * readings[what]:.0f} % would; predBox is [x, y, width, height] in the image of "
            "predView"
        )


def _share_of_fits(drawn: _Drawn, viewpoint: IntArray, annotated: CandidateBoxes) -> float:
    """Return the share of boxes that would be correct for some object in their view."""
    xywh, view = drawn
    index, row = annotated.pair_with_all(viewpoint, view)
    has_area = (xywh[index, 2:] > 0).all(axis=1)
    index, row = index[has_area], row[has_area]
    fits = box_match(xywh[index], annotated.xywh[row])
    return float((np.bincount(index, weights=fits, minlength=len(view)) > 0).mean())


def _other_readings(xywh: FloatArray, view: IntArray) -> Mapping[str, _Drawn]:
    """Return boxes and their views as they would be if they were meant otherwise."""
    x, y, width, height = xywh.T
    boxes = {
        "[left, top, right, bottom]": (x, y, width - x, height - y),
        "[centre x, centre y, width, height]": (x - width / 2, y - height / 2, width, height),
        "[y, x, height, width]": (y, x, height, width),
        "x measured from the right edge": (WIDTH - x - width, y, width, height),
        "y measured from the lower edge": (x, HEIGHT - y - height, width, height),
    }
    for side in (224, 336, 384, 1000):
        scaled = xywh * np.array([WIDTH, HEIGHT, WIDTH, HEIGHT]) / side
        boxes[f"boxes of {side} x {side} images"] = tuple(scaled.T)
    row, column = np.divmod(view, N_HEADINGS)
    views = {
        "views counted from 1": (row, (column - 1) % N_HEADINGS),
        "views one too low": (row, (column + 1) % N_HEADINGS),
        "views whose first row looks up": (2 - row, column),
    }
    return {
        **{what: (np.column_stack(each), view) for what, each in boxes.items()},
        **{what: (xywh, above * N_HEADINGS + along) for what, (above, along) in views.items()},
    }
