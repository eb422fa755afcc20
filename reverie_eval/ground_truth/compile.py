"""Compile a split's published files into its bundle: once, so that scoring takes milliseconds.

Whatever is wrong with the files is found here and named with counts; a bundle that exists scores.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from reverie_eval.ground_truth.bundle import Bundle, pack
from reverie_eval.ground_truth.candidates import candidate_arrays, candidate_distances, check_boxes
from reverie_eval.ground_truth.dataset import DatasetFiles, Sources, Track, untracked
from reverie_eval.ground_truth.navigation import read_navigation_graph
from reverie_eval.ground_truth.tasks import (
    answer_arrays,
    answer_texts,
    check_targets,
    check_tasks,
    episode_arrays,
    episode_texts,
    has_answers,
)

_RELEASES: Mapping[tuple[str, int, int], str] = MappingProxyType(
    {
        ("val_seen", 515, 1423): "REVERIE v1",
        ("val_unseen", 1328, 3521): "REVERIE v1",
        ("test", 2304, 6292): "REVERIE v1",
        ("train", 4071, 10290): "REVERIE v2",
        ("val_seen", 501, 1384): "REVERIE v2",
        ("val_unseen", 1292, 3433): "REVERIE v2",
        ("test", 2244, 6144): "REVERIE v2",
    }
)
"""The splits of the known releases, with their numbers of tasks and instructions."""


def compile_split(
    files: DatasetFiles, split: str, *, dataset: str | None = None, track: Track = untracked
) -> Bundle:
    """Compile one split.

    Annotations without answers (the published test file) give a public bundle; annotations with
    ``objId`` and the full ``path`` give a bundle that scores.

    Parameters
    ----------
    files : DatasetFiles
        Where the published files are.
    split : str
        The split's name, written into the bundle.
    dataset : str, optional
        The release's name; recognised by the split's size if not given.
    track : callable, optional
        Shows progress; called with the files about to be read and a description.

    Raises
    ------
    DatasetError
        Listing everything that is wrong with the files, with counts.
    """
    sources = Sources(files, track)
    tasks = sources.tasks()
    sources.raise_problems()
    scans = sorted({task.scan for task in tasks})
    graph = read_navigation_graph(sources, scans)
    check_tasks(sources, tasks, graph)
    answered = has_answers(sources, tasks)
    found = len(sources.problems)
    boxes = sources.boxes(scans) if answered else {}
    if answered and len(sources.problems) == found:
        check_boxes(sources, boxes, graph)
        check_targets(sources, tasks, boxes)
    positions = sources.object_positions()
    sources.raise_problems()
    arrays = graph.to_arrays() | episode_arrays(tasks, graph)
    texts = episode_texts(tasks)
    if answered:
        arrays |= answer_arrays(tasks, graph) | candidate_arrays(boxes, graph)
        texts |= answer_texts(tasks, boxes)
    if answered and positions is not None:
        arrays["candidate_distance"] = candidate_distances(arrays, positions, graph)
    size = split, len(tasks), len(arrays["instr_id"])
    return Bundle.build(
        split=split,
        dataset=dataset or _RELEASES.get(size, "custom"),
        sources=sources.digests(),
        arrays=arrays,
        other_splits={
            name: np.array(ids) for name, ids in sources.other_splits().items() if name != split
        },
        texts={name: pack(text) for name, text in texts.items()},
    )
