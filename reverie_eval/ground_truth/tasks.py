"""From annotations to the arrays of episodes, annotated paths and targets."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from reverie_eval.arrays import Array, offsets_of
from reverie_eval.ground_truth.dataset import Sources
from reverie_eval.ground_truth.graph import NavigationGraph
from reverie_eval.schemas.dataset import ObjectBoxes, Task
from reverie_eval.wording import counted, some


def episode_arrays(tasks: Sequence[Task], graph: NavigationGraph) -> dict[str, Array]:
    """Lay out what everybody may know: which episodes there are, and where each starts."""
    return {
        "instr_id": np.array([id_ for task in tasks for id_ in task.instr_ids], dtype=np.str_),
        "episode_task": np.repeat(np.arange(len(tasks)), [len(task.instr_ids) for task in tasks]),
        "task_start": np.array([graph.index[task.path[0]] for task in tasks]),
    }


def answer_arrays(tasks: Sequence[Task], graph: NavigationGraph) -> dict[str, Array]:
    """Lay out what a public bundle leaves out: the targets and the annotated paths."""
    return {
        "task_target": np.array([task.objId for task in tasks]),
        "path": np.array([graph.index[id_] for task in tasks for id_ in task.path]),
        "path_offsets": offsets_of(np.array([len(task.path) for task in tasks])),
    }


def episode_texts(tasks: Sequence[Task]) -> dict[str, list[str]]:
    """Return what everybody may read of the episodes."""
    return {"instruction": [text.strip() for task in tasks for text in task.instructions]}


def answer_texts(
    tasks: Sequence[Task], boxes: Mapping[str, Mapping[str, ObjectBoxes]]
) -> dict[str, list[str]]:
    """Return what the annotators call the targets, where the annotated paths end."""
    return {"target_category": [boxes[task.path[-1]][str(task.objId)].name for task in tasks]}


def has_answers(sources: Sources, tasks: Sequence[Task]) -> bool:
    """Whether the annotations name targets; some with and some without is a problem."""
    silent = [task for task in tasks if task.objId is None]
    if len(silent) < len(tasks):
        fault = "objId is missing {where}; the others have one"
        _report(sources, "missing-answer", fault, silent, len(tasks))
    return not silent


def check_tasks(sources: Sources, tasks: Sequence[Task], graph: NavigationGraph) -> None:
    """Report episodes that occur twice and annotated paths that cannot be walked."""
    counts = Counter(id_ for task in tasks for id_ in task.instr_ids)
    repeated = [instr_id for instr_id, count in counts.items() if count > 1]
    if repeated:
        sources.report(
            "duplicate-episode",
            sources.files.annotations,
            f"{counted(len(repeated), 'instr_id')} more than once: {some(repeated)}; every task "
            "needs an id of its own",
        )
    walked_scans = {graph.scan_of(viewpoint) for viewpoint in range(len(graph.viewpoint_ids))}
    known = [task for task in tasks if task.scan in walked_scans]  # the rest was reported
    inside = [task for task in known if _is_inside(task, graph)]
    outside = [task for task in known if not _is_inside(task, graph)]
    fault = "the path leaves the navigation graph {where}"
    _report(sources, "unknown-viewpoint", fault, outside, len(tasks))
    cut_off = [task for task in inside if not _is_connected(task, graph)]
    fault = "no route leads from the start to the goal, or to a viewpoint on the way, {where}"
    _report(sources, "unreachable-goal", fault, cut_off, len(tasks))


def check_targets(
    sources: Sources, tasks: Sequence[Task], boxes: Mapping[str, Mapping[str, ObjectBoxes]]
) -> None:
    """Report targets that cannot be seen where the annotated path ends.

    In matching releases every target can; in mixed ones a few per cent can not (v2 annotations
    with v1 boxes lose 3 of 501 targets of val_seen), and scores would be silently wrong.
    """
    listed = [boxes.get(task.path[-1], {}).get(str(task.objId)) for task in tasks]
    unlisted = [task for task, seen in zip(tasks, listed, strict=True) if seen is None]
    unseen = [
        task for task, seen in zip(tasks, listed, strict=True) if seen and not seen.visible_pos
    ]
    advice = "Annotations and boxes of different dataset versions look like this."
    fault = f"the target is not listed at the goal {{where}}. {advice}"
    _report(sources, "target-not-listed", fault, unlisted, len(tasks))
    fault = f"the target is listed at the goal, but no view shows it, {{where}}. {advice}"
    _report(sources, "target-not-visible", fault, unseen, len(tasks))


def _is_inside(task: Task, graph: NavigationGraph) -> bool:
    numbers = [graph.index.get(viewpoint_id) for viewpoint_id in task.path]
    return all(n is not None and graph.scan_of(n) == task.scan for n in numbers)


def _is_connected(task: Task, graph: NavigationGraph) -> bool:
    path = np.array([graph.index[viewpoint_id] for viewpoint_id in task.path])
    start = np.full_like(path, path[0])
    return bool(np.isfinite(graph.distance_between(start, path)).all())


def _report(sources: Sources, code: str, fault: str, tasks: Sequence[Task], total: int) -> None:
    if tasks:
        names = some(task.id for task in tasks)
        where = f"in {len(tasks)} of {counted(total, 'task')}: {names}"
        sources.report(code, sources.files.annotations, fault.format(where=where))
