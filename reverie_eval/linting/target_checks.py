"""Whether a split's targets can be seen where their paths end, as they all can in a release."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.linting.annotations import Split, places_of, target_of
from reverie_eval.linting.box_size_checks import largest_area
from reverie_eval.linting.boxes import Boxes
from reverie_eval.linting.rows import Count, Found, Spread, fact, fault, remark, spread
from reverie_eval.schemas.dataset import Task

_MIXED = (
    "Annotations and boxes of different releases look like this (v2 annotations of val_seen with "
    "v1 boxes: 3 of 501): fetch both from one."
)


@dataclass(frozen=True, eq=False)
class Targets:
    """The targets of tasks among the listed objects."""

    tasks: Sequence[Task]
    at_start: IntArray
    """Shape (n_tasks,): the target's entry at the start, -1 where it is not listed."""
    at_goal: IntArray
    boxes: Boxes

    @property
    def is_unlisted(self) -> BoolArray:
        """Whether each target is not listed at the goal."""
        return self.at_goal < 0

    @property
    def is_visible(self) -> BoolArray:
        """Whether each target is visible at the goal."""
        return self.shown_at(self.at_goal)

    def shown_at(self, entry: IntArray) -> BoolArray:
        """Whether there is an entry, and a view in it."""
        views = np.append(self.boxes.n_views, 0)
        return np.asarray(views[entry] > 0)


def targets_of(split: Split, boxes: Boxes) -> Targets:
    """Look up the targets of a split's placed tasks at start and goal."""
    tasks = split.answered
    start, goal = (
        np.array(
            [boxes.entry_at.get((places_of(task)[end], target_of(task)), -1) for task in tasks],
            dtype=np.int64,
        )
        for end in (0, -1)
    )
    return Targets(tasks, start, goal, boxes)


def target_counts(split: Split, targets: Targets) -> list[Count]:
    """Count a split's targets, and those that mixed files lose."""
    objects = {(task.scan, target_of(task)) for task in targets.tasks}
    silent = [task.id for task in split.tasks if task.objId is None]
    seen_from = _viewpoints(targets)

    def name(row: int) -> str:
        return targets.tasks[row].id

    return [
        fact("targets", "different objects that are a target", len(objects)),
        fault(
            "missing-answer",
            "tasks without objId in a file where others have one",
            "Give every task its objId, or none (the form of the published test file).",
            Found.among(silent, len(split.tasks)),
        ),
        fault(
            "target-not-listed",
            "tasks whose target is not listed where the path ends",
            _MIXED,
            Found.where(targets.is_unlisted, name),
        ),
        fault(
            "target-not-visible",
            "tasks whose target is listed where the path ends, but no view shows it",
            _MIXED,
            Found.where(~targets.is_unlisted & ~targets.is_visible, name),
        ),
        remark(
            "target-at-start",
            "tasks whose target is visible where the path begins",
            "An agent that stays where it is succeeds.",
            Found.where(targets.shown_at(targets.at_start), name),
        ),
        fact(
            "single-goal",
            "tasks whose target is visible from one viewpoint only",
            int((seen_from == 1).sum()),
            len(seen_from),
        ),
    ]


def target_spreads(targets: Targets) -> list[Spread]:
    """Measure how hard the targets are to see, and how much else there is."""
    boxes = targets.boxes
    seen = targets.at_goal[targets.is_visible]
    goal = boxes.place[targets.at_goal[~targets.is_unlisted]]
    visible = np.bincount(boxes.place[boxes.is_visible], minlength=len(boxes.places))
    n_boxes = np.bincount(boxes.place, boxes.n_boxes, minlength=len(boxes.places))
    views, area = boxes.n_views[seen], largest_area(boxes)[seen]
    return [
        spread("viewpoints-per-target", "viewpoints that see the target", "", _viewpoints(targets)),
        spread("views-per-target", "views that show the target at the goal", "", views),
        spread("target-area", "largest box of the target at the goal", "px", area),
        spread("objects-at-goal", "objects visible at the goal", "", visible[goal]),
        spread("boxes-at-goal", "boxes at the goal", "", n_boxes[goal]),
    ]


def _viewpoints(targets: Targets) -> IntArray:
    """Shape (n_listed,): from how many viewpoints each target listed at its goal is visible."""
    boxes = targets.boxes
    seen, number = np.unique(boxes.scan_object[boxes.is_visible], return_counts=True)
    target = boxes.scan_object[targets.at_goal[~targets.is_unlisted]]
    slot = np.searchsorted(seen, target)
    found = np.append(seen, -1)[slot] == target
    return np.where(found, np.append(number, 0)[slot], 0)
