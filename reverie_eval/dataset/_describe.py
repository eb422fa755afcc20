"""Describe a dataset: read its published files once, and count what is in them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal

import numpy as np
from pydantic import ConfigDict

from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._dataset import Split, read_dataset
from reverie_eval.dataset._description import ItemFacts, SplitDescription, TargetFacts
from reverie_eval.dataset._files import DatasetFiles
from reverie_eval.dataset._lint import check_sound
from reverie_eval.dataset._paper import PaperComparison, compare_with_paper
from reverie_eval.dataset._reader import Progress, no_progress
from reverie_eval.dataset._records import viewpoints_of
from reverie_eval.ground_truth import NavigationGraph
from reverie_eval.tasks import DEFAULT_TASK
from reverie_eval.text import category_text, count_text, tokenize
from reverie_eval.version import __version__


@dataclass(frozen=True, eq=False)
class DatasetDescription:
    """What a dataset contains, for REVERIE compared with the numbers in its paper."""

    __pydantic_config__: ClassVar = ConfigDict(
        use_attribute_docstrings=True, extra="forbid", arbitrary_types_allowed=True
    )

    splits: Mapping[str, SplitDescription]
    """Each split by itself."""
    total: SplitDescription
    """All splits together."""
    buildings: int
    """Scans that have a navigation graph, with or without items."""
    viewpoints: int
    """Included viewpoints of these graphs: panoramas."""
    paper: Sequence[PaperComparison]
    """The paper's numbers and those of this dataset; only for REVERIE."""
    notes: Sequence[str] = ()
    """What readers of the numbers should know, a sentence each."""
    schema_version: Literal[1] = 1
    version: str = __version__
    """Version of reverie-eval that described it."""


def describe_dataset(
    files: DatasetFiles, *, progress: Progress = no_progress
) -> DatasetDescription:
    """Describe the splits of a dataset.

    A target that is not visible at its goal is counted and noted, but is not an error: the
    published train split has one.

    Parameters
    ----------
    files : DatasetFiles
        Where the published files are.
    progress : callable, optional
        Shows progress; called with the files about to be read and a description.

    Raises
    ------
    DatasetError
        Listing all other problems that ``reverie-eval lint`` calls errors.
    """
    dataset = read_dataset(files, progress)
    check_sound(dataset, "describe")
    graph, boxes, task = dataset.graphs.ground_truth(), dataset.boxes, files.task
    facts = {split.name: list(_item_facts(split, graph, boxes)) for split in dataset.splits}
    viewpoint_counts = {
        scan_id: len(scan.viewpoint_ids) for scan_id, scan in dataset.graphs.scans.items()
    }

    # The paper gives several numbers for the same groups of splits.
    @cache
    def describe(splits: tuple[str, ...]) -> SplitDescription:
        return SplitDescription.of({split: facts[split] for split in splits}, viewpoint_counts)

    alone = {split: describe((split,)) for split in facts}
    buildings, viewpoints = len(viewpoint_counts), sum(viewpoint_counts.values())
    paper: Sequence[PaperComparison] = ()
    if task.name == DEFAULT_TASK:
        paper = compare_with_paper(alone, describe, buildings=buildings, viewpoints=viewpoints)
    return DatasetDescription(
        splits=alone,
        total=describe(tuple(facts)),
        buildings=buildings,
        viewpoints=viewpoints,
        paper=paper,
        notes=_notes(alone) if task.has_targets else (),
    )


def _notes(splits: Mapping[str, SplitDescription]) -> Sequence[str]:
    without = [name for name, split in splits.items() if split.targets is None]
    return [
        *(f"{name} has no targets: its goals and paths are unknown" for name in without),
        *(
            f"{name}: the target is not visible at the goal in {hidden:,} of "
            f"{count_text(split.items, 'item')}; `reverie-eval lint` lists them"
            for name, split in splits.items()
            if split.targets and (hidden := split.targets.hidden_targets)
        ),
    ]


def _item_facts(split: Split, graph: NavigationGraph, boxes: Boxes) -> Iterator[ItemFacts]:
    """Yield what each item adds to the description of its split."""
    names = {
        (boxes.viewpoints[viewpoint].scan_id, object_id): category_text(record.name)
        for viewpoint, object_id, record in boxes.entries
    }
    size = len(boxes.viewpoints)
    n_objects = np.bincount(boxes.viewpoint[boxes.is_visible], minlength=size).tolist()
    n_boxes = np.bincount(boxes.viewpoint[boxes.box_entry], minlength=size).tolist()
    visible_at = dict(zip(boxes.viewpoints, zip(n_objects, n_boxes, strict=True), strict=True))
    for item in split.items:
        target = None
        if item.target is not None:
            goal = viewpoints_of(item)[-1]
            entry = boxes.entry_at.get((goal, item.target))
            goal_objects, goal_boxes = visible_at.get(goal, (0, 0))
            path = np.array([graph.index[viewpoint_id] for viewpoint_id in item.reference])
            target = TargetFacts(
                object_key=(split.name, item.scan, item.target),
                category=names.get((item.scan, item.target), ""),
                is_visible=entry is not None and bool(boxes.is_visible[entry]),
                path_steps=len(item.reference) - 1,
                path_length=float(graph.distance_between(path[:-1], path[1:]).sum()),
                goal_objects=goal_objects,
                goal_boxes=goal_boxes,
            )
        yield ItemFacts(item.scan, [tokenize(text) for text in item.texts], target)
