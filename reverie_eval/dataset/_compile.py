"""Compile a split's published files into its bundle: once, so that scoring takes milliseconds.

Whatever is wrong with the files is found here, and a bundle that exists scores.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from reverie_eval.arrays import Array, FloatArray, offsets_of
from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._dataset import Centres, read_one_split
from reverie_eval.dataset._files import DatasetFiles
from reverie_eval.dataset._lint import check_sound
from reverie_eval.dataset._reader import Progress, Reader, no_progress
from reverie_eval.dataset._records import Task
from reverie_eval.dataset._splits import read_split
from reverie_eval.ground_truth import Bundle, NavigationGraph, pack_texts

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
    files: DatasetFiles,
    split: str,
    *,
    dataset: str | None = None,
    progress: Progress = no_progress,
) -> Bundle:
    """Compile one split.

    Annotations without answers (the published test file) give a public bundle; annotations with
    ``objId`` and the full ``path`` give a bundle that scores.

    Parameters
    ----------
    files : DatasetFiles
        Where the published files are. Annotations of other splits are used in messages only.
    split : str
        The split's name, written into the bundle.
    dataset : str, optional
        The release's name; recognised by the split's size if not given.
    progress : callable, optional
        Shows progress; called with the files about to be read and a description.

    Raises
    ------
    DatasetError
        Listing everything that is wrong with the files that the split needs: what
        ``reverie-eval lint`` calls an error.
    """
    content = read_one_split(files, split, progress)
    check_sound(content, "compile")
    (annotations,), boxes, centres = content.splits, content.boxes, content.centres
    graph, tasks = content.graphs.ground_truth(), annotations.tasks
    arrays = graph.to_arrays() | _episode_arrays(tasks, graph)
    texts = {"instruction": [text.strip() for task in tasks for text in task.instructions]}
    if content.has_answers:
        arrays |= _answer_arrays(tasks, graph) | _candidate_arrays(boxes, graph)
        texts["target_category"] = _target_categories(tasks, boxes)
        if centres is not None:
            arrays["candidate_distance"] = _candidate_distances(arrays, centres, graph)
    size = split, len(tasks), len(annotations.instr_ids)
    return Bundle.build(
        split=split,
        dataset=dataset or _RELEASES.get(size, "custom"),
        sources=content.reader.digests(),
        arrays=arrays,
        other_splits={
            name: instr_ids
            for name, path in files.annotations.items()
            if name != split and (instr_ids := _read_instr_ids(path)).size
        },
        texts={name: pack_texts(text) for name, text in texts.items()},
    )


def _read_instr_ids(path: Path) -> Array:
    """Read the episodes of another split, which serve messages only: its faults do not matter."""
    return np.array(read_split(Reader(), "", path).instr_ids, dtype=np.str_)


def _episode_arrays(tasks: Sequence[Task], graph: NavigationGraph) -> dict[str, Array]:
    """Lay out what is public: the episodes, and where each starts."""
    return {
        "instr_id": np.array([id_ for task in tasks for id_ in task.instr_ids], dtype=np.str_),
        "episode_task": np.repeat(np.arange(len(tasks)), [len(task.instr_ids) for task in tasks]),
        "task_start": np.array([graph.index[task.path[0]] for task in tasks]),
    }


def _answer_arrays(tasks: Sequence[Task], graph: NavigationGraph) -> dict[str, Array]:
    """Lay out what a public bundle leaves out: the targets and the annotated paths."""
    return {
        "task_target": np.array([task.target for task in tasks]),
        "path": np.array([graph.index[id_] for task in tasks for id_ in task.path]),
        "path_offsets": offsets_of(np.array([len(task.path) for task in tasks])),
    }


def _target_categories(tasks: Sequence[Task], boxes: Boxes) -> list[str]:
    """Return what the annotators call the targets, where the annotated paths end."""
    entries = [boxes.entry_at[task.viewpoints[-1], task.target] for task in tasks]
    return [boxes.entries[entry].record.name for entry in entries]


def _candidate_arrays(boxes: Boxes, graph: NavigationGraph) -> dict[str, Array]:
    """List the visible objects of every viewpoint with their boxes, by viewpoint and object id."""
    # Viewpoints that are not included have no number, and their boxes are left out.
    numbers = [graph.index.get(key.viewpoint_id, -1) for key in boxes.viewpoints]
    viewpoint = np.array(numbers, np.int64)[boxes.viewpoint]
    object_id = np.array([object_id for _, object_id, _ in boxes.entries], np.int64)
    by_viewpoint = np.lexsort((object_id, viewpoint))
    entry = by_viewpoint[(boxes.is_visible & (viewpoint >= 0))[by_viewpoint]]
    candidate_of = np.full(len(boxes.entries), -1)
    candidate_of[entry] = np.arange(len(entry))
    candidate = candidate_of[boxes.box_entry]
    box = np.argsort(candidate, kind="stable")[np.count_nonzero(candidate < 0) :]
    return {
        "candidate_viewpoint": viewpoint[entry],
        "candidate_object": object_id[entry],
        "box_candidate": candidate[box],
        "box_view": boxes.box_view[box],
        "box_xywh": boxes.box_xywh[box],
    }


def _candidate_distances(
    candidates: Mapping[str, Array], centres: Centres, graph: NavigationGraph
) -> FloatArray:
    """Measure from each candidate's camera to its centre; inf where the centre is not known."""
    unknown = (np.inf, np.inf, np.inf)
    viewpoint = candidates["candidate_viewpoint"]
    objects = candidates["candidate_object"].tolist()
    centre = [
        centres.get(graph.scan_of(number), {}).get(str(object_id), unknown)
        for number, object_id in zip(viewpoint.tolist(), objects, strict=True)
    ]
    offset = np.array(centre).reshape(-1, 3) - graph.viewpoint_position[viewpoint]
    return np.asarray(np.sqrt(np.square(offset).sum(axis=1)), dtype=np.float64)
