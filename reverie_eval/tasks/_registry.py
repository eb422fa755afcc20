"""The tasks by name: those of this package, and those of other installed packages."""

from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from types import MappingProxyType

from reverie_eval.errors import ProtocolError
from reverie_eval.tasks._task import Protocol, Task
from reverie_eval.text import did_you_mean

DEFAULT_TASK = "reverie"
"""The task if none is named; signatures do not name it."""

ENTRY_POINTS = "reverie_eval.tasks"
"""The group of entry points by which other packages add a task: ``name = "module:TASK"``."""

BUILT_IN: Mapping[str, str] = MappingProxyType(
    {name: f"reverie_eval.tasks.{name}" for name in ("reverie", "r2r", "r4r", "rxr", "ndh", "soon")}
)
"""The modules of this package's tasks, each with its ``TASK``."""


def find_task(name: str) -> Task:
    """Return a task by its name; other packages' modules are imported only if one is named.

    Raises
    ------
    ProtocolError
        If there is no such task.
    """
    if name in BUILT_IN:
        task: Task = import_module(BUILT_IN[name]).TASK
        return task
    return _installed_task(name)


@cache
def _installed_task(name: str) -> Task:
    from importlib.metadata import entry_points  # takes longer than scoring a small file

    found = entry_points(group=ENTRY_POINTS, name=name)
    if not found:
        raise ProtocolError(f"unknown task {name!r}{did_you_mean(name, task_names())}")
    task = next(iter(found)).load()
    if not isinstance(task, Task) or task.name != name:
        raise ProtocolError(f"the entry point {name!r} of {ENTRY_POINTS} is not the Task {name!r}")
    return task


PROTOCOLS: Mapping[str, Protocol] = MappingProxyType(
    {protocol.name: protocol for protocol in find_task(DEFAULT_TASK).protocols}
)
"""Every released protocol of REVERIE by its name; the default comes first."""


def name_on_server(task: str, split: str) -> str:
    """Return the name that a server has for a split of a task.

    >>> name_on_server("reverie", "val_unseen"), name_on_server("r2r", "val_unseen")
    ('val_unseen', 'r2r-val_unseen')
    """
    return split if task == DEFAULT_TASK else f"{task}-{split}"


def task_names() -> Sequence[str]:
    """Return the names of all tasks, those of this package first."""
    from importlib.metadata import entry_points

    return [*BUILT_IN, *sorted(set(entry_points(group=ENTRY_POINTS).names) - BUILT_IN.keys())]
