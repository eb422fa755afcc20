"""The published files of a dataset: where they are, what is in them, and the rules for that.

Layout of a clone of the dataset repository::

    tasks/REVERIE/data/REVERIE_{split}.json             or where the task's own files are
    tasks/REVERIE/data/BBox/{scan}_{viewpoint}.json     or BBoxes.json, all of them in one file
    connectivity/{scan}_connectivity.json

Each of the three may be elsewhere. Only a task with target objects has boxes.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.dataset._boxes import Boxes, read_boxes
from reverie_eval.dataset._graphs import Graphs, read_graphs
from reverie_eval.dataset._reader import (
    ANNOTATIONS,
    OBJECT_POSITIONS,
    Position,
    Reader,
    mentioned_by,
    target_of,
    viewpoints_of,
)
from reverie_eval.dataset._rules import Count, Rule, Spread, error, info, spread, warning
from reverie_eval.errors import DatasetError, Problem
from reverie_eval.processes import Progress
from reverie_eval.tasks import DEFAULT_TASK, KNOWN_SPLITS, Annotation, Task, find_task
from reverie_eval.text import first_few

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
        # DUET's single file may be named by its folder.
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
        # All at once: each path that is missing costs a round otherwise.
        problems = [
            Problem(
                "missing-input",
                str(path or kind),
                f"no {kind} found; {_remedy(kind, path)}",
            )
            for kind, path in needed.items()
            if not (path and path.exists())
        ]
        if problems or not connectivity:
            raise DatasetError(problems)
        # All that are there, not only the one that is needed: ids of other splits are recognised in
        # submissions.
        splits = _annotations(data, annotations, split, of_task)
        boxes = boxes if of_task.has_targets else None
        return cls(splits, boxes, connectivity, object_positions, of_task)


def _remedy(kind: str, path: Path | None) -> str:
    """Return what to do about a file or folder that does not exist."""
    # Someone who has the folder lacks a file of it, or has it under another name.
    if kind == "annotations" and path and path.parent.is_dir():
        names = sorted(each.name for each in path.parent.iterdir() if ".json" in each.suffixes)
        if names:
            return f"the folder has {first_few(names)}; name the file with --annotations"
    return f"give a clone of the dataset repository, or the path with --{kind}"


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
    published = [split for split in KNOWN_SPLITS if split in paths]
    return {split: paths[split] for split in [*published, *sorted(paths.keys() - {*published})]}


def _split_of(path: Path, task: Task) -> str:
    """Return the split that a file's name tells."""
    before, _, after = task.file_name.partition("{split}")
    return path.name.removeprefix(before).removesuffix(after).removesuffix(path.suffix)


# What is in them.


Centres = Mapping[str, Mapping[str, Position]]
"""Centres of objects by scan and object id, metres."""


def centre_of(centres: Centres, scan_id: str, object_id: int) -> Position | None:
    """Return the centre of an object; None if it is not known."""
    # Keys of objects in JSON are text.
    return centres.get(scan_id, {}).get(str(object_id))


@dataclass(frozen=True, eq=False)
class Split:
    """The records of an annotation file."""

    name: str
    path: Path
    items: Sequence[Annotation]
    malformed: Sequence[str] = ()
    """Records that do not have the form of an item, with the reason."""

    @property
    def scans(self) -> set[str]:
        """The scans of the items."""
        return {item.scan for item in self.items}

    @property
    def instr_ids(self) -> list[str]:
        """The ids of the episodes, in the order of the file."""
        return [instr_id for item in self.items for instr_id in item.instr_ids]

    @property
    def has_solution(self) -> bool:
        """Whether any item has what the public file of a private split leaves out."""
        return any(item.has_solution for item in self.items)


@dataclass(frozen=True, eq=False)
class Items:
    """The items of a split in the navigation graphs."""

    split: Split
    graphs: Graphs
    other_splits: Mapping[str, str] = field(default_factory=dict)
    """The split of each instr_id that another split has."""

    def is_on_graph(self, item: Annotation) -> bool:
        """Whether every viewpoint of an item's paths is in the graph of its scan."""
        return all(map(self.graphs.is_node, mentioned_by(item)))

    @cached_property
    def on_graph(self) -> Sequence[Annotation]:
        """The items whose whole path is in the graph; the others cannot be checked any further."""
        return [item for item in self.split.items if self.is_on_graph(item)]

    @cached_property
    def with_target(self) -> Sequence[Annotation]:
        """The items on the graph that have a target."""
        return [item for item in self.on_graph if item.target is not None]


