"""What is in the navigation graphs, and what keeps them from being walked through."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.linting.graphs import Graphs, Place, ScanGraph
from reverie_eval.linting.rows import Count, Found, Spread, fact, fault, remark, spread


def graph_counts(graphs: Graphs) -> list[Count]:
    """Count viewpoints and edges, and what keeps a graph from being walked through."""
    scans, nodes = list(graphs.scans.values()), graphs.nodes
    excluded = sum(len(scan.excluded) for scan in scans)
    return [
        fact("scans", "scans with a navigation graph", len(scans)),
        fact("viewpoints", "viewpoints", len(nodes) + excluded),
        fact(
            "included-viewpoints",
            "viewpoints that are included, the nodes of the graphs",
            len(nodes),
            len(nodes) + excluded,
        ),
        fact("edges", "pairs of included viewpoints with an edge", len(_edge_lengths(scans))),
        fault(
            "malformed-graph",
            "scans whose unobstructed lists do not have one entry for each viewpoint",
            "Nothing of these scans is counted below: fetch their connectivity files again.",
            Found.among(graphs.ragged, len(scans) + len(graphs.ragged)),
        ),
        _duplicates(nodes),
        _one_way(scans),
        remark(
            "isolated-viewpoint",
            "included viewpoints without an edge",
            "No route leads there; a graph that is built from its edges alone does not know them.",
            _isolated(scans, len(nodes)),
        ),
        _in_parts(scans),
    ]


def graph_spreads(graphs: Graphs) -> list[Spread]:
    """Measure the edges."""
    lengths = _edge_lengths(list(graphs.scans.values()))
    return [spread("edge-length", "length of the edges", "m", lengths)]


def _duplicates(nodes: Sequence[Place]) -> Count:
    counts = Counter(place.viewpoint_id for place in nodes)
    return fault(
        "duplicate-viewpoint",
        "ids of more than one included viewpoint",
        "A submission names viewpoints by id alone: an id must be unique in the dataset.",
        Found.among([id_ for id_, count in counts.items() if count > 1], len(counts)),
    )


def _one_way(scans: Sequence[ScanGraph]) -> Count:
    pairs = [
        f"{scan.scan_id}: {scan.viewpoint_ids[start]} to {scan.viewpoint_ids[end]}"
        for scan in scans
        for start, end in np.argwhere(scan.edge & ~scan.edge.T).tolist()
    ]
    return fault(
        "asymmetric-edge",
        "pairs of included viewpoints unobstructed one way only",
        "Edges are walked both ways, and loaders of graphs stop at these: fetch the files again.",
        Found.among(pairs, len(_edge_lengths(scans))),
    )


def _isolated(scans: Sequence[ScanGraph], of: int) -> Found:
    alone = [
        str(Place(scan.scan_id, scan.viewpoint_ids[row]))
        for scan in scans
        for row in np.flatnonzero(~(scan.edge | scan.edge.T).any(axis=1)).tolist()
    ]
    return Found.among(alone, of)


def _in_parts(scans: Sequence[ScanGraph]) -> Count:
    parts = {scan.scan_id: len(set(scan.component.tolist())) for scan in scans}
    split = [f"{scan_id} in {number}" for scan_id, number in parts.items() if number > 1]
    return remark(
        "graph-in-parts",
        "scans whose graph has more than one connected part",
        "Distances between the parts are infinite; `unreachable-goal` says whether a task minds.",
        Found.among(split, len(scans)),
    )


def _edge_lengths(scans: Sequence[ScanGraph]) -> FloatArray:
    """Metres between the ends of every pair with an edge, in whichever direction."""
    lengths = [np.zeros(0)]
    for scan in scans:
        start, end = np.nonzero(np.triu(scan.edge | scan.edge.T))
        lengths.append(np.linalg.norm(scan.position[start] - scan.position[end], axis=1))
    return np.concatenate(lengths)
