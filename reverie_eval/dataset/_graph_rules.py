"""Rules for the files as such and for the navigation graphs."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.dataset._graphs import Graphs
from reverie_eval.dataset._reader import Reader
from reverie_eval.dataset._records import ViewpointKey
from reverie_eval.dataset._rules import Found, Rule, Spread, error, info, spread, warning


def _unreadable(reader: Reader) -> Found:
    names = [f"{file.path.name}: {file.reason}" for file in reader.unreadable]
    return Found.among(names, reader.n_files)


FILE_RULES: Sequence[Rule[Reader]] = (
    info("files", "files read", lambda reader: Found(reader.n_files)),
    error(
        "malformed-file",
        "files that do not have the published form",
        "Their content is left out of all other counts: fetch them again first.",
        _unreadable,
    ),
    error(
        "duplicate-key",
        "names given twice in one JSON object",
        "Every reader keeps one of the two values and drops the other: remove one.",
        lambda reader: Found.among(reader.duplicate_keys, None),
    ),
)


def _n_viewpoints(graphs: Graphs) -> int:
    return len(graphs.nodes) + sum(len(scan.excluded) for scan in graphs.scans.values())


def _edge_lengths(graphs: Graphs) -> FloatArray:
    lengths = [scan.edge_lengths for scan in graphs.scans.values()]
    return np.concatenate([np.zeros(0), *lengths])


def _ragged(graphs: Graphs) -> Found:
    return Found.among(graphs.ragged, len(graphs.scans) + len(graphs.ragged))


def _duplicate_viewpoints(graphs: Graphs) -> Found:
    counts = Counter(key.viewpoint_id for key in graphs.nodes)
    return Found.among([id_ for id_, count in counts.items() if count > 1], len(counts))


def _one_way_edges(graphs: Graphs) -> Found:
    pairs = [
        f"{scan.scan_id}: {scan.viewpoint_ids[start]} to {scan.viewpoint_ids[end]}"
        for scan in graphs.scans.values()
        for start, end in np.argwhere(scan.edge & ~scan.edge.T).tolist()
    ]
    return Found.among(pairs, len(_edge_lengths(graphs)))


def _isolated(graphs: Graphs) -> Found:
    isolated = [
        str(ViewpointKey(scan.scan_id, scan.viewpoint_ids[row]))
        for scan in graphs.scans.values()
        for row in np.flatnonzero(~(scan.edge | scan.edge.T).any(axis=1)).tolist()
    ]
    return Found.among(isolated, len(graphs.nodes))


def _disconnected(graphs: Graphs) -> Found:
    parts = {scan_id: len({*scan.component.tolist()}) for scan_id, scan in graphs.scans.items()}
    disconnected = [f"{scan_id} in {number}" for scan_id, number in parts.items() if number > 1]
    return Found.among(disconnected, len(graphs.scans))


GRAPH_RULES: Sequence[Rule[Graphs]] = (
    info("scans", "scans with a navigation graph", lambda graphs: Found(len(graphs.scans))),
    info("viewpoints", "viewpoints", lambda graphs: Found(_n_viewpoints(graphs))),
    info(
        "included-viewpoints",
        "viewpoints that are included, the nodes of the graphs",
        lambda graphs: Found(len(graphs.nodes), _n_viewpoints(graphs)),
    ),
    info(
        "edges",
        "pairs of included viewpoints with an edge",
        lambda graphs: Found(len(_edge_lengths(graphs))),
    ),
    error(
        "malformed-graph",
        "scans whose unobstructed lists do not have one entry for each viewpoint",
        "These scans are left out of all other counts: fetch their connectivity files again.",
        _ragged,
    ),
    error(
        "duplicate-viewpoint",
        "ids of more than one included viewpoint",
        "A submission refers to viewpoints by id alone: an id must be unique in the dataset.",
        _duplicate_viewpoints,
    ),
    error(
        "asymmetric-edge",
        "pairs of included viewpoints unobstructed one way only",
        "Edges are walked both ways, and loaders of graphs stop at these: fetch the files again.",
        _one_way_edges,
        tolerated_by=["boxes"],
    ),
    warning(
        "isolated-viewpoint",
        "included viewpoints without an edge",
        "No route leads there; a graph that is built from its edges alone does not have them.",
        _isolated,
    ),
    warning(
        "graph-in-parts",
        "scans whose graph has more than one connected part",
        "Distances between the parts are infinite; `unreachable-goal` says whether a task minds.",
        _disconnected,
    ),
)


def graph_spreads(graphs: Graphs) -> list[Spread]:
    """Measure the edges."""
    return [spread("edge-length", "length of the edges", "m", _edge_lengths(graphs))]
