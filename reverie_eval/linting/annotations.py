"""The annotations of all splits, record by record."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from reverie_eval.ground_truth.dataset import explain
from reverie_eval.linting.graphs import Graphs, Place
from reverie_eval.linting.reader import Reader
from reverie_eval.schemas.dataset import Task

_FILE = TypeAdapter(Annotated[list[Any], Field(min_length=1)])


@dataclass(frozen=True, eq=False)
class Split:
    """The tasks of a split, and where they are in the navigation graphs."""

    name: str
    tasks: Sequence[Task]
    malformed: Sequence[str]
    """Records that are no tasks, with the reason."""
    graphs: Graphs

    @property
    def episodes(self) -> list[str]:
        """The instr_ids, as often as they are there."""
        return [instr_id for task in self.tasks for instr_id in task.instr_ids]

    def is_placed(self, task: Task) -> bool:
        """Whether every viewpoint of a task's path is a node of its scan's graph."""
        return all(map(self.graphs.is_node, places_of(task)))

    @cached_property
    def has_answers(self) -> bool:
        """Whether tasks name their targets; those of the published test file do not."""
        return any(task.objId is not None for task in self.tasks)

    @cached_property
    def placed(self) -> Sequence[Task]:
        """Tasks whose whole path is in the navigation graph of their scan."""
        return [task for task in self.tasks if self.is_placed(task)]

    @cached_property
    def answered(self) -> Sequence[Task]:
        """Placed tasks that name their target."""
        return [task for task in self.placed if task.objId is not None]


def places_of(task: Task) -> list[Place]:
    """Return the viewpoints of a task's path, the goal last."""
    return [Place(task.scan, viewpoint_id) for viewpoint_id in task.path]


def target_of(task: Task) -> int:
    """Return the target of a task that names it."""
    if task.objId is None:
        raise ValueError(f"task {task.id} names no target")
    return task.objId


def read_splits(reader: Reader, files: Mapping[str, Path], graphs: Graphs) -> list[Split]:
    """Read the annotation files of splits by name."""
    return [_read_split(reader, name, path, graphs) for name, path in files.items()]


def _read_split(reader: Reader, name: str, path: Path, graphs: Graphs) -> Split:
    tasks, malformed = [], []
    records = reader.read(_FILE, path)
    for number, record in enumerate(records or []):
        try:
            tasks.append(Task.model_validate(record))
        except ValidationError as error:
            malformed.append(f"[{number}]: {explain(error)}")
    return Split(name, tasks, malformed, graphs)
