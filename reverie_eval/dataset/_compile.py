"""Compile a split's published files into its bundle: once, so that scoring takes milliseconds.

All problems in the files are found here: any bundle that exists can be scored against.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from reverie_eval.arrays import Array, FloatArray, IntArray, offsets_of
from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._dataset import (
    Centres,
    Dataset,
    DatasetFiles,
    Items,
    Targets,
    centre_of,
    read_dataset,
    read_split,
)
from reverie_eval.dataset._lint import check_sound
from reverie_eval.dataset._reader import Reader, target_of, viewpoints_of
from reverie_eval.ground_truth import (
    CUSTOM_DATASET,
    Bundle,
    BundleHeader,
    NavigationGraph,
    pack_texts,
)
from reverie_eval.processes import Progress, no_progress
from reverie_eval.tasks import CHANGED, Annotation, find_task

# The centre of an object of which none is published.
_UNKNOWN = (np.inf, np.inf, np.inf)


def compile_split(
    files: DatasetFiles,
    split: str,
    *,
    dataset: str | None = None,
    progress: Progress = no_progress,
) -> Bundle:
    """Compile one split.

    Annotations without the solution (the published test file) give a public bundle; those with it
    (REVERIE: ``objId`` and the full ``path``) give a bundle that scores.

    Parameters
    ----------
    files : DatasetFiles
        Where the published files are. Annotations of other splits are used in messages only.
    split : str
        The split's name, which is written into the bundle.
    dataset : str, optional
        The release's name; by default it is recognised by the size of the split.
    progress : callable, optional
        Shows progress; called with the files about to be read, a description and their number.

    Raises
    ------
    DatasetError
        Listing everything in the files of this split that ``reverie-eval lint`` calls an error.
    """
    return _bundle_of(read_dataset(files, progress, split), dataset)


def compile_for_training(files: DatasetFiles, split: str) -> tuple[Bundle, int]:
    """Compile the items of a split whose target is visible, and count those that are left out.

    One item of the published train split has a target that no view shows, and annotations of one
    release have more with the boxes of another: nothing can be learned from them.

    Raises
    ------
    DatasetError
        As :func:`compile_split`, but for these.
    """
    content = read_dataset(files, no_progress, split)
    (whole,) = content.splits
    lost: Sequence[Annotation] = ()
    if files.boxes:
        targets = Targets(whole, Items(whole, content.graphs).with_target, content.boxes)
        is_visible = targets.is_visible(targets.at_goal)
        lost = [
            item for item, is_kept in zip(targets.items, is_visible, strict=True) if not is_kept
        ]
    left_out = {id(item) for item in lost}
    items = [item for item in whole.items if id(item) not in left_out]
    content = replace(content, splits=[replace(whole, items=items)])
    return _bundle_of(content, None), len(lost)


def _bundle_of(content: Dataset, dataset: str | None) -> Bundle:
    check_sound(content, "compile")
    files = content.files
    (annotations,), boxes, centres = content.splits, content.boxes, content.centres
    graph, items = content.graphs.ground_truth(), annotations.items
    arrays = graph.to_arrays() | _episode_arrays(items, graph)
    # Texts are no part of the fingerprint: no score depends on them.
    texts = {"instruction": [text.strip() for item in items for text in item.texts]}
    if any(item.language for item in items):
        texts["language"] = [item.language for item in items for _ in item.texts]
    has_targets = content.has_solution and files.task.has_targets
    if has_targets:
        arrays["task_target"] = np.array([target_of(item) for item in items])
    if content.has_solution:
        arrays |= _path_arrays(items, graph)
    if has_targets:
        seen, candidates = _candidates(boxes, graph)
        arrays |= candidates
        entries = [boxes.entry_at[viewpoints_of(item)[-1], target_of(item)] for item in items]
        texts["target_category"] = [boxes.entries[entry].record.name for entry in entries]
        texts["candidate_category"] = [boxes.entries[entry].record.name for entry in seen]
        if centres is not None:
            arrays["candidate_distance"] = _candidate_distances(arrays, centres, graph)
            arrays["target_position"] = np.array(
                [centre_of(centres, item.scan, target_of(item)) or _UNKNOWN for item in items]
            )
    # Episodes of other splits are used in messages only, so problems in their files are ignored.
    split = annotations.name
    others = {
        name: np.array(read_split(Reader(), name, path, files.task).instr_ids, dtype=np.str_)
        for name, path in files.annotations.items()
        if name != split
    }
    size = len(items), len(annotations.instr_ids)
    sources = content.reader.digests()
    release = files.task.release(split, *size, sources["annotations"])
    return Bundle.build(
        split=split,
        dataset=dataset or release or CUSTOM_DATASET,
        sources=sources,
        arrays=arrays,
        other_splits={name: instr_ids for name, instr_ids in others.items() if instr_ids.size},
        texts={name: pack_texts(text) for name, text in texts.items()},
        task=files.task.name,
    )


def origin_notes(header: BundleHeader) -> Iterator[str]:
    """Yield what users should know about a bundle's annotations, a sentence each."""
    task = find_task(header.task)
    difference = task.edited_copies.get(header.sources.get("annotations", ""))
    if difference:
        yield (
            f"the annotations are a known copy that differs from the published {task.title}: "
            f"{difference}; scores on it are not comparable with published ones"
        )
    elif header.dataset.endswith(CHANGED) or (task.published and header.dataset == CUSTOM_DATASET):
        yield (
            f"the annotations are not a published file of {task.title}; their SHA-256 is "
            f"{header.sources.get('annotations')}"
        )
    if task.unseen:
        yield (
            f"the {task.unseen} of {task.title} were not available when their reader was written; "
            "docs/reference/tasks.md says how it was tested"
        )