@dataclass(frozen=True, eq=False)
class Targets:
    """The targets of a split's items among the listed objects."""

    split: Split
    items: Sequence[Annotation]
    """The items that have a target and whose whole path is in the graph."""
    boxes: Boxes

    @cached_property
    def at_start(self) -> IntArray:
        """Shape (n_items,): the entry of each target at the start; -1 if not listed there."""
        return self._entries(0)

    @cached_property
    def at_goal(self) -> IntArray:
        """Shape (n_items,): the entry of each target at the goal; -1 if not listed there."""
        return self._entries(-1)

    def is_visible(self, entry: IntArray) -> BoolArray:
        """Whether the entry exists, and a view shows the object."""
        # Index -1, for no entry, picks the 0 that is appended.
        n_views = np.append(self.boxes.n_views, 0)
        return np.asarray(n_views[entry] > 0)

    @cached_property
    def n_viewpoints(self) -> IntArray:
        """Shape (n_listed,): viewpoints that see each target, of targets listed at their goal."""
        visible, number = self.boxes.sightings
        target = self.boxes.scan_object[self.at_goal[self.at_goal >= 0]]
        # A target larger than all visible objects has an index behind the last one: hence `append`.
        index = np.searchsorted(visible, target)
        is_visible = np.append(visible, -1)[index] == target
        return np.where(is_visible, np.append(number, 0)[index], 0)

    def _entries(self, end: int) -> IntArray:
        entry_at = self.boxes.entry_at
        keys = [(viewpoints_of(item)[end], target_of(item)) for item in self.items]
        entries = [entry_at.get(key, -1) for key in keys]
        return np.array(entries, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Dataset:
    """The content of a dataset's files, before any rule was checked."""

    files: DatasetFiles
    reader: Reader
    splits: Sequence[Split]
    graphs: Graphs
    boxes: Boxes
    """Empty if no split needs them."""
    centres: Centres | None
    """None if no file with them is given."""

    @property
    def has_solution(self) -> bool:
        """Whether any item has a solution; boxes are needed only then."""
        return any(split.has_solution for split in self.splits)


def read_dataset(files: DatasetFiles, progress: Progress, only: str | None = None) -> Dataset:
    """Read all splits and all scans, or only one split and its scans."""
    reader = Reader(progress)
    names = files.annotations if only is None else [only]
    splits = [read_split(reader, name, files.annotations[name], files.task) for name in names]
    scans = None if only is None else splits[0].scans
    graphs = read_graphs(reader, find_graphs(files.connectivity, scans))
    boxes = Boxes([], [], graphs)
    # Boxes take longest to read, and one split without a solution needs none.
    if files.boxes and (only is None or splits[0].has_solution):
        boxes = read_boxes(reader, files.boxes, graphs, scans)
    return Dataset(files, reader, splits, graphs, boxes, _read_centres(reader, files))


def _read_centres(reader: Reader, files: DatasetFiles) -> Centres | None:
    if files.object_positions is None:
        return None
    return reader.read(OBJECT_POSITIONS, files.object_positions, "object_positions") or {}


def scans_of(files: DatasetFiles, *, but: str) -> set[str]:
    """Return the scans of all splits but one, of the files that can be read."""
    splits = (
        read_split(Reader(), name, path, files.task)
        for name, path in files.annotations.items()
        if name != but
    )
    return set().union(*(split.scans for split in splits))


def read_split(reader: Reader, name: str, path: Path, task: Task) -> Split:
    """Read an annotation file record by record."""
    annotations: list[Annotation] = []
    malformed: list[str] = []
    records = reader.read(ANNOTATIONS, path, "annotations")
    for number, record in enumerate(records or []):
        try:
            annotations.extend(msgspec.convert(record, task.annotation).parts)
        except msgspec.ValidationError as error:
            malformed.append(f"[{number}]: {', '.join(_faults(record, task)) or error}")
    return Split(name, path, annotations, malformed)


def _faults(record: object, task: Task) -> Iterator[str]:
    """Yield what is wrong with each field of a record; msgspec itself stops at the first."""
    if not isinstance(record, dict):
        return
    for known in msgspec.structs.fields(task.annotation):
        name = known.encode_name
        if name not in record:
            if known.required:
                yield f"{name} is missing"
            continue
        try:
            msgspec.convert(record[name], known.type)
        except msgspec.ValidationError as error:
            yield f"{name}: {error}"


# Rules for annotations: ids, paths in the navigation graphs, and targets at the goals.


def _shared_episodes(items: Items) -> Count:
    instr_ids, other = dict.fromkeys(items.split.instr_ids), items.other_splits
    return Count.among(instr_ids, lambda id_: id_ in other, lambda id_: f"{id_} of {other[id_]}")


def _count_items(items: Sequence[Annotation], which: Callable[[Annotation], bool]) -> Count:
    return Count.among(items, which, lambda item: item.name)


def _without_solution(items: Items) -> Count:
    # A split without any is a private one, and sound.
    has_solution = items.split.has_solution
    return _count_items(items.split.items, lambda item: has_solution and not item.has_solution)


def _without_graph(items: Items) -> Count:
    graphs = items.graphs
    # An unreadable file is reported by a rule of its own.
    with_file = graphs.scans.keys() | graphs.unreadable
    return _count_items(items.split.items, lambda item: item.scan not in with_file)


def _off_the_graph(items: Items) -> Count:
    scans, all_items = items.graphs.scans, items.split.items
    return _count_items(all_items, lambda item: item.scan in scans and not items.is_on_graph(item))


def _unreachable(items: Items) -> Count:
    def is_cut_off(item: Annotation) -> bool:
        scan = items.graphs.scans[item.scan]
        return len({scan.component[scan.row[id_]] for _, id_ in mentioned_by(item)}) > 1

    return _count_items(items.on_graph, is_cut_off)


def _off_the_edges(items: Items) -> Count:
    def leaves_edges(item: Annotation) -> bool:
        scan = items.graphs.scans[item.scan]
        return any(a != b and not scan.has_edge(a, b) for a, b in pairwise(item.reference))

    return _count_items(items.on_graph, leaves_edges)


ITEM_RULES: Sequence[Rule[Items]] = (
    info("items", "items", lambda items: Count(len(items.split.items))),
    info(
        "episodes",
        "episodes, one per instruction",
        lambda items: Count(len(items.split.instr_ids)),
    ),
    info("item-scans", "scans with an item", lambda items: Count(len(items.split.scans))),
    error(
        "malformed-item",
        "records that do not have the published form",
        "All other counts leave them out. Fetch the file again, or fix the program that wrote it.",
        lambda items: Count.from_names(
            items.split.malformed, len(items.split.items) + len(items.split.malformed)
        ),
    ),
    error(
        "missing-solution",
        "items without a solution in a file where others have one",
        "Give every item its solution, or none, as in the published test file. A solution is the "
        "objId (REVERIE), the bboxes (SOON), the paths and end_panos (NDH), or else a path of more "
        "than one viewpoint.",
        _without_solution,
    ),
    error(
        "duplicate-episode",
        "instr_ids used by more than one episode",
        "A submission has one prediction per instr_id: give every item its own id.",
        lambda items: Count.repeated(items.split.instr_ids),
    ),
    warning(
        "shared-episode",
        "instr_ids that also occur in another split",
        "Submissions to the two splits cannot be told apart: use different ids.",
        _shared_episodes,
    ),
    error(
        "missing-scan",
        "items in a scan without a connectivity file",
        "Copy the whole connectivity folder.",
        _without_graph,
    ),
    error(
        "unknown-viewpoint",
        "items with a viewpoint on their path that is not in their scan's graph",
        "Annotations and connectivity files belong to different datasets.",
        _off_the_graph,
    ),
    error(
        "unreachable-goal",
        "items with a viewpoint on their path that cannot be reached",
        "They cannot be scored: distances would be infinite.",
        _unreachable,
    ),
    warning(
        "path-off-edges",
        "items whose path moves between unconnected viewpoints",
        "Such a move counts at shortest-path distance.",
        _off_the_edges,
    ),
)

_MIXED_RELEASES = (
    "Annotations and boxes are probably from different releases (v2 annotations of val_seen with "
    "v1 boxes give 3 of 501): fetch both from the same one."
)


def _where(targets: Targets, mask: BoolArray) -> Count:
    """Count the items for which the mask is true."""
    return Count.where(mask, lambda row: targets.items[row].name)


TARGET_RULES: Sequence[Rule[Targets]] = (
    info(
        "targets",
        "distinct target objects",
        lambda targets: Count(len({(item.scan, item.target) for item in targets.items})),
    ),
    error(
        "target-not-listed",
        "items whose target is not listed where the path ends",
        _MIXED_RELEASES,
        lambda targets: _where(targets, targets.at_goal < 0),
        tolerated_by=["describe"],
    ),
    error(
        "target-not-visible",
        "items whose target is listed where the path ends, but not visible in any view",
        _MIXED_RELEASES,
        lambda targets: _where(
            targets, (targets.at_goal >= 0) & ~targets.is_visible(targets.at_goal)
        ),
        # The published train split has one; `describe` adds a note.
        tolerated_by=["describe"],
    ),
    warning(
        "target-at-start",
        "items whose target is visible where the path begins",
        "An agent that does not move succeeds.",
        lambda targets: _where(targets, targets.is_visible(targets.at_start)),
    ),
    info(
        "single-goal",
        "items whose target is visible from one viewpoint only",
        lambda targets: Count.where(targets.n_viewpoints == 1),
    ),
)


def target_spreads(targets: Targets) -> list[Spread]:
    """Measure how visible the targets are, and how many other objects are at the goals."""
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
