"""Whether boxes of one object in neighbouring level views show it in the same direction.

The camera turns in place by 30 degrees from one level view to the next, so a vertical edge that
both show has one azimuth, whichever of them it is measured in. Boxes in views that are numbered or
mirrored in another way, or of another picture size, do not agree.
"""

import numpy as np

from reverie_eval.arrays import Array, FloatArray
from reverie_eval.geometry import FOCAL_LENGTH, WIDTH
from reverie_eval.geometry.views import N_HEADINGS, STEP
from reverie_eval.linting.box_size_checks import border
from reverie_eval.linting.boxes import Boxes
from reverie_eval.linting.rows import Count, Found, Spread, fault, remark, spread

AGREEMENT = 0.15
"""Degrees: about one pixel in the middle of a view."""
ENOUGH = 20
"""Pairs of boxes from which on a majority says something of the dataset."""


def view_counts(boxes: Boxes) -> list[Count]:
    """Count objects that neighbouring views show in different directions."""
    pairs = neighbours(boxes)
    is_apart = edge_differences(boxes, pairs).max(axis=1, initial=0.0) > AGREEMENT
    apart = Found.where(is_apart, lambda row: boxes.name_of_box(pairs[row, 0]))
    is_most = len(pairs) >= ENOUGH and 2 * apart.number > len(pairs)
    return [
        remark(
            "edges-apart",
            "objects in two neighbouring level views with the left or the right edge more than "
            f"{AGREEMENT} degrees apart",
            "A few per cent are seen in parts between other objects.",
            apart,
        ),
        fault(
            "views-disagree",
            "such objects, if they are most of those in two neighbouring views",
            "Views are numbered otherwise, or pictures are mirrored or have another size or field "
            "of view: convert the boxes.",
            apart if is_most else Found(0, len(pairs)),
        ),
    ]


def view_spreads(boxes: Boxes) -> list[Spread]:
    """Measure by how much neighbouring level views disagree."""
    left, right = edge_differences(boxes, neighbours(boxes)).T
    says = "{} edge of an object in a level view and in the next, azimuths apart"
    return [
        spread("left-edge-agreement", says.format("left"), "deg", left),
        spread("right-edge-agreement", says.format("right"), "deg", right),
    ]


def neighbours(boxes: Boxes) -> Array:
    """Pair the boxes of an object in a level view and in the next one to the right.

    Returns
    -------
    int array of shape (n_pairs, 2)
        Rows of boxes, none of which touches a border: a box that does is cut.
    """
    column = boxes.box_view - N_HEADINGS
    is_level = (column >= 0) & (column < N_HEADINGS)
    usable = np.flatnonzero(is_level & ~border(boxes.box_xywh).any(axis=1))
    box_in = np.full((len(boxes.listed), N_HEADINGS), -1)
    box_in[boxes.box_entry[usable], column[usable]] = usable
    pairs = np.stack([box_in, np.roll(box_in, -1, axis=1)], axis=-1).reshape(-1, 2)
    return np.asarray(pairs[(pairs >= 0).all(axis=1)])


def edge_differences(boxes: Boxes, pairs: Array) -> FloatArray:
    """Degrees between the azimuths of an edge in two neighbouring views.

    Parameters
    ----------
    boxes : Boxes
        The columns of boxes.
    pairs : int array of shape (n_pairs, 2)
        As :func:`neighbours` gives them.

    Returns
    -------
    float array of shape (n_pairs, 2)
        Of the left and of the right edge; never negative.
    """
    left, _, width, _ = boxes.box_xywh.T
    edge = np.stack([left, left + width], axis=-1)[pairs]
    azimuth = np.arctan((edge - WIDTH / 2) / FOCAL_LENGTH)
    return np.asarray(np.rad2deg(np.abs(azimuth[:, 0] - azimuth[:, 1] - STEP)))
