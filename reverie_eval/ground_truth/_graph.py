"""The navigation graphs of a split's scans: edges between viewpoints, and shortest distances."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from itertools import count

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import Array, BoolArray, FloatArray, IntArray, offsets_of, row_of
from reverie_eval.ground_truth._ids import ViewpointTable


@dataclass(frozen=True, eq=False)
class NavigationGraph:
    """The viewpoints of several scans, numbered scan by scan.

    ``distance`` and ``edge`` have one square block per scan, stored end to end: all pairs of a
    scan's viewpoints, row by row. The distance is inf if there is no route.
    """

    scan_ids: tuple[str, ...]
    viewpoint_ids: tuple[str, ...]
    """Every included viewpoint; ids are unique across scans."""
    viewpoint_scan: IntArray
    """Shape (n_viewpoints,): index into ``scan_ids``, ascending."""
    viewpoint_position: FloatArray
    """Shape (n_viewpoints, 3): the camera's position in the scan's own frame, metres, z up."""
    # One block per scan, because a matrix of the whole split would be nearly all inf.
    distance: FloatArray
    """Metres along the graph from the row's viewpoint to the column's."""
    edge: BoolArray
    """Whether there is an edge from the row's viewpoint to the column's."""
    viewpoint_rotation: FloatArray
    """Shape (n_viewpoints, 3, 3): from the frame of the camera that took the panorama (right, down,
    forward) to the scan's."""

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> Self:
        """Read the graphs from a bundle's arrays."""
        return cls(
            scan_ids=tuple(arrays["scan_id"].tolist()),
            viewpoint_ids=tuple(arrays["viewpoint_id"].tolist()),
            viewpoint_scan=arrays["viewpoint_scan"],
            viewpoint_position=arrays["viewpoint_position"],
            distance=arrays["distance"],
            edge=arrays["edge"],
            viewpoint_rotation=arrays["viewpoint_rotation"],
        )

    def to_arrays(self) -> dict[str, Array]:
        """Return the graphs as a bundle's arrays."""
        return {
            "viewpoint_rotation": self.viewpoint_rotation,
            "scan_id": np.array(self.scan_ids, dtype=np.str_),
            "viewpoint_id": np.array(self.viewpoint_ids, dtype=np.str_),
            "viewpoint_scan": self.viewpoint_scan,
            "viewpoint_position": self.viewpoint_position,
            "distance": self.distance,
            "edge": self.edge,
        }

    @cached_property
    def index(self) -> Mapping[str, int]:
        """The index of each viewpoint id."""
        return {viewpoint_id: index for index, viewpoint_id in enumerate(self.viewpoint_ids)}

    @cached_property
    def viewpoint_table(self) -> ViewpointTable:
        """The index of each viewpoint id by its letters."""
        return ViewpointTable(self.viewpoint_ids)

    @cached_property
    def component(self) -> IntArray:
        """Shape (n_viewpoints,): the first viewpoint to which there is a route from each one.

        Two viewpoints with the same one can reach each other.
        """
        first_of_scan = np.searchsorted(self.viewpoint_scan, self.viewpoint_scan)
        pair = np.flatnonzero(np.isfinite(self.distance))
        # Every viewpoint can reach itself, so there is a pair in each row.
        first = pair[np.searchsorted(pair, self._row_begin + first_of_scan)] - self._row_begin
        return first.astype(np.int32)  # half the memory where there are millions of poses

    def scan_of(self, viewpoint: int) -> str:
        """Return the scan id of a viewpoint."""
        return self.scan_ids[int(self.viewpoint_scan[viewpoint])]

    def viewpoints_of(self, scan_id: str) -> IntArray:
        """Return the viewpoints of a scan, which follow each other."""
        return np.flatnonzero(self.viewpoint_scan == self.scan_ids.index(scan_id))

    def edges_of(self, scan_id: str) -> IntArray:
        """Return the edges of a scan, each once, as pairs of rows in its viewpoints.

        Shape (n_edges, 2).
        """
        viewpoints = self.viewpoints_of(scan_id)
        start, end = np.triu_indices(len(viewpoints), k=1)
        is_edge = self.has_edge(viewpoints[start], viewpoints[end])
        return np.column_stack([start, end])[is_edge]

    def distance_between(self, start: IntArray, end: IntArray) -> FloatArray:
        """Metres along the graph from each start to each end, which share a scan."""
        return self.distance[self._pair(start, end)]

    def has_edge(self, start: IntArray, end: IntArray) -> BoolArray:
        """Whether there is an edge from each start to each end, which share a scan."""
        return self.edge[self._pair(start, end)]

    def neighbours(self, viewpoint: int) -> Mapping[int, float]:
        """Return the viewpoints to which there is an edge, ascending, and the metres to each."""
        end, metres, offsets = self._edges
        row = slice(offsets[viewpoint], offsets[viewpoint + 1])
        return dict(zip(end[row], metres[row], strict=True))

    def routes_from(self, start: int) -> Mapping[int, Sequence[int]]:
        """Return the shortest route to each viewpoint that can be reached, with both ends.

        Of equally short routes it is the one that Dijkstra's algorithm finds first, as networkx
        implements it, which the published evaluators use.
        """
        routes, shortest, done = {start: [start]}, {start: 0.0}, set[int]()
        # The number of the discovery decides between equal lengths: the one that was found first
        # wins, as in networkx. Without it, heapq would compare viewpoints.
        found, queue = count(1), [(0.0, 0, start)]
        while queue:
            length, _, here = heappop(queue)
            # A viewpoint is queued again whenever a shorter way is found; the longer entries stay
            # behind.
            if here in done:
                continue
            done.add(here)
            for there, metres in self.neighbours(here).items():
                # Strictly less: of equally short routes, the first that was found stays.
                if length + metres < shortest.get(there, np.inf):
                    shortest[there] = length + metres
                    routes[there] = [*routes[here], there]
                    heappush(queue, (length + metres, next(found), there))
        return routes

    def _pair(self, start: IntArray, end: IntArray) -> IntArray:
        return self._row_begin[start] + end

    @cached_property
    def _edges(self) -> tuple[list[int], list[float], list[int]]:
        """The ends of all edges by their start, their metres, and where each start's begin."""
        pair = np.flatnonzero(self.edge)
        row_length = np.bincount(self.viewpoint_scan)[self.viewpoint_scan]
        start = row_of(offsets_of(row_length))[pair]
        offsets = offsets_of(np.bincount(start, minlength=len(self.viewpoint_ids)))
        end = pair - self._row_begin[start]
        return end.tolist(), self.distance[pair].tolist(), offsets.tolist()

    @cached_property
    def _row_begin(self) -> IntArray:
        """Where each viewpoint's row begins, minus the first viewpoint of its scan.

        The sum with the global number of a column's viewpoint is then the index of the pair.
        """
        size = np.bincount(self.viewpoint_scan, minlength=len(self.scan_ids))
        row_length = size[self.viewpoint_scan]
        first_of_scan = offsets_of(size)[self.viewpoint_scan]
        return offsets_of(row_length)[:-1] - first_of_scan
