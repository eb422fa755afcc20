"""Navigation graphs as published and as ground truth, and the rules for them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray
from reverie_eval.dataset._reader import CONNECTIVITY, Reader, Viewpoint, ViewpointKey
from reverie_eval.dataset._rules import Count, Rule, Spread, error, info, spread, warning
from reverie_eval.ground_truth import NavigationGraph


@dataclass(frozen=True, eq=False)
class ScanGraph:
    """The navigation graph of a scan: its included viewpoints and the edges between them."""

    scan_id: str
    excluded: frozenset[str]
    """Viewpoints in the file that are not included."""
    viewpoint_ids: tuple[str, ...]
    position: FloatArray
    """Shape (n, 3): metres."""
    rotation: FloatArray
    """Shape (n, 3, 3): from the camera's frame to the scan's."""
    edge: BoolArray
    """Shape (n, n): whether the way from the row's to the column's viewpoint is unobstructed; false
    on the diagonal."""

    @cached_property
    def component(self) -> IntArray:
        """Shape (n,): the connected component of each viewpoint, along edges in any direction."""
        start, end = np.nonzero(self.edge | self.edge.T)
        label = np.arange(len(self.edge))
        while True:
            before = label.copy()
            # The smallest label spreads by one edge in each round. ``minimum.at`` takes repeated
            # indexes one after another, where an assignment would keep the last.
            np.minimum.at(label, end, before[start])
            if np.array_equal(label, before):
                return label

    @cached_property
    def row(self) -> Mapping[str, int]:
        """The row of each viewpoint id."""
        return {viewpoint_id: row for row, viewpoint_id in enumerate(self.viewpoint_ids)}

    def has_edge(self, start: str, end: str) -> bool:
        """Whether an edge leads from one included viewpoint to another."""
        return bool(self.edge[self.row[start], self.row[end]])

    @cached_property
    def edge_lengths(self) -> FloatArray:
        """Shape (n_edges,): metres of each edge; one in either direction makes a pair an edge."""
        start, end = np.nonzero(np.triu(self.edge | self.edge.T))
        return np.asarray(np.linalg.norm(self.position[start] - self.position[end], axis=1))

    def distance(self) -> FloatArray:
        """Return the distances along the graph, shape (n, n), metres; inf if there is no route."""
        start, end = np.nonzero(self.edge)
        position = self.position.tolist()
        length = [
            _straight_distance(position[a], position[b])
            for a, b in zip(start.tolist(), end.tolist(), strict=True)
        ]
        return _shortest_routes(len(self.edge), start, end, np.array(length))


def _shortest_routes(
    n_nodes: int, start: IntArray, end: IntArray, length: FloatArray
) -> FloatArray:
    """Return the length of the shortest route from each node to each; inf if there is none.

    Bellman and Ford's method, for all nodes at once. The published evaluators use Dijkstra's. Both
    find the least of all routes' lengths, each the sum of its edges from the first to the last, and
    as a longer sum is never rounded to a smaller number, the same bits.
    """
    # Layers of edges: in each, at most one leads to each node.
    order = np.argsort(end, kind="stable")
    start, end, length = start[order], end[order], length[order]
    # In a sorted column, an element's index less that of its first equal is its number among its
    # equals.
    layer = np.arange(len(end)) - np.searchsorted(end, end)
    n_layers = layer.max(initial=-1) + 1
    previous = np.zeros((n_layers, n_nodes), dtype=np.int64)
    last_length = np.full((n_layers, n_nodes, 1), np.inf)
    previous[layer, end], last_length[layer, end, 0] = start, length

    to_from = np.full((n_nodes, n_nodes), np.inf)  # whole rows are read, so a row has its end
    np.fill_diagonal(to_from, 0.0)
    route = np.empty_like(to_from)
    while True:
        before = to_from.copy()
        for nodes, last in zip(previous, last_length, strict=True):
            np.take(to_from, nodes, axis=0, out=route, mode="clip")  # "raise" copies once more
            route += last
            # In place, so shorter routes of this round are already used by the next layer.
            np.minimum(to_from, route, out=to_from)
        if np.array_equal(to_from, before):
            return np.ascontiguousarray(to_from.T)


def _straight_distance(start: Sequence[float], end: Sequence[float]) -> float:
    """Return the metres in a straight line.

    The published evaluators use powers of Python floats, which call the C library's ``pow``.
    Products and square roots of arrays differ from it in the last bit for one edge in a thousand.
    """
    dx, dy, dz = (a - b for a, b in zip(start, end, strict=True))
    return float((dx**2 + dy**2 + dz**2) ** 0.5)


@dataclass(frozen=True, eq=False)
class Graphs:
    """The graphs of all scans whose files could be read."""

    scans: Mapping[str, ScanGraph]
    ragged: Sequence[str]
    """Scans whose ``unobstructed`` lists do not have one entry for each viewpoint."""
    unreadable: frozenset[str]
    """Scans whose file could not be read, or is ragged; nothing is known about their viewpoints."""

    def is_node(self, key: ViewpointKey) -> bool:
        """Whether the key is an included viewpoint."""
        return key.scan_id in self.scans and key.viewpoint_id in self.scans[key.scan_id].row

    def is_excluded(self, key: ViewpointKey) -> bool:
        """Whether the viewpoint is in its scan's file but not included."""
        scan = self.scans.get(key.scan_id)
        return scan is not None and key.viewpoint_id in scan.excluded

    @cached_property
    def nodes(self) -> Sequence[ViewpointKey]:
        """Every included viewpoint, in the order of the files."""
        return [
            ViewpointKey(scan.scan_id, viewpoint_id)
            for scan in self.scans.values()
            for viewpoint_id in scan.viewpoint_ids
        ]

    def ground_truth(self) -> NavigationGraph:
        """Return the graphs with the distances between all viewpoints of each scan.

        The nodes are the included viewpoints, and the edges are the unobstructed pairs of them. An
        edge is as long as the straight line between its ends [1]_. The graphs must be symmetric,
        and no viewpoint id may occur twice.

        References
        ----------
        .. [1] ``load_nav_graphs`` in ``tasks/REVERIE/utilsFast.py`` of the dataset's repository;
           every published evaluator does the same.
        """
        scans = list(self.scans.values())
        return NavigationGraph(
            scan_ids=tuple(self.scans),
            viewpoint_ids=tuple(key.viewpoint_id for key in self.nodes),
            viewpoint_scan=np.repeat(
                np.arange(len(scans)), [len(scan.viewpoint_ids) for scan in scans]
            ),
            viewpoint_position=np.concatenate(
                [np.zeros((0, 3)), *(scan.position for scan in scans)]
            ),
            distance=_flatten_blocks([scan.distance() for scan in scans]),
            edge=_flatten_blocks([scan.edge for scan in scans]),
            viewpoint_rotation=np.concatenate(
                [np.zeros((0, 3, 3)), *(scan.rotation for scan in scans)]
            ),
        )


