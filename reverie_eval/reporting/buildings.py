"""The buildings of a split and views in them, modelled from what its bundle holds."""

from collections.abc import MutableMapping, Sequence
from weakref import WeakKeyDictionary

import numpy as np

from reverie_eval.geometry import Building, RoomView, Seen, Sightings, model_building
from reverie_eval.ground_truth import CandidateBoxes, NavigationGraph, Solution
from reverie_eval.text import category_text

# Kept with the boxes, which all protocols and subsets of a split share.
_MODELS: MutableMapping[CandidateBoxes, dict[str, Building]] = WeakKeyDictionary()


def building_of(graph: NavigationGraph, solution: Solution, scan: str) -> Building:
    """Model a scan's building, once for the boxes of a split.

    Without objects, as in tasks that have none, it has storeys and stairs but no rooms.
    """
    models = _MODELS.setdefault(solution.boxes, {})
    if scan not in models:
        models[scan] = _model(graph, solution, scan)
    return models[scan]


def room_view_of(
    graph: NavigationGraph,
    solution: Solution,
    viewpoint_id: str,
    view: int,
    seen: Seen,
    *,
    important: Sequence[int] = (),
) -> RoomView:
    """Look at the building from a viewpoint, which sees these objects; some are important."""
    viewpoint = graph.index[viewpoint_id]
    scan = graph.scan_of(viewpoint)
    rows = graph.viewpoints_of(scan)
    building = building_of(graph, solution, scan)
    row = viewpoint - int(rows[0])
    return RoomView(building, graph.viewpoint_position[rows], row, view, seen, important=important)


def _model(graph: NavigationGraph, solution: Solution, scan: str) -> Building:
    viewpoints = graph.viewpoints_of(scan)
    # Candidates and their boxes are in the order of viewpoints: a scan's are next to each other.
    first, last = np.searchsorted(solution.candidate_viewpoint, [viewpoints[0], viewpoints[-1] + 1])
    boxes = slice(*np.searchsorted(solution.boxes.candidate, [first, last]))
    candidates = slice(int(first), int(last))
    distance = solution.candidate_distance
    seen = Sightings.of_boxes(
        viewpoint=solution.candidate_viewpoint[candidates] - viewpoints[0],
        object_id=solution.candidate_object[candidates],
        distance=np.full(last - first, np.inf) if distance is None else distance[candidates],
        names=list(map(category_text, solution.candidate_categories[candidates])),
        row=solution.boxes.candidate[boxes] - first,
        view=solution.boxes.view[boxes],
        xywh=solution.boxes.xywh[boxes],
    )
    return model_building(graph.viewpoint_position[viewpoints], graph.edges_of(scan), seen)
