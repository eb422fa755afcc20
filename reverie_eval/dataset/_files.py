"""Find the published files of a dataset.

Layout of a clone of the dataset repository::

    tasks/REVERIE/data/REVERIE_{split}.json             or where the task's own files are
    tasks/REVERIE/data/BBox/{scan}_{viewpoint}.json     or BBoxes.json, all of them in one file
    connectivity/{scan}_connectivity.json

Each of the three may be in another place. Only a task with target objects has boxes.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from typing_extensions import Self

from reverie_eval.errors import DatasetError, Problem
from reverie_eval.tasks import DEFAULT_TASK, Task, find_task

_SPLITS = ("train", "val_seen", "val_unseen", "test")
"""The published splits, in the order in which they are shown."""
_ALL_BOXES = "BBoxes.json"
_CONNECTIVITY = "_connectivity.json"


@dataclass(frozen=True, slots=True)
class DatasetFiles:
    """Where a dataset's published files are."""

    annotations: Mapping[str, Path]
    """The annotation file by split: the published splits in their order, then others."""
    boxes: Path | None
    """The ``BBox`` folder, or one file with all boxes; None for a task without target objects."""
    connectivity: Path
    """The folder of ``{scan}_connectivity.json`` files."""
    object_positions: Path | None = None
    """``objpos.json``, for the protocol that measures the distance to the object."""
    task: Task = field(default_factory=partial(find_task, DEFAULT_TASK))
    """The task of the annotations."""

    @classmethod
    def find(
        cls,
        root: Path | None = None,
        *,
        split: str | None = None,
        annotations: Path | None = None,
        boxes: Path | None = None,
        connectivity: Path | None = None,
        object_positions: Path | None = None,
        task: str = DEFAULT_TASK,
    ) -> Self:
        """Find the files in a clone, or at the given paths.

        Parameters
        ----------
        root : Path, optional
            A clone of the dataset repository, for the paths that are not given.
        split : str, optional
            The split that is needed. Other splits are found too, to recognise their episodes.
        annotations : Path, optional
            A folder of annotation files, or one file with any name. A file is used for ``split``
            or, if that is not given, as the only split.
        boxes : Path, optional
            The ``BBox`` folder, or DUET's ``BBoxes.json``.
        connectivity : Path, optional
            The folder of ``{scan}_connectivity.json`` files.
        object_positions : Path, optional
            A file with the centres of all objects. It is never found in a clone, because a bundle
            with it has another fingerprint.
        task : str
            The name of a task.

        Raises
        ------
        DatasetError
            Listing everything that is missing.
        ProtocolError
            If there is no such task.
        """
        of_task = find_task(task)
        data = root / of_task.folder if root else None
        if data and not boxes:
            folder, file = data / "BBox", data / _ALL_BOXES
            boxes = file if file.exists() and not folder.exists() else folder
        if boxes and (boxes / _ALL_BOXES).is_file():
            boxes = boxes / _ALL_BOXES
        connectivity = connectivity or (root / "connectivity" if root else None)
        needed = {
            "annotations": _needed_annotations(annotations or data, split, of_task),
            **({"boxes": boxes} if of_task.has_targets else {}),
            "connectivity": connectivity,
        }
        if object_positions:
            needed["object-positions"] = object_positions
        problems = [
            Problem(
                "missing-input",
                str(path or kind),
                f"no {kind} found; give a clone of the dataset repository, or the path with "
                f"--{kind}",
            )
            for kind, path in needed.items()
            if not (path and path.exists())
        ]
        if problems or not connectivity:
            raise DatasetError(problems)
        splits = _annotations(data, annotations, split, of_task)
        boxes = boxes if of_task.has_targets else None
        return cls(splits, boxes, connectivity, object_positions, of_task)


def find_graphs(connectivity: Path, scans: Collection[str] | None = None) -> Mapping[str, Path]:
    """Return the connectivity files in a folder by scan, for all scans or the given ones."""
    paths = {
        path.name.removesuffix(_CONNECTIVITY): path
        for path in sorted(connectivity.glob(f"*{_CONNECTIVITY}"))
    }
    return {scan: path for scan, path in paths.items() if scans is None or scan in scans}


def graph_name(scan_id: str) -> str:
    """Return the name of a scan's connectivity file."""
    return f"{scan_id}{_CONNECTIVITY}"


def _needed_annotations(path: Path | None, split: str | None, task: Task) -> Path | None:
    """Return a file that must exist, given the file or folder of annotations."""
    if path is None or path.is_file():
        return path
    if split is None:
        pattern = task.file_name.format(split="*")
        return min(path.glob(pattern), default=path / pattern)
    return path / task.file_name.format(split=split)


def _annotations(
    data: Path | None, given: Path | None, split: str | None, task: Task
) -> Mapping[str, Path]:
    """Return the annotations by split."""
    if given is None or given.is_dir():
        published = {} if split is None else _splits_in(data, task)
        return published | _splits_in(given or data, task)
    if split is None:
        return {_split_of(given, task): given}
    others = _splits_in(data, task) | _splits_in(given.parent, task)
    return {name: path for name, path in others.items() if path != given} | {split: given}


def _splits_in(folder: Path | None, task: Task) -> dict[str, Path]:
    if folder is None:
        return {}
    found = folder.glob(task.file_name.format(split="*"))
    paths = {_split_of(path, task): path for path in found}
    published = [split for split in _SPLITS if split in paths]
    return {split: paths[split] for split in [*published, *sorted(paths.keys() - {*published})]}


def _split_of(path: Path, task: Task) -> str:
    """Return the split that a file's name tells."""
    before, _, after = task.file_name.partition("{split}")
    return path.name.removeprefix(before).removesuffix(after).removesuffix(path.suffix)
