"""From connectivity files to navigation graphs with every route priced."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from reverie_eval.arrays import Array, BoolArray, FloatArray
from reverie_eval.ground_truth.dataset import Sources, connectivity_file
from reverie_eval.ground_truth.graph import NavigationGraph
from reverie_eval.schemas.dataset import Viewpoint
from reverie_eval.wording import counted, some


@dataclass(frozen=True, eq=False)
class _ScanGraph:
    viewpoint_ids: list[str]
    position: list[tuple[float, float, float]]
    edge: BoolArray

    def distance(self) -> FloatArray:
        """Metres along the graph for all pairs; inf where there is no route."""
        start, end = np.nonzero(self.edge)
        length = [
            _straight(self.position[a], self.position[b])
            for a, b in zip(start.tolist(), end.tolist(), strict=True)
        ]
        return np.asarray(dijkstra(csr_array((length, (start, end)), shape=self.edge.shape)))


def _straight(start: tuple[float, float, float], end: tuple[float, float, float]) -> float:
    """Metres as the crow flies.

    Powers of Python floats, not products and roots of arrays: a C library's ``pow`` differs from
    those in the last bit of one edge in a thousand, and the published evaluators use it.
    """
    dx, dy, dz = (a - b for a, b in zip(start, end, strict=True))
    return float((dx**2 + dy**2 + dz**2) ** 0.5)


def read_navigation_graph(sources: Sources, scans: Sequence[str]) -> NavigationGraph:
    """Read the scans' graphs and price every route in them.

    Nodes are the included viewpoints, edges the unobstructed pairs of them, and an edge is as
    long as the straight line between its ends.

    References
    ----------
    .. [1] ``load_nav_graphs`` in ``tasks/REVERIE/utilsFast.py`` of the dataset's repository; every
       published evaluator does the same.
    """
    viewpoints = sources.graphs(scans)
    graphs = {scan: _scan_graph(sources, scan, viewpoints[scan]) for scan in viewpoints}
    viewpoint_ids = [id_ for graph in graphs.values() for id_ in graph.viewpoint_ids]
    _check_unique(sources, viewpoint_ids)
    sizes = [len(graph.viewpoint_ids) for graph in graphs.values()]
    return NavigationGraph(
        scan_ids=tuple(graphs),
        viewpoint_ids=tuple(viewpoint_ids),
        viewpoint_scan=np.repeat(np.arange(len(graphs)), sizes),
        viewpoint_position=np.array(
            [position for graph in graphs.values() for position in graph.position]
        ).reshape(-1, 3),
        distance=_end_to_end([graph.distance() for graph in graphs.values()]),
        edge=_end_to_end([graph.edge for graph in graphs.values()]),
    )


def _scan_graph(sources: Sources, scan: str, viewpoints: Sequence[Viewpoint]) -> _ScanGraph:
    where = connectivity_file(sources.files.connectivity, scan)
    fault = _fault(viewpoints)
    if fault:
        sources.report("malformed-graph", where, f"{fault}; fetch the file again")
        return _ScanGraph([], [], np.zeros((0, 0), dtype=np.bool_))
    rows = [row for row, viewpoint in enumerate(viewpoints) if viewpoint.included]
    unobstructed = np.array([v.unobstructed for v in viewpoints], dtype=np.bool_)
    graph = _ScanGraph(
        viewpoint_ids=[viewpoints[row].image_id for row in rows],
        position=[viewpoints[row].position for row in rows],
        edge=unobstructed[np.ix_(rows, rows)],
    )
    one_way = np.argwhere(graph.edge & ~graph.edge.T)
    if one_way.size:
        start, end = (graph.viewpoint_ids[row] for row in one_way[0])
        sources.report(
            "asymmetric-graph",
            where,
            f"{counted(len(one_way), 'pair')} of viewpoints unobstructed one way only, the first "
            f"from {start} to {end}; fetch the file again",
        )
    return graph


def _fault(viewpoints: Sequence[Viewpoint]) -> str:
    """Say what keeps viewpoints from being a graph; nothing, if they are one."""
    if not any(viewpoint.included for viewpoint in viewpoints):
        return f"of {counted(len(viewpoints), 'viewpoint')} none is included, so no path is in it"
    ragged = [v.image_id for v in viewpoints if len(v.unobstructed) != len(viewpoints)]
    if ragged:
        return (
            f"`unobstructed` does not have one entry for each of the {len(viewpoints)} viewpoints "
            f"in {counted(len(ragged), 'viewpoint')}: {some(ragged)}"
        )
    return ""


def _check_unique(sources: Sources, viewpoint_ids: Sequence[str]) -> None:
    repeated = [id_ for id_, count in Counter(viewpoint_ids).items() if count > 1]
    if repeated:
        sources.report(
            "duplicate-viewpoint",
            sources.files.connectivity,
            f"{counted(len(repeated), 'id')} of more than one viewpoint: {some(repeated)}; "
            "a submission names viewpoints by id alone, so an id must be unique in the dataset",
        )


def _end_to_end(blocks: Sequence[Array]) -> Array:
    return np.concatenate([np.zeros(0, dtype=np.bool_), *(block.ravel() for block in blocks)])