def _episode_arrays(items: Sequence[Annotation], graph: NavigationGraph) -> dict[str, Array]:
    """Return what is public: the episodes, and the start of each."""
    return {
        "instr_id": np.array([id_ for item in items for id_ in item.instr_ids], dtype=np.str_),
        "episode_task": np.repeat(np.arange(len(items)), [len(item.instr_ids) for item in items]),
        "task_start": np.array([graph.index[item.reference[0]] for item in items]),
        "task_heading": np.array([item.start_heading for item in items]),
    }


def _path_arrays(items: Sequence[Annotation], graph: NavigationGraph) -> dict[str, Array]:
    """Return the annotated paths, and the goals beside paths of a task that has them."""
    rows: dict[tuple[str, str], Sequence[Sequence[str]]] = {
        ("path", "path_offsets"): [item.reference for item in items]
    }
    for name in items[0].further_paths:
        further = [item.further_paths[name] for item in items]
        rows[f"path/{name}", f"path_offsets/{name}"] = further
    if any(item.goals for item in items):
        rows["goal_viewpoint", "goal_offsets"] = [item.goals for item in items]
    arrays: dict[str, Array] = {}
    for (viewpoints, offsets), listed in rows.items():
        arrays[viewpoints] = np.array([graph.index[id_] for row in listed for id_ in row])
        arrays[offsets] = offsets_of(np.array([len(row) for row in listed]))
    outlines = [outline for item in items for outline in item.outlines]
    if outlines:
        arrays["goal_outline"] = np.array(outlines)
    return arrays


def _candidates(boxes: Boxes, graph: NavigationGraph) -> tuple[IntArray, dict[str, Array]]:
    """Return the entries of visible objects at included viewpoints, and the arrays of these.

    They are in the order of viewpoint and object id.
    """
    indices = [graph.index.get(key.viewpoint_id, -1) for key in boxes.viewpoints]
    viewpoint = np.array(indices, np.int64)[boxes.viewpoint]
    # lexsort takes its last key first. Lookups rely on this order, and search without sorting.
    by_viewpoint = np.lexsort((boxes.object_id, viewpoint))
    entry = by_viewpoint[(boxes.is_visible & (viewpoint >= 0))[by_viewpoint]]
    # Entries that are not candidates, invisible or at viewpoints that are not included, stay -1.
    candidate_of = np.full(len(boxes.entries), -1)
    candidate_of[entry] = np.arange(len(entry))
    candidate = candidate_of[boxes.box_entry]
    # A stable sort keeps the published order of each candidate's boxes. Boxes without a candidate
    # (-1) come first and are cut off.
    box = np.argsort(candidate, kind="stable")[np.count_nonzero(candidate < 0) :]
    return entry, {
        "candidate_viewpoint": viewpoint[entry],
        "candidate_object": boxes.object_id[entry],
        "box_candidate": candidate[box],
        "box_view": boxes.box_view[box],
        "box_xywh": boxes.box_xywh[box],
    }


def _candidate_distances(
    candidates: Mapping[str, Array], centres: Centres, graph: NavigationGraph
) -> FloatArray:
    """Return the distance from camera to centre of each candidate; inf if the centre is unknown."""
    viewpoint = candidates["candidate_viewpoint"]
    objects = candidates["candidate_object"].tolist()
    centre = [
        centre_of(centres, graph.scan_of(index), object_id) or _UNKNOWN
        for index, object_id in zip(viewpoint.tolist(), objects, strict=True)
    ]
    offset = np.array(centre).reshape(-1, 3) - graph.viewpoint_position[viewpoint]
    return np.asarray(np.sqrt(np.square(offset).sum(axis=1)), dtype=np.float64)