def read_graphs(reader: Reader, files: Mapping[str, Path]) -> Graphs:
    """Read the connectivity files of scans."""
    scan_of = {path: scan_id for scan_id, path in files.items()}
    scans, ragged = {}, []
    for path, viewpoints in reader.read_each(CONNECTIVITY, list(files.values()), "connectivity"):
        if any(len(viewpoint.unobstructed) != len(viewpoints) for viewpoint in viewpoints):
            ragged.append(scan_of[path])
        else:
            scans[scan_of[path]] = _scan_graph(scan_of[path], viewpoints)
    return Graphs(scans, ragged, frozenset(files.keys() - scans.keys()))


def _scan_graph(scan_id: str, viewpoints: Sequence[Viewpoint]) -> ScanGraph:
    rows = [row for row, viewpoint in enumerate(viewpoints) if viewpoint.included]
    size = len(viewpoints), len(viewpoints)
    unobstructed = np.array([v.unobstructed for v in viewpoints], dtype=np.bool_).reshape(size)
    np.fill_diagonal(unobstructed, val=False)  # staying in place is not an edge
    return ScanGraph(
        scan_id,
        frozenset(v.image_id for v in viewpoints if not v.included),
        tuple(viewpoints[row].image_id for row in rows),
        # Reshaped, because without viewpoints there is no second axis.
        np.array([viewpoints[row].position for row in rows]).reshape(-1, 3),
        # A pose is the 4 x 4 matrix from the camera's frame to the scan's, row by row.
        np.array([viewpoints[row].pose for row in rows]).reshape(-1, 4, 4)[:, :3, :3],
        unobstructed[np.ix_(rows, rows)],
    )


