"""Rules for annotations: identities, paths in the navigation graphs, and targets at the goals."""

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from reverie_eval.arrays import BoolArray
from reverie_eval.dataset._records import Task
from reverie_eval.dataset._rules import Found, Rule, Spread, error, info, spread, warning
from reverie_eval.dataset._splits import Targets, Tasks


def _malformed(tasks: Tasks) -> Found:
    malformed = tasks.split.malformed
    return Found.among(malformed, len(tasks.split.tasks) + len(malformed))


def _duplicate_episodes(tasks: Tasks) -> Found:
    counts = Counter(tasks.split.instr_ids)
    return Found.among([id_ for id_, count in counts.items() if count > 1], len(counts))


def _shared_episodes(tasks: Tasks) -> Found:
    instr_ids = list(dict.fromkeys(tasks.split.instr_ids))
    shared = [f"{id_} of {tasks.elsewhere[id_]}" for id_ in instr_ids if id_ in tasks.elsewhere]
    return Found.among(shared, len(instr_ids))


def _among(tasks: Tasks, which: Callable[[Task], bool]) -> Found:
    all_tasks = tasks.split.tasks
    return Found.among([task.id for task in all_tasks if which(task)], len(all_tasks))


def _without_graph(tasks: Tasks) -> Found:
    graphs = tasks.graphs
    return _among(tasks, lambda task: not graphs.has_file(task.scan))


def _off_the_graph(tasks: Tasks) -> Found:
    scans = tasks.graphs.scans
    return _among(tasks, lambda task: task.scan in scans and not tasks.is_placed(task))


def _unreachable(tasks: Tasks) -> Found:
    scans = tasks.graphs.scans

    def is_cut_off(task: Task) -> bool:
        scan = scans[task.scan]
        return len({scan.component[scan.row[id_]] for id_ in task.path}) > 1

    return Found.among([task.id for task in tasks.placed if is_cut_off(task)], len(tasks.placed))


def _off_the_edges(tasks: Tasks) -> Found:
    scans = tasks.graphs.scans

    def leaves_the_edges(task: Task) -> bool:
        scan = scans[task.scan]
        return any(a != b and not scan.has_edge(a, b) for a, b in pairwise(task.path))

    off = [task.id for task in tasks.placed if leaves_the_edges(task)]
    return Found.among(off, len(tasks.placed))


TASK_RULES: Sequence[Rule[Tasks]] = (
    info("tasks", "tasks", lambda tasks: Found(len(tasks.split.tasks))),
    info(
        "episodes",
        "episodes, one per instruction",
        lambda tasks: Found(len(tasks.split.instr_ids)),
    ),
    info("task-scans", "scans with a task", lambda tasks: Found(len(tasks.split.scans))),
    error(
        "malformed-task",
        "records that are not tasks of the published form",
        "They are left out of all other counts. Fetch the file again, or fix what wrote it.",
        _malformed,
    ),
    error(
        "duplicate-episode",
        "instr_ids of more than one episode",
        "A submission has one prediction per instr_id: give every task an id of its own.",
        _duplicate_episodes,
    ),
    warning(
        "shared-episode",
        "instr_ids that another split has too",
        "A submission to the other split looks like one to this: keep the ids apart.",
        _shared_episodes,
    ),
    error(
        "missing-scan",
        "tasks in a scan without a connectivity file",
        "Copy the whole connectivity folder.",
        _without_graph,
    ),
    error(
        "unknown-viewpoint",
        "tasks with a viewpoint on their path that is not in their scan's graph",
        "Annotations and connectivity files belong to different datasets.",
        _off_the_graph,
    ),
    error(
        "unreachable-goal",
        "tasks with a viewpoint on their path that no route leads to",
        "They cannot be scored: distances would be infinite.",
        _unreachable,
    ),
    warning(
        "path-off-edges",
        "tasks whose path moves between unconnected viewpoints",
        "Such a move counts at shortest-path distance.",
        _off_the_edges,
    ),
)

_MIXED_RELEASES = (
    "Annotations and boxes of different releases look like this (v2 annotations of val_seen with "
    "v1 boxes: 3 of 501): fetch both from one."
)


def _without_target(targets: Targets) -> Found:
    tasks = targets.split.tasks
    return Found.among([task.id for task in tasks if task.objId is None], len(tasks))


def _where(targets: Targets, mask: BoolArray) -> Found:
    return Found.where(mask, lambda row: targets.tasks[row].id)


def _not_listed(targets: Targets) -> Found:
    return _where(targets, targets.at_goal < 0)


def _not_visible(targets: Targets) -> Found:
    return _where(targets, (targets.at_goal >= 0) & ~targets.is_visible(targets.at_goal))


def _visible_at_start(targets: Targets) -> Found:
    return _where(targets, targets.is_visible(targets.at_start))


def _single_goals(targets: Targets) -> Found:
    return Found(int((targets.n_viewpoints == 1).sum()), len(targets.n_viewpoints))


TARGET_RULES: Sequence[Rule[Targets]] = (
    info(
        "targets",
        "different objects that are a target",
        lambda targets: Found(len({(task.scan, task.target) for task in targets.tasks})),
    ),
    error(
        "missing-answer",
        "tasks without objId in a file where others have one",
        "Give every task its objId, or none (the form of the published test file).",
        _without_target,
    ),
    error(
        "target-not-listed",
        "tasks whose target is not listed where the path ends",
        _MIXED_RELEASES,
        _not_listed,
        tolerated_by=["describe"],
    ),
    error(
        "target-not-visible",
        "tasks whose target is listed where the path ends, but not visible in any view",
        _MIXED_RELEASES,
        _not_visible,
        # The paper's own train split has one: it is described with a note.
        tolerated_by=["describe"],
    ),
    warning(
        "target-at-start",
        "tasks whose target is visible where the path begins",
        "An agent that does not move succeeds.",
        _visible_at_start,
    ),
    info(
        "single-goal",
        "tasks whose target is visible from one viewpoint only",
        _single_goals,
    ),
)


def target_spreads(targets: Targets) -> list[Spread]:
    """Measure how hard the targets are to see, and how much else is there."""
    boxes = targets.boxes
    visible_target = targets.at_goal[targets.is_visible(targets.at_goal)]
    goal = boxes.viewpoint[targets.at_goal[targets.at_goal >= 0]]
    visible = np.bincount(boxes.viewpoint[boxes.is_visible], minlength=len(boxes.viewpoints))
    n_boxes = np.bincount(boxes.viewpoint, boxes.n_boxes, minlength=len(boxes.viewpoints))
    views, area = boxes.n_views[visible_target], boxes.largest_area[visible_target]
    seen_from = targets.n_viewpoints
    return [
        spread("viewpoints-per-target", "viewpoints that see the target", "", seen_from),
        spread("views-per-target", "views that show the target at the goal", "", views),
        spread("target-area", "largest box of the target at the goal", "px", area),
        spread("objects-at-goal", "objects visible at the goal", "", visible[goal]),
        spread("boxes-at-goal", "boxes at the goal", "", n_boxes[goal]),
    ]
