"""How far the listed objects are from the camera, which tells the rule they were listed by."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.linting.annotations import Split, places_of, target_of
from reverie_eval.linting.boxes import Boxes
from reverie_eval.linting.graphs import Graphs, Place
from reverie_eval.linting.reader import Reader
from reverie_eval.linting.rows import Count, Found, Spread, fact, remark, spread
from reverie_eval.protocol import SUCCESS_DISTANCE
from reverie_eval.schemas.dataset import OBJECT_POSITIONS, Position

REACH = 2.0
"""Metres from camera to centre below which v1 lists objects: all but ten."""

Centres = Mapping[str, Mapping[str, Position]]
"""Centres of objects by scan and object id, metres."""


def read_centres(reader: Reader, path: Path) -> Centres:
    """Read the centres of the objects."""
    return reader.read(OBJECT_POSITIONS, path) or {}


def distance_counts(boxes: Boxes, graphs: Graphs, centres: Centres) -> list[Count]:
    """Count listed objects that are farther away than the published ones."""
    distance = _listed_distances(boxes, graphs, centres)

    def name(entry: int) -> str:
        return f"{boxes.name_of_entry(entry)} {distance[entry]:.2f} m"

    beyond = "metres or more"
    within = _n_within_reach(boxes, graphs, centres)
    return [
        fact(
            "measured",
            "listed objects whose centre is known",
            int(np.isfinite(distance).sum()),
            len(distance),
        ),
        remark(
            "unknown-centre",
            "listed objects without a centre, or of a viewpoint without a graph",
            "They are not measured.",
            Found.where(np.isnan(distance), boxes.name_of_entry),
        ),
        remark(
            "beyond-reach",
            f"listed objects {REACH:g} {beyond} from camera to centre",
            f"v1 lists what is nearer than {REACH:g} m, but for ten objects; another release may "
            "reach farther.",
            Found.where(distance >= REACH, name),
        ),
        remark(
            "beyond-success",
            f"listed objects more than {SUCCESS_DISTANCE:g} metres away",
            "Farther than the paper's rule allows; under the protocol challenge-2022 seeing one "
            "is no success.",
            Found.where(distance > SUCCESS_DISTANCE, name),
        ),
        fact(
            "within-reach",
            f"viewpoints nearer than {REACH:g} metres to an object, of objects listed anywhere",
            within,
        ),
        fact(
            "unlisted-within-reach",
            "such viewpoints that do not list the object",
            within - int((distance < REACH).sum()),
            within,
        ),
    ]


def distance_spreads(
    boxes: Boxes, graphs: Graphs, centres: Centres, splits: Sequence[Split]
) -> list[Spread]:
    """Measure from cameras to centres, of listed objects and of targets."""
    listed = _listed_distances(boxes, graphs, centres)
    targets = np.array(
        [
            _distance(graphs, centres, places_of(task)[-1], target_of(task))
            for split in splits
            for task in split.answered
        ]
    )
    return [
        spread("object-distance", "from the camera to listed objects", "m", _known(listed)),
        spread("target-distance", "from the goal to the target, of tasks", "m", _known(targets)),
    ]


def _n_within_reach(boxes: Boxes, graphs: Graphs, centres: Centres) -> int:
    """Count the pairs of an object that is listed anywhere and an included viewpoint near it."""
    objects = {(boxes.places[place].scan_id, object_id) for place, object_id, _ in boxes.listed}
    return sum(
        int((np.linalg.norm(graphs.scans[scan_id].position - centre, axis=1) < REACH).sum())
        for scan_id, object_id in objects
        if scan_id in graphs.scans
        and (centre := centres.get(scan_id, {}).get(str(object_id))) is not None
    )


def _listed_distances(boxes: Boxes, graphs: Graphs, centres: Centres) -> FloatArray:
    """Shape (n_entries,): metres, nan where an end is not known."""
    return np.array(
        [
            _distance(graphs, centres, boxes.places[place], object_id)
            for place, object_id, _ in boxes.listed
        ],
        dtype=np.float64,
    )


def _distance(graphs: Graphs, centres: Centres, place: Place, object_id: int) -> float:
    centre = centres.get(place.scan_id, {}).get(str(object_id))
    if centre is None or not graphs.is_node(place):
        return float("nan")
    scan = graphs.scans[place.scan_id]
    return float(np.linalg.norm(scan.position[scan.row[place.viewpoint_id]] - centre))


def _known(distance: FloatArray) -> FloatArray:
    return distance[~np.isnan(distance)]
