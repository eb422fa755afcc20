"""The content of a dataset's files, valid or not: splits with their items, graphs and boxes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.dataset._boxes import Boxes, read_boxes
from reverie_eval.dataset._files import DatasetFiles, find_graphs
from reverie_eval.dataset._graphs import Graphs, read_graphs
from reverie_eval.dataset._reader import Progress, Reader
from reverie_eval.dataset._records import (
    ANNOTATIONS,
    OBJECT_POSITIONS,
    Position,
    mentioned_by,
    target_of,
    viewpoints_of,
)
from reverie_eval.tasks import Annotation, Task

Centres = Mapping[str, Mapping[str, Position]]
"""Centres of objects by scan and object id, metres."""


@dataclass(frozen=True, eq=False)
class Split:
    """The records of an annotation file."""

    name: str
    path: Path
    items: Sequence[Annotation]
    malformed: Sequence[str] = ()
    """Records that do not have the form of an item, with the reason."""

    @property
    def scans(self) -> set[str]:
        """The scans of the items."""
        return {item.scan for item in self.items}

    @property
    def instr_ids(self) -> list[str]:
        """The ids of the episodes, in the order of the file."""
        return [instr_id for item in self.items for instr_id in item.instr_ids]

    @property
    def has_solution(self) -> bool:
        """Whether any item has what the public file of a private split leaves out."""
        return any(item.has_solution for item in self.items)


@dataclass(frozen=True, eq=False)
class Items:
    """The items of a split in the navigation graphs."""

    split: Split
    graphs: Graphs
    other_splits: Mapping[str, str] = field(default_factory=dict)
    """The split of each instr_id that another split has."""

    def is_on_graph(self, item: Annotation) -> bool:
        """Whether every viewpoint of an item's paths is in the graph of its scan."""
        return all(map(self.graphs.is_node, mentioned_by(item)))

    @cached_property
    def on_graph(self) -> Sequence[Annotation]:
        """The items whose whole path is in the graph; the others cannot be checked any further."""
        return [item for item in self.split.items if self.is_on_graph(item)]

    @cached_property
    def with_target(self) -> Sequence[Annotation]:
        """The items on the graph that have a target."""
        return [item for item in self.on_graph if item.target is not None]


@dataclass(frozen=True, eq=False)
class Targets:
    """The targets of a split's items among the listed objects."""

    split: Split
    items: Sequence[Annotation]
    """The items that have a target and whose whole path is in the graph."""
    boxes: Boxes

    @cached_property
    def at_start(self) -> IntArray:
        """Shape (n_items,): the entry of each target at the start; -1 if not listed there."""
        return self._entries(0)

    @cached_property
    def at_goal(self) -> IntArray:
        """Shape (n_items,): the entry of each target at the goal; -1 if not listed there."""
        return self._entries(-1)

    def is_visible(self, entry: IntArray) -> BoolArray:
        """Whether the entry exists, and a view shows the object."""
        # Index -1, for no entry, picks the 0 that is appended.
        n_views = np.append(self.boxes.n_views, 0)
        return np.asarray(n_views[entry] > 0)

    @cached_property
    def n_viewpoints(self) -> IntArray:
        """Shape (n_listed,): viewpoints that see each target, of targets listed at their goal."""
        visible, number = self.boxes.sightings
        target = self.boxes.scan_object[self.at_goal[self.at_goal >= 0]]
        # A target larger than all visible objects has an index behind the last one: hence `append`.
        index = np.searchsorted(visible, target)
        is_visible = np.append(visible, -1)[index] == target
        return np.where(is_visible, np.append(number, 0)[index], 0)

    def _entries(self, end: int) -> IntArray:
        entry_at = self.boxes.entry_at
        keys = [(viewpoints_of(item)[end], target_of(item)) for item in self.items]
        entries = [entry_at.get(key, -1) for key in keys]
        return np.array(entries, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Dataset:
    """The content of a dataset's files, before any rule was checked."""

    files: DatasetFiles
    reader: Reader
    splits: Sequence[Split]
    graphs: Graphs
    boxes: Boxes
    """Empty if no split needs them."""
    centres: Centres | None
    """None if no file with them is given."""

    @property
    def has_solution(self) -> bool:
        """Whether any item has a solution; boxes are needed only then."""
        return any(split.has_solution for split in self.splits)


def read_dataset(files: DatasetFiles, progress: Progress) -> Dataset:
    """Read all splits, and the graphs and boxes of all scans."""
    reader = Reader(progress)
    graphs = read_graphs(reader, find_graphs(files.connectivity))
    splits = [
        read_split(reader, name, path, files.task) for name, path in files.annotations.items()
    ]
    boxes = Boxes([], [], graphs)
    if files.boxes:
        boxes = read_boxes(reader, files.boxes, graphs)
    return Dataset(files, reader, splits, graphs, boxes, _read_centres(reader, files))


def read_one_split(files: DatasetFiles, name: str, progress: Progress) -> Dataset:
    """Read one split, and the graphs and boxes of its scans."""
    reader = Reader(progress)
    split = read_split(reader, name, files.annotations[name], files.task)
    graphs = read_graphs(reader, find_graphs(files.connectivity, split.scans))
    boxes = Boxes([], [], graphs)
    if split.has_solution and files.boxes:
        boxes = read_boxes(reader, files.boxes, graphs, split.scans)
    return Dataset(files, reader, [split], graphs, boxes, _read_centres(reader, files))


def _read_centres(reader: Reader, files: DatasetFiles) -> Centres | None:
    if files.object_positions is None:
        return None
    return reader.read(OBJECT_POSITIONS, files.object_positions, "object_positions") or {}


def read_split(reader: Reader, name: str, path: Path, task: Task) -> Split:
    """Read an annotation file record by record."""
    annotations: list[Annotation] = []
    malformed: list[str] = []
    records = reader.read(ANNOTATIONS, path, "annotations")
    for number, record in enumerate(records or []):
        try:
            annotations.extend(msgspec.convert(record, task.annotation).parts)
        except msgspec.ValidationError as error:
            malformed.append(f"[{number}]: {', '.join(_faults(record, task)) or error}")
    return Split(name, path, annotations, malformed)


def _faults(record: object, task: Task) -> Iterator[str]:
    """Yield what is wrong with each field of a record; msgspec itself stops at the first."""
    if not isinstance(record, dict):
        return
    for known in msgspec.structs.fields(task.annotation):
        name = known.encode_name
        if name not in record:
            if known.required:
                yield f"{name} is missing"
            continue
        try:
            msgspec.convert(record[name], known.type)
        except msgspec.ValidationError as error:
            yield f"{name}: {error}"
