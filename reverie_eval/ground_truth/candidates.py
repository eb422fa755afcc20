"""From the published boxes to the arrays of candidates: what can be seen, where, in which box."""

from collections.abc import Mapping, Sequence

import numpy as np

from reverie_eval.arrays import Array, FloatArray
from reverie_eval.ground_truth.dataset import Sources
from reverie_eval.ground_truth.graph import NavigationGraph
from reverie_eval.schemas.dataset import ObjectBoxes, Position
from reverie_eval.wording import some


def candidate_arrays(
    boxes: Mapping[str, Mapping[str, ObjectBoxes]], graph: NavigationGraph
) -> dict[str, Array]:
    """List the visible objects of every viewpoint with their boxes.

    An object that is listed without a view is not visible: ``eval_release.py`` of the dataset's
    repository, line 122, keeps only non-empty ``visible_pos``.
    """
    candidates = [
        (viewpoint, int(key), seen)
        for viewpoint, viewpoint_id in enumerate(graph.viewpoint_ids)
        for key, seen in sorted(boxes.get(viewpoint_id, {}).items(), key=lambda item: int(item[0]))
        if seen.visible_pos
    ]
    views = [len(seen.visible_pos) for _, _, seen in candidates]
    return {
        "candidate_viewpoint": np.array([viewpoint for viewpoint, _, _ in candidates]),
        "candidate_object": np.array([object_id for _, object_id, _ in candidates]),
        "box_candidate": np.repeat(np.arange(len(candidates)), views),
        "box_view": np.array([view for _, _, seen in candidates for view in seen.visible_pos]),
        "box_xywh": np.array([box for _, _, seen in candidates for box in seen.bbox2d]).reshape(
            -1, 4
        ),
    }


def candidate_distances(
    candidates: Mapping[str, Array],
    positions: Mapping[str, Mapping[str, Position]],
    graph: NavigationGraph,
) -> FloatArray:
    """Measure from each candidate's camera to its centre; inf where the centre is not known."""
    unknown = (np.inf, np.inf, np.inf)
    viewpoint = candidates["candidate_viewpoint"]
    objects = candidates["candidate_object"].tolist()
    centre = [
        positions.get(graph.scan_of(number), {}).get(str(object_id), unknown)
        for number, object_id in zip(viewpoint.tolist(), objects, strict=True)
    ]
    offset = np.array(centre).reshape(-1, 3) - graph.viewpoint_position[viewpoint]
    return np.asarray(np.sqrt(np.square(offset).sum(axis=1)), dtype=np.float64)


def check_boxes(
    sources: Sources, boxes: Mapping[str, Mapping[str, ObjectBoxes]], graph: NavigationGraph
) -> None:
    """Report viewpoints without a box file; a viewpoint that sees nothing has an empty one.

    Where all boxes come in one file, viewpoints that see nothing may be left out of it.
    """
    missing: Sequence[str] = [id_ for id_ in graph.viewpoint_ids if id_ not in boxes]
    if missing and (sources.files.boxes.is_dir() or not boxes):
        sources.report(
            "missing-boxes",
            sources.files.boxes,
            f"no boxes for {len(missing)} of {len(graph.viewpoint_ids)} viewpoints: "
            f"{some(missing)}; copy the dataset's whole box folder",
        )
