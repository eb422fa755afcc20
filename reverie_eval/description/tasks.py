"""From a split's tasks to what each of them adds to a description."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reverie_eval.ground_truth.graph import NavigationGraph
from reverie_eval.schemas.dataset import ObjectBoxes, Task
from reverie_eval.wording import category_in_words
from reverie_eval.words import words_of

Boxes = Mapping[str, Mapping[str, ObjectBoxes]]
"""The listed objects by viewpoint id and object id."""


@dataclass(frozen=True, slots=True)
class AnswerFacts:
    """What is known of a task that names its target."""

    target: tuple[str, str, int]
    """Split, scan and object id."""
    category: str
    """The target's name; empty if no viewpoint lists the target."""
    is_visible: bool
    """Whether the target is visible at the goal."""
    path_steps: int
    """Moves of the annotated path: its viewpoints less one."""
    path_length: float
    """Metres of the annotated path along the navigation graph."""
    goal_objects: int
    """Objects that are visible at the goal."""
    goal_boxes: int
    """Boxes of these objects in all views of the goal."""


@dataclass(frozen=True, slots=True)
class TaskFacts:
    """What is known of a task."""

    scan: str
    words: Sequence[Sequence[str]]
    """The words of each instruction."""
    answer: AnswerFacts | None
    """None where the annotations name no target."""


def task_facts(
    split: str, tasks: Sequence[Task], graph: NavigationGraph, boxes: Boxes
) -> Sequence[TaskFacts]:
    """Take down what each task adds to the description of its split."""
    answers = _answers(split, tasks, graph, boxes)
    return [
        TaskFacts(
            scan=task.scan,
            words=[words_of(instruction) for instruction in task.instructions],
            answer=answer,
        )
        for task, answer in zip(tasks, answers, strict=True)
    ]


def _answers(
    split: str, tasks: Sequence[Task], graph: NavigationGraph, boxes: Boxes
) -> Iterator[AnswerFacts | None]:
    names = _object_names(graph, boxes)
    for task in tasks:
        if task.objId is None:
            yield None
            continue
        listed = boxes.get(task.path[-1], {})
        visible = {key: seen for key, seen in listed.items() if seen.visible_pos}
        yield AnswerFacts(
            target=(split, task.scan, task.objId),
            category=names.get((task.scan, str(task.objId)), ""),
            is_visible=str(task.objId) in visible,
            path_steps=len(task.path) - 1,
            path_length=_path_length(task, graph),
            goal_objects=len(visible),
            goal_boxes=sum(len(seen.visible_pos) for seen in visible.values()),
        )


def _object_names(graph: NavigationGraph, boxes: Boxes) -> Mapping[tuple[str, str], str]:
    """Name the objects by scan and id."""
    return {
        (graph.scan_of(viewpoint), key): category_in_words(seen.name)
        for viewpoint, viewpoint_id in enumerate(graph.viewpoint_ids)
        for key, seen in boxes.get(viewpoint_id, {}).items()
    }


def _path_length(task: Task, graph: NavigationGraph) -> float:
    path = np.array([graph.index[viewpoint_id] for viewpoint_id in task.path])
    return float(graph.distance_between(path[:-1], path[1:]).sum())
