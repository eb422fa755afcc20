"""The content of a dataset's files, valid or not: splits with their tasks, graphs and boxes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.dataset._boxes import Boxes, read_boxes
from reverie_eval.dataset._files import DatasetFiles, find_graphs
from reverie_eval.dataset._graphs import Graphs, read_graphs
from reverie_eval.dataset._reader import Progress, Reader, explain
from reverie_eval.dataset._records import OBJECT_POSITIONS, TASKS, Position, Task

Centres = Mapping[str, Mapping[str, Position]]
"""Centres of objects by scan and object id, metres."""


@dataclass(frozen=True, eq=False)
class Split:
    """The records of an annotation file."""

    name: str
    path: Path
    tasks: Sequence[Task]
    malformed: Sequence[str] = ()
    """Records that do not have the form of a task, with the reason."""

    @property
    def scans(self) -> set[str]:
        """The scans of the tasks."""
        return {task.scan for task in self.tasks}

    @property
    def instr_ids(self) -> list[str]:
        """The ids of the episodes, in the order of the file."""
        return [instr_id for task in self.tasks for instr_id in task.instr_ids]

    @property
    def has_answers(self) -> bool:
        """Whether any task has a target; the published test file has none."""
        return any(task.objId is not None for task in self.tasks)


@dataclass(frozen=True, eq=False)
class Tasks:
    """The tasks of a split in the navigation graphs."""

    split: Split
    graphs: Graphs
    other_splits: Mapping[str, str] = field(default_factory=dict)
    """The split of each instr_id that another split has."""

    def is_on_graph(self, task: Task) -> bool:
        """Whether every viewpoint of a task's path is in the graph of its scan."""
        return all(map(self.graphs.is_node, task.viewpoints))

    @cached_property
    def on_graph(self) -> Sequence[Task]:
        """The tasks whose whole path is in the graph; the others cannot be checked any further."""
        return [task for task in self.split.tasks if self.is_on_graph(task)]

    @cached_property
    def with_target(self) -> Sequence[Task]:
        """The tasks on the graph that have a target."""
        return [task for task in self.on_graph if task.objId is not None]


@dataclass(frozen=True, eq=False)
class Targets:
    """The targets of a split's tasks among the listed objects."""

    split: Split
    tasks: Sequence[Task]
    """The tasks that have a target and whose whole path is in the graph."""
    boxes: Boxes

    @cached_property
    def at_start(self) -> IntArray:
        """Shape (n_tasks,): the entry of each target at the start; -1 if not listed there."""
        return self._entries(0)

    @cached_property
    def at_goal(self) -> IntArray:
        """Shape (n_tasks,): the entry of each target at the goal; -1 if not listed there."""
        return self._entries(-1)

    def is_visible(self, entry: IntArray) -> BoolArray:
        """Whether the entry exists, and a view shows the object."""
        # Index -1, for no entry, picks the 0 that is appended.
        n_views = np.append(self.boxes.n_views, 0)
        return np.asarray(n_views[entry] > 0)

    @cached_property
    def n_viewpoints(self) -> IntArray:
        """Shape (n_listed,): viewpoints that see each target, of targets listed at their goal."""
        boxes = self.boxes
        visible, number = np.unique(boxes.scan_object[boxes.is_visible], return_counts=True)
        target = boxes.scan_object[self.at_goal[self.at_goal >= 0]]
        # A target larger than all visible objects has an index behind the last one: hence `append`.
        index = np.searchsorted(visible, target)
        is_visible = np.append(visible, -1)[index] == target
        return np.where(is_visible, np.append(number, 0)[index], 0)

    def _entries(self, end: int) -> IntArray:
        entry_at = self.boxes.entry_at
        entries = [entry_at.get((task.viewpoints[end], task.target), -1) for task in self.tasks]
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
    def has_answers(self) -> bool:
        """Whether any task has a target; boxes are needed only then."""
        return any(split.has_answers for split in self.splits)


def read_dataset(files: DatasetFiles, progress: Progress) -> Dataset:
    """Read all splits, and the graphs and boxes of all scans."""
    reader = Reader(progress)
    graphs = read_graphs(reader, find_graphs(files.connectivity))
    splits = [read_split(reader, name, path) for name, path in files.annotations.items()]
    boxes = read_boxes(reader, files.boxes, graphs)
    return Dataset(files, reader, splits, graphs, boxes, _read_centres(reader, files))


def read_one_split(files: DatasetFiles, name: str, progress: Progress) -> Dataset:
    """Read one split, and the graphs and boxes of its scans."""
    reader = Reader(progress)
    split = read_split(reader, name, files.annotations[name])
    graphs = read_graphs(reader, find_graphs(files.connectivity, split.scans))
    boxes = Boxes([], [], graphs)
    if split.has_answers:
        boxes = read_boxes(reader, files.boxes, graphs, split.scans)
    return Dataset(files, reader, [split], graphs, boxes, _read_centres(reader, files))


def _read_centres(reader: Reader, files: DatasetFiles) -> Centres | None:
    if files.object_positions is None:
        return None
    return reader.read(OBJECT_POSITIONS, files.object_positions, "object_positions") or {}


def read_split(reader: Reader, name: str, path: Path) -> Split:
    """Read an annotation file record by record."""
    tasks, malformed = [], []
    records = reader.read(TASKS, path, "annotations")
    for number, record in enumerate(records or []):
        try:
            tasks.append(Task.model_validate(record))
        except ValidationError as error:
            malformed.append(f"[{number}]: {explain(error)}")
    return Split(name, path, tasks, malformed)
