"""Rules for distances from cameras to objects, which show how objects were chosen for the lists."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray
from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._dataset import Centres
from reverie_eval.dataset._records import Position, ViewpointKey, target_of, viewpoints_of
from reverie_eval.dataset._rules import Count, Rule, Spread, info, spread, warning
from reverie_eval.metrics import SUCCESS_DISTANCE
from reverie_eval.tasks import Annotation

_REACH = 2.0
"""Metres from camera to centre. All objects that v1 lists are nearer, except for ten."""


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

    @cached_property
    def n_within_reach(self) -> int:
        """The number of pairs of a viewpoint and a near object that is listed somewhere."""
        boxes, scans = self.boxes, self.boxes.graphs.scans
        objects = {(boxes.viewpoints[n].scan_id, object_id) for n, object_id, _ in boxes.entries}
        return sum(
            int((np.linalg.norm(scans[scan_id].position - centre, axis=1) < _REACH).sum())
            for scan_id, object_id in objects
            if scan_id in scans and (centre := self._centre(scan_id, object_id)) is not None
        )

    def _offsets(self, pairs: Sequence[tuple[ViewpointKey, int]]) -> FloatArray:
        graphs, offsets = self.boxes.graphs, np.full((len(pairs), 3), np.nan)
        for row, (key, object_id) in enumerate(pairs):
            centre = self._centre(key.scan_id, object_id)
            if centre is not None and graphs.is_node(key):
                scan = graphs.scans[key.scan_id]
                offsets[row] = centre - scan.position[scan.row[key.viewpoint_id]]
        return offsets

    def _centre(self, scan_id: str, object_id: int) -> Position | None:
        return self.centres.get(scan_id, {}).get(str(object_id))


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
    info(
        "within-reach",
        f"pairs of a viewpoint and an object listed anywhere, less than {_REACH:g} metres apart",
        lambda distances: Count(distances.n_within_reach),
    ),
    info(
        "unlisted-within-reach",
        "such pairs in which the viewpoint does not list the object",
        lambda distances: Count(
            distances.n_within_reach - int((distances.listed < _REACH).sum()),
            distances.n_within_reach,
        ),
    ),
)


def distance_spreads(distances: Distances) -> list[Spread]:
    """Measure the distances from cameras to the centres of listed objects and of targets."""
    listed, target = (each[~np.isnan(each)] for each in (distances.listed, distances.target))
    return [
        spread("object-distance", "distance from the camera to listed objects", "m", listed),
        spread("target-distance", "distance from the goal to the target, over items", "m", target),
    ]
