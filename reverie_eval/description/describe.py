"""Describe the published files of a dataset: read them once, and count what is in them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from reverie_eval.description.dataset import DatasetDescription
from reverie_eval.description.tasks import task_facts
from reverie_eval.errors import DatasetError
from reverie_eval.ground_truth.candidates import check_boxes
from reverie_eval.ground_truth.dataset import (
    DatasetFiles,
    Sources,
    Track,
    connectivity_files,
    untracked,
)
from reverie_eval.ground_truth.graph import NavigationGraph
from reverie_eval.ground_truth.navigation import read_navigation_graph
from reverie_eval.ground_truth.tasks import check_tasks, has_answers
from reverie_eval.schemas.dataset import ObjectBoxes

_ORDER = ("train", "val_seen", "val_unseen", "test")


def find_splits(
    root: Path | None = None,
    *,
    annotations: Path | None = None,
    boxes: Path | None = None,
    connectivity: Path | None = None,
) -> Mapping[str, DatasetFiles]:
    """Locate the published files of every split.

    Parameters
    ----------
    root : Path, optional
        A clone of the dataset repository, for whatever is not pointed at.
    annotations : Path, optional
        A folder whose ``REVERIE_{split}.json`` are a split each, or one such file, for it alone.
    boxes, connectivity : Path, optional
        As for :meth:`DatasetFiles.find`.

    Raises
    ------
    DatasetError
        Naming each of them that is not there.
    """
    files = DatasetFiles.find(
        None, root, annotations=annotations, boxes=boxes, connectivity=connectivity
    )
    found = files.all_annotations()
    if files.annotations == annotations:
        found = {split: path for split, path in found.items() if path == annotations}
    splits = [*(split for split in _ORDER if split in found), *sorted(found.keys() - {*_ORDER})]
    return {split: replace(files, annotations=found[split]) for split in splits}


def describe_dataset(
    files: Mapping[str, DatasetFiles], *, track: Track = untracked
) -> DatasetDescription:
    """Describe splits of one dataset.

    Whatever keeps a split from being counted is checked as when it is compiled. A target that is
    not visible at its goal is not: it is counted and said, for the paper's own train split has one.

    Parameters
    ----------
    files : mapping
        Where the published files of each split are; boxes and connectivity are those of the first.
    track : callable, optional
        Shows progress; called with the files about to be read and a description.

    Raises
    ------
    DatasetError
        Listing everything that is wrong with the files, with counts.
    """
    sources = {split: Sources(place, track) for split, place in files.items()}
    tasks = {split: source.tasks() for split, source in sources.items()}
    _raise_problems(sources.values())
    common = next(iter(sources.values()))
    scans = sorted({task.scan for task in chain.from_iterable(tasks.values())})
    graph = read_navigation_graph(common, scans)
    for split, source in sources.items():
        check_tasks(source, tasks[split], graph)
    answered = [split for split, source in sources.items() if has_answers(source, tasks[split])]
    boxes = _read_boxes(common, scans, graph) if answered else {}
    viewpoint_counts = _viewpoint_counts(common, scans, graph)
    _raise_problems(sources.values())
    facts = {split: task_facts(split, tasks[split], graph, boxes) for split in tasks}
    return DatasetDescription.of(facts, viewpoint_counts)


def _read_boxes(
    sources: Sources, scans: Sequence[str], graph: NavigationGraph
) -> Mapping[str, Mapping[str, ObjectBoxes]]:
    boxes = sources.boxes(scans)
    check_boxes(sources, boxes, graph)
    return boxes


def _viewpoint_counts(
    sources: Sources, scans: Sequence[str], graph: NavigationGraph
) -> Mapping[str, int]:
    """Count the included viewpoints of the scans, whose graph it is, and of all others."""
    others = connectivity_files(sources.files.connectivity).keys() - set(scans)
    sizes = np.bincount(graph.viewpoint_scan, minlength=len(graph.scan_ids)).tolist()
    return dict(zip(graph.scan_ids, sizes, strict=True)) | {
        scan: sum(viewpoint.included for viewpoint in viewpoints)
        for scan, viewpoints in sources.graphs(sorted(others)).items()
    }


def _raise_problems(sources: Iterable[Sources]) -> None:
    """Raise what any of the sources has noted, split by split."""
    problems = [problem for source in sources for problem in source.problems]
    if problems:
        numbered = enumerate(problems)
        raise DatasetError([replace(problem, position=(n,)) for n, problem in numbered])
