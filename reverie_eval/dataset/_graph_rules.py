"""Rules for reading the files, and for the navigation graphs."""

from collections.abc import Sequence

import numpy as np

from reverie_eval.arrays import FloatArray
from reverie_eval.dataset._graphs import Graphs
from reverie_eval.dataset._reader import Reader
from reverie_eval.dataset._records import ViewpointKey
from reverie_eval.dataset._rules import Count, Rule, Spread, error, info, spread, warning

FILE_RULES: Sequence[Rule[Reader]] = (
    info("files", "files read", lambda reader: Count(reader.n_files)),
    error(
        "malformed-file",
        "files that do not have the published form",
        "All other counts leave out their content, so fetch them again first.",
        lambda reader: Count.from_names(
            [f"{path.name}: {reason}" for path, reason in reader.unreadable], reader.n_files
        ),
    ),
    error(
        "duplicate-key",
        "keys that occur twice in one JSON object",
        "JSON readers keep one of the two values and drop the other: remove one.",
        lambda reader: Count.from_names(reader.duplicate_keys, None),
    ),
)


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
