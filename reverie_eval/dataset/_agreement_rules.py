"""Rules on what should agree: objects with their distances, and an object's boxes with each other.

Distances from cameras to objects show how objects were chosen for the lists.

From one view to the next, the camera turns in place by 30 degrees. So a vertical edge has the same
azimuth in both of two level views that show it. The azimuths differ if views are numbered
differently or mirrored, or if images have another size.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray
from reverie_eval.dataset._boxes import Boxes, touches_border
from reverie_eval.dataset._dataset import Centres, centre_of
from reverie_eval.dataset._reader import ViewpointKey, target_of, viewpoints_of
from reverie_eval.dataset._rules import Count, Rule, Spread, error, info, spread, warning
from reverie_eval.geometry import (
    FOCAL_LENGTH,
    N_HEADINGS,
    N_VIEWS,
    STEP,
    WIDTH,
)
from reverie_eval.metrics import SUCCESS_DISTANCE
from reverie_eval.tasks import Annotation

# Metres from camera to centre. All objects that v1 lists are nearer, except for ten.
_REACH = 2.0


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances from the cameras to the centres of objects."""

    boxes: Boxes
    centres: Centres
    items: Sequence[Annotation]
    """The items that have a target and whose whole path is in the graph."""

    @cached_property
    def offset(self) -> FloatArray:
        """Shape (n_entries, 3): vector from the camera to each listed object; NaN if unknown."""
        entries = self.boxes.entries
        pairs = [(self.boxes.viewpoints[n], object_id) for n, object_id, _ in entries]
        return self._offsets(pairs)

    @cached_property
    def listed(self) -> FloatArray:
        """Shape (n_entries,): metres to each listed object; NaN if unknown."""
        return np.asarray(np.linalg.norm(self.offset, axis=1))

    @cached_property
    def target(self) -> FloatArray:
        """Shape (n_items,): metres from the goal to the target; NaN if unknown."""
        pairs = [(viewpoints_of(item)[-1], target_of(item)) for item in self.items]
        return np.asarray(np.linalg.norm(self._offsets(pairs), axis=1))

    def _offsets(self, pairs: Sequence[tuple[ViewpointKey, int]]) -> FloatArray:
        graphs, offsets = self.boxes.graphs, np.full((len(pairs), 3), np.nan)
        for row, (key, object_id) in enumerate(pairs):
            centre = centre_of(self.centres, key.scan_id, object_id)
            if centre is not None and graphs.is_node(key):
                scan = graphs.scans[key.scan_id]
                offsets[row] = centre - scan.position[scan.row[key.viewpoint_id]]
        return offsets


def _listed_where(distances: Distances, mask: BoolArray) -> Count:
    text, metres = distances.boxes.entry_text, distances.listed
    return Count.where(mask, lambda entry: f"{text(entry)} {metres[entry]:.2f} m")


DISTANCE_RULES: Sequence[Rule[Distances]] = (
    info(
        "measured",
        "listed objects whose centre is known",
        lambda distances: Count.where(np.isfinite(distances.listed)),
    ),
    warning(
        "unknown-centre",
        "listed objects without a known centre, or at a viewpoint without a graph",
        "They are not measured.",
        lambda distances: Count.where(np.isnan(distances.listed), distances.boxes.entry_text),
    ),
    warning(
        "beyond-reach",
        f"listed objects {_REACH:g} metres or more from camera to centre",
        f"Except for ten, v1 lists only objects nearer than {_REACH:g} m; another release may list "
        "farther ones.",
        lambda distances: _listed_where(distances, distances.listed >= _REACH),
    ),
    warning(
        "beyond-success",
        f"listed objects more than {SUCCESS_DISTANCE:g} metres away",
        "Farther than the paper's rule allows. Under the challenge-2022 protocol, stopping in view "
        "of one is not a success.",
        lambda distances: _listed_where(distances, distances.listed > SUCCESS_DISTANCE),
    ),
)


def distance_spreads(distances: Distances) -> list[Spread]:
    """Measure the distances from cameras to the centres of listed objects and of targets."""
    listed, target = (each[~np.isnan(each)] for each in (distances.listed, distances.target))
    return [
        spread("object-distance", "distance from the camera to listed objects", "m", listed),
        spread("target-distance", "distance from the goal to the target, over items", "m", target),
    ]


# Neighbouring views.


# Degrees: about one pixel in the middle of a view.
_AGREEMENT = 0.15
# The fewest pairs of boxes of which a majority says something about the dataset.
_ENOUGH = 20

_LEVEL = np.arange(N_HEADINGS, 2 * N_HEADINGS)
# Each level view and the one to its right; the last is followed by the first.
_PAIRS = np.stack([_LEVEL, np.roll(_LEVEL, -1)], axis=-1)


def _edges_apart(boxes: Boxes) -> Count:
    pairs = neighbours(boxes)
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
    left, right = edge_differences(boxes, neighbours(boxes)).T
    says = "angle between the {} edges of an object in a level view and the next"
    return [
        spread("left-edge-agreement", says.format("left"), "deg", left),
        spread("right-edge-agreement", says.format("right"), "deg", right),
    ]


def neighbours(boxes: Boxes) -> Array:
    """Pair the boxes of an object in two neighbouring level views: their rows, (n_pairs, 2).

    Boxes that touch a border are left out: such a box may be cut, and its edge is not the object's.
    """
    is_usable = np.isin(boxes.box_view, _LEVEL) & ~touches_border(boxes.box_xywh).any(axis=1)
    usable = np.flatnonzero(is_usable)
    box_in = np.full((len(boxes.entries), N_VIEWS), -1)
    box_in[boxes.box_entry[usable], boxes.box_view[usable]] = usable
    pairs = box_in[:, _PAIRS].reshape(-1, 2)
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