def _flatten_blocks(blocks: Sequence[Array]) -> Array:
    # One matrix for all scans would be almost empty: there are no routes between scans.
    return np.concatenate([np.zeros(0, dtype=np.bool_), *(block.ravel() for block in blocks)])


# Rules.


def _n_viewpoints(graphs: Graphs) -> int:
    return len(graphs.nodes) + sum(len(scan.excluded) for scan in graphs.scans.values())


def _edge_lengths(graphs: Graphs) -> FloatArray:
    lengths = [scan.edge_lengths for scan in graphs.scans.values()]
    return np.concatenate([np.zeros(0), *lengths])


def _one_way_edges(graphs: Graphs) -> Count:
    pairs = [
        f"{scan.scan_id}: {scan.viewpoint_ids[start]} to {scan.viewpoint_ids[end]}"
        for scan in graphs.scans.values()
        for start, end in np.argwhere(scan.edge & ~scan.edge.T).tolist()
    ]
    return Count.from_names(pairs, len(_edge_lengths(graphs)))


def _isolated(graphs: Graphs) -> Count:
    isolated = [
        str(ViewpointKey(scan.scan_id, scan.viewpoint_ids[row]))
        for scan in graphs.scans.values()
        for row in np.flatnonzero(~(scan.edge | scan.edge.T).any(axis=1)).tolist()
    ]
    return Count.from_names(isolated, len(graphs.nodes))


def _disconnected(graphs: Graphs) -> Count:
    parts = {scan_id: len({*scan.component.tolist()}) for scan_id, scan in graphs.scans.items()}
    disconnected = [f"{scan_id} in {number}" for scan_id, number in parts.items() if number > 1]
    return Count.from_names(disconnected, len(graphs.scans))


GRAPH_RULES: Sequence[Rule[Graphs]] = (
    info("scans", "scans with a navigation graph", lambda graphs: Count(len(graphs.scans))),
    info("viewpoints", "viewpoints", lambda graphs: Count(_n_viewpoints(graphs))),
    info(
        "included-viewpoints",
        "viewpoints that are included, the nodes of the graphs",
        lambda graphs: Count(len(graphs.nodes), _n_viewpoints(graphs)),
    ),
    info(
        "edges",
        "pairs of included viewpoints with an edge",
        lambda graphs: Count(len(_edge_lengths(graphs))),
    ),
    error(
        "malformed-graph",
        "scans whose unobstructed lists do not have one entry for each viewpoint",
        "All other counts leave out these scans: fetch their connectivity files again.",
        lambda graphs: Count.from_names(graphs.ragged, len(graphs.scans) + len(graphs.ragged)),
    ),
    error(
        "duplicate-viewpoint",
        "ids used by more than one included viewpoint",
        "Submissions refer to viewpoints by id alone, so an id must be unique in the dataset.",
        lambda graphs: Count.repeated(key.viewpoint_id for key in graphs.nodes),
    ),
    error(
        "asymmetric-edge",
        "pairs of included viewpoints unobstructed one way only",
        "Agents walk edges both ways, and common graph loaders fail on these: fetch the files "
        "again.",
        _one_way_edges,
        tolerated_by=["boxes"],
    ),
    warning(
        "isolated-viewpoint",
        "included viewpoints without an edge",
        "No route leads there, and a graph built from its edges alone does not contain them.",
        _isolated,
    ),
    warning(
        "graph-in-parts",
        "scans whose graph has more than one connected part",
        "Distances between the parts are infinite; `unreachable-goal` counts the items that fail.",
        _disconnected,
    ),
)


def graph_spreads(graphs: Graphs) -> list[Spread]:
    return [spread("edge-length", "length of the edges", "m", _edge_lengths(graphs))]
