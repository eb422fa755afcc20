"""The navigation graphs of all scans, as they are published."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.ground_truth.dataset import connectivity_files
from reverie_eval.linting.reader import Reader
from reverie_eval.schemas.dataset import CONNECTIVITY, Viewpoint


class Place(NamedTuple):
    """A viewpoint of a scan."""

    scan_id: str
    viewpoint_id: str

    def __str__(self) -> str:
        return "_".join(self)


@dataclass(frozen=True, eq=False)
class ScanGraph:
    """The navigation graph of a scan: its included viewpoints and the edges between them."""

    scan_id: str
    excluded: frozenset[str]
    """Viewpoints of the file that are no nodes."""
    viewpoint_ids: tuple[str, ...]
    position: FloatArray
    """Shape (n, 3): metres."""
    edge: BoolArray
    """Shape (n, n): whether the row's viewpoint is unobstructed to the column's, another one."""

    @cached_property
    def component(self) -> IntArray:
        """Shape (n,): which part of the graph each viewpoint is in, edges taken either way."""
        _, labels = connected_components(self.edge, directed=False)
        return np.asarray(labels)

    @cached_property
    def row(self) -> Mapping[str, int]:
        """The row of each viewpoint id."""
        return {viewpoint_id: row for row, viewpoint_id in enumerate(self.viewpoint_ids)}

    def has_edge(self, start: str, end: str) -> bool:
        """Whether an edge leads from one viewpoint to the other; both are nodes."""
        return bool(self.edge[self.row[start], self.row[end]])


@dataclass(frozen=True, eq=False)
class Graphs:
    """The graphs of all scans, as far as their files could be read."""

    scans: Mapping[str, ScanGraph]
    ragged: Sequence[str]
    """Scans whose ``unobstructed`` lists do not have an entry for each viewpoint."""

    def is_node(self, place: Place) -> bool:
        """Whether it is an included viewpoint."""
        return place.scan_id in self.scans and place.viewpoint_id in self.scans[place.scan_id].row

    def is_excluded(self, place: Place) -> bool:
        """Whether it is known, and not included."""
        scan = self.scans.get(place.scan_id)
        return scan is not None and place.viewpoint_id in scan.excluded

    @property
    def nodes(self) -> list[Place]:
        """Every included viewpoint, as often as it is there."""
        return [
            Place(scan.scan_id, id_) for scan in self.scans.values() for id_ in scan.viewpoint_ids
        ]


def read_graphs(reader: Reader, folder: Path) -> Graphs:
    """Read all connectivity files of a folder."""
    scans, ragged = {}, []
    files = connectivity_files(folder)
    tracked = reader.tracked(list(files.values()), "navigation graphs")
    for scan_id, path in zip(files, tracked, strict=True):
        viewpoints = reader.read(CONNECTIVITY, path)
        if viewpoints is None:
            continue
        if any(len(viewpoint.unobstructed) != len(viewpoints) for viewpoint in viewpoints):
            ragged.append(scan_id)
        else:
            scans[scan_id] = _graph(scan_id, viewpoints)
    return Graphs(scans, ragged)


def _graph(scan_id: str, viewpoints: Sequence[Viewpoint]) -> ScanGraph:
    rows = [row for row, viewpoint in enumerate(viewpoints) if viewpoint.included]
    size = len(viewpoints), len(viewpoints)
    unobstructed = np.array([v.unobstructed for v in viewpoints], dtype=np.bool_).reshape(size)
    np.fill_diagonal(unobstructed, val=False)
    return ScanGraph(
        scan_id,
        frozenset(v.image_id for v in viewpoints if not v.included),
        tuple(viewpoints[row].image_id for row in rows),
        np.array([viewpoints[row].position for row in rows]).reshape(-1, 3),
        unobstructed[np.ix_(rows, rows)],
    )
