"""Whether a split's tasks can be told apart, and whether their paths can be walked."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from reverie_eval.linting.annotations import Split
from reverie_eval.linting.rows import Count, Found, fact, fault, remark
from reverie_eval.schemas.dataset import Task


def task_counts(split: Split, elsewhere: Mapping[str, Sequence[str]]) -> list[Count]:
    """Count a split's tasks and whatever keeps them from being scored.

    Parameters
    ----------
    split : Split
        The split.
    elsewhere : mapping from str to sequence of str
        The instr_ids of every other split by its name.
    """
    tasks = split.tasks
    return [
        fact("tasks", "tasks", len(tasks)),
        fact("episodes", "episodes, one per instruction", len(split.episodes)),
        fact("task-scans", "scans with a task", len({task.scan for task in tasks})),
        fault(
            "malformed-task",
            "records that are no tasks of the published form",
            "They are not counted below. Fetch the file again, or mend what wrote it.",
            Found.among(split.malformed, len(tasks) + len(split.malformed)),
        ),
        *_identities(split.episodes, elsewhere),
        *_places(split),
        *_ways(split),
    ]


def _identities(episodes: Sequence[str], elsewhere: Mapping[str, Sequence[str]]) -> list[Count]:
    counts = Counter(episodes)
    repeated = [instr_id for instr_id, count in counts.items() if count > 1]
    splits_of = {id_: split for split, ids in elsewhere.items() for id_ in ids}
    shared = [f"{id_} of {splits_of[id_]}" for id_ in counts if id_ in splits_of]
    return [
        fault(
            "duplicate-episode",
            "instr_ids of more than one episode",
            "A submission has one prediction per instr_id: give every task an id of its own.",
            Found.among(repeated, len(counts)),
        ),
        fault(
            "shared-episode",
            "instr_ids that another split has too",
            "A prediction for one split could be taken for the other's: keep the ids apart.",
            Found.among(shared, len(counts)),
        ),
    ]


def _places(split: Split) -> list[Count]:
    scans = split.graphs.scans
    return [
        fault(
            "unknown-scan",
            "tasks in a scan without a navigation graph",
            "Copy the whole connectivity folder.",
            _tasks(split.tasks, lambda task: task.scan not in scans),
        ),
        fault(
            "unknown-viewpoint",
            "tasks with a viewpoint on their path that is no node of their scan's graph",
            "Annotations and connectivity files belong to different datasets.",
            _tasks(split.tasks, lambda task: task.scan in scans and not split.is_placed(task)),
        ),
    ]


def _ways(split: Split) -> list[Count]:
    scans = split.graphs.scans

    def is_cut_off(task: Task) -> bool:
        scan = scans[task.scan]
        return len({scan.component[scan.row[id_]] for id_ in task.path}) > 1

    def leaves_the_edges(task: Task) -> bool:
        scan = scans[task.scan]
        return any(a != b and not scan.has_edge(a, b) for a, b in pairwise(task.path))

    return [
        fault(
            "unreachable-goal",
            "tasks with a viewpoint on their path that no route leads to",
            "They cannot be scored: distances would be infinite.",
            _tasks(split.placed, is_cut_off),
        ),
        remark(
            "path-off-edges",
            "tasks whose path steps between viewpoints that no edge joins",
            "Such a step is priced at the shortest route.",
            _tasks(split.placed, leaves_the_edges),
        ),
    ]


def _tasks(tasks: Sequence[Task], is_meant: Callable[[Task], bool]) -> Found:
    return Found.among([task.id for task in tasks if is_meant(task)], len(tasks))
