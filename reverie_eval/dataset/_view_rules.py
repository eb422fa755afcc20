"""Rules for the boxes of one object in neighbouring views, which should agree on its direction.

From one view to the next, the camera turns in place by 30 degrees. So a vertical edge has the same
azimuth in both of two level views that show it. The azimuths differ if views are numbered
differently or mirrored, or if images have another size. Centres need not agree exactly in any two
views: a rectangle in one view is not a rectangle in another.
"""

from collections.abc import Sequence

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray
from reverie_eval.dataset._box_rules import touches_border
from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._rules import Count, Rule, Spread, error, spread, warning
from reverie_eval.geometry import FOCAL_LENGTH, N_VIEWS, VIEW_AXES, WIDTH, rays_of
from reverie_eval.geometry._views import N_HEADINGS, STEP, degrees_between

_AGREEMENT = 0.15
"""Degrees: about one pixel in the middle of a view."""
_ENOUGH = 20
"""With fewer pairs of boxes, a majority of them says nothing about the dataset."""

_ROWS = np.arange(N_VIEWS).reshape(-1, N_HEADINGS)
"""The views by row: looking down, level, and looking up."""
_NEXT = np.roll(_ROWS, -1, axis=1)
"""The view to the right of each; the last view of a row is followed by its first."""
LOWER_PAIRS, LEVEL_PAIRS, UPPER_PAIRS = np.stack([_ROWS, _NEXT], axis=-1)
ROW_PAIRS = np.stack([_ROWS[:-1], _ROWS[1:]], axis=-1).reshape(-1, 2)
_CENTRE_PAIRS = (
    ("level", "a level view and the next", LEVEL_PAIRS),
    ("lower", "a view that looks down and the next", LOWER_PAIRS),
    ("upper", "a view that looks up and the next", UPPER_PAIRS),
    ("row", "a view and the one above", ROW_PAIRS),
)


def _edges_apart(boxes: Boxes) -> Count:
    pairs = neighbours(boxes, LEVEL_PAIRS)
    is_apart = edge_differences(boxes, pairs).max(axis=1, initial=0.0) > _AGREEMENT
    return Count.where(is_apart, lambda row: boxes.box_text(pairs[row, 0]))


def _mostly_apart(boxes: Boxes) -> Count:
    apart = _edges_apart(boxes)
    n_pairs = apart.of or 0
    is_most = n_pairs >= _ENOUGH and 2 * apart.number > n_pairs
    return apart if is_most else Count(0, n_pairs)


VIEW_RULES: Sequence[Rule[Boxes]] = (
    warning(
        "edges-apart",
        "objects in two neighbouring level views whose left or right edges are more than "
        f"{_AGREEMENT} degrees apart",
        "A few per cent are normal: other objects hide parts of them.",
        _edges_apart,
    ),
    error(
        "views-disagree",
        "such objects, if they are the majority",
        "Views are numbered differently, or images are mirrored or have another size or field of "
        "view: convert the boxes.",
        _mostly_apart,
    ),
)


def view_spreads(boxes: Boxes) -> list[Spread]:
    """Measure by how much neighbouring views disagree."""
    left, right = edge_differences(boxes, neighbours(boxes, LEVEL_PAIRS)).T
    says = "angle between the {} edges of an object in a level view and the next"
    return [
        spread("left-edge-agreement", says.format("left"), "deg", left),
        spread("right-edge-agreement", says.format("right"), "deg", right),
        *(
            spread(
                f"{code}-centre-agreement",
                f"angle between the centres of an object's boxes in {words}",
                "deg",
                centre_differences(boxes, neighbours(boxes, views)),
            )
            for code, words, views in _CENTRE_PAIRS
        ),
    ]


def neighbours(boxes: Boxes, views: IntArray) -> Array:
    """Pair the boxes of an object in two views: return their rows, shape (n_pairs, 2).

    ``views``, shape (n, 2), has the views that make a pair. Boxes that touch a border are left out:
    such a box may be cut, and its edge is not the object's.
    """
    is_view = np.isin(boxes.box_view, _ROWS)
    usable = np.flatnonzero(is_view & ~touches_border(boxes.box_xywh).any(axis=1))
    box_in = np.full((len(boxes.entries), N_VIEWS), -1)
    box_in[boxes.box_entry[usable], boxes.box_view[usable]] = usable
    pairs = box_in[:, views].reshape(-1, 2)
    return np.asarray(pairs[(pairs >= 0).all(axis=1)])


def edge_differences(boxes: Boxes, pairs: Array) -> FloatArray:
    """Return the degrees between the azimuths of an edge in two neighbouring level views.

    Shape (n_pairs, 2): of the left and of the right edge; never negative.
    """
    left, _, width, _ = boxes.box_xywh.T
    edge = np.stack([left, left + width], axis=-1)[pairs]
    azimuth = np.arctan((edge - WIDTH / 2) / FOCAL_LENGTH)
    # The second camera has turned by STEP, so the same edge has an azimuth smaller by STEP in it.
    return np.asarray(np.rad2deg(np.abs(azimuth[:, 0] - azimuth[:, 1] - STEP)))


def centre_differences(boxes: Boxes, pairs: Array) -> FloatArray:
    """Return the degrees between the directions of the centres of boxes in two views."""
    left, top, width, height = boxes.box_xywh.T
    rays = rays_of(np.stack([left + width / 2, top + height / 2], axis=-1)[pairs])
    world = np.einsum("nvi,nvij->nvj", rays, VIEW_AXES[boxes.box_view[pairs]])
    return degrees_between(world[:, 0], world[:, 1])
