"""All listed objects and their boxes as columns, valid or not."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from reverie_eval.arrays import BoolArray, IntArray, with_object
from reverie_eval.dataset._graphs import Graphs
from reverie_eval.dataset._reader import BOXES, ObjectRecord, Reader, ViewpointKey, object_key


class Entry(NamedTuple):
    """An object that is listed at a viewpoint."""

    viewpoint: int
    """Index into the viewpoints."""
    object_id: int
    record: ObjectRecord


@dataclass(frozen=True, eq=False)
class Boxes:
    """Every object that is listed anywhere, and every box."""

    viewpoints: Sequence[ViewpointKey]
    """Viewpoints that have a record of boxes, even if it is empty."""
    entries: Sequence[Entry]
    graphs: Graphs
    """The navigation graphs that the viewpoints should be in."""
    misnamed: Sequence[str] = ()
    """Files that do not contain exactly the viewpoint in their name."""
    malformed: Sequence[str] = ()
    """Entries that are not an :class:`ObjectRecord`, with the reason."""
    is_folder: bool = True
    """Whether there is a file for each viewpoint; a single file for all may leave some out."""

    @cached_property
    def viewpoint(self) -> IntArray:
        """Shape (n_entries,): the viewpoint at which each object is listed."""
        return np.array([viewpoint for viewpoint, _, _ in self.entries], dtype=np.int64)

    @cached_property
    def object_id(self) -> IntArray:
        """Shape (n_entries,): the id of each object within its scan."""
        return np.array([object_id for _, object_id, _ in self.entries], dtype=np.int64)

    @cached_property
    def scan_object(self) -> IntArray:
        """Shape (n_entries,): a number for each object, the same wherever it is listed."""
        scan_ids = sorted({key.scan_id for key in self.viewpoints})
        number = {scan_id: n for n, scan_id in enumerate(scan_ids)}
        scan = np.array([number[key.scan_id] for key in self.viewpoints], dtype=np.int64)
        return with_object(scan[self.viewpoint], self.object_id)

    @cached_property
    def n_views(self) -> IntArray:
        """Shape (n_entries,): the number of views in which each object is visible."""
        return np.array([len(record.visible_pos) for _, _, record in self.entries], dtype=np.int64)

    @cached_property
    def n_boxes(self) -> IntArray:
        """Shape (n_entries,): the number of boxes of each object."""
        return np.array([len(record.bbox2d) for _, _, record in self.entries], dtype=np.int64)

    @property
    def is_visible(self) -> BoolArray:
        """Shape (n_entries,): whether any view shows the object.

        ``eval_release.py`` of the dataset's repository, line 122: only objects whose
        ``visible_pos`` is not empty are visible.
        """
        return self.n_views > 0

    @cached_property
    def visible(self) -> IntArray:
        """Shape (n_visible,): the entries that are visible."""
        return np.flatnonzero(self.is_visible)

    @cached_property
    def sightings(self) -> tuple[IntArray, IntArray]:
        """The objects that are visible somewhere, ascending, and how many viewpoints see each."""
        # An object is listed at most once at a viewpoint, so entries count viewpoints.
        return np.unique(self.scan_object[self.is_visible], return_counts=True)

    @cached_property
    def box_entry(self) -> IntArray:
        """Shape (n_boxes,): the entry of each box that has a view."""
        # The lists should be equally long; if not, `unequal-lists` reports it and the rest is cut.
        return np.repeat(np.arange(len(self.entries)), np.minimum(self.n_views, self.n_boxes))

    @cached_property
    def box_view(self) -> IntArray:
        """Shape (n_boxes,): the view that each box is in."""
        return np.array([view for view, _ in self._pairs()], dtype=np.int64)

    @cached_property
    def box_xywh(self) -> IntArray:
        """Shape (n_boxes, 4): left, top, width and height."""
        return np.array([box for _, box in self._pairs()], dtype=np.int64).reshape(-1, 4)

    @cached_property
    def entry_at(self) -> Mapping[tuple[ViewpointKey, int], int]:
        """The entry of each object at each viewpoint where it is listed."""
        return {
            (self.viewpoints[viewpoint], object_id): row
            for row, (viewpoint, object_id, _) in enumerate(self.entries)
        }

    @cached_property
    def largest_area(self) -> IntArray:
        """Shape (n_entries,): pixels of the largest box; 0 without a box."""
        area = np.zeros(len(self.entries), dtype=np.int64)
        np.maximum.at(area, self.box_entry, self.box_xywh[:, 2:].prod(axis=1))
        return area

    def entry_text(self, entry: int) -> str:
        """Return a listed object as examples show it."""
        viewpoint, object_id, _ = self.entries[entry]
        return f"{self.viewpoints[viewpoint]} object {object_id}"

    def box_text(self, box: int) -> str:
        """Return a box as examples show it, with its numbers."""
        numbers = self.box_xywh[box].tolist()
        return f"{self.entry_text(self.box_entry[box])} view {self.box_view[box]} {numbers}"

    def _pairs(self) -> Iterator[tuple[int, tuple[int, int, int, int]]]:
        for _, _, record in self.entries:
            yield from zip(record.visible_pos, record.bbox2d, strict=False)


def read_boxes(
    reader: Reader, path: Path, graphs: Graphs, scans: Collection[str] | None = None
) -> Boxes:
    """Read the ``BBox`` folder, or one file with all boxes, for all scans or the given ones."""
    is_folder = path.is_dir()
    misnamed: list[str] = []
    if is_folder:
        listed, misnamed = _read_folder(reader, path, scans)
    else:
        content = reader.read(BOXES, path, "boxes") or {}
        keyed = [(_key(name), objects) for name, objects in content.items()]
        listed = [(key, objects) for key, objects in keyed if scans is None or key.scan_id in scans]
    entries, malformed = [], []
    for number, (key, objects) in enumerate(listed):
        for object_id, fields in objects.items():
            try:
                record = msgspec.convert(fields, ObjectRecord)
                record.name.encode()  # a lone surrogate is valid JSON, but not valid text
                entries.append(Entry(number, int(object_key(object_id)), record))
            except ValueError as error:  # msgspec's and the encoder's errors are ValueErrors
                malformed.append(f"{key} object {object_id}: {error}")
    viewpoints = [key for key, _ in listed]
    return Boxes(viewpoints, entries, graphs, misnamed, malformed, is_folder=is_folder)


_Listed = list[tuple[ViewpointKey, dict[str, Any]]]


def _read_folder(
    reader: Reader, folder: Path, scans: Collection[str] | None
) -> tuple[_Listed, list[str]]:
    paths = sorted(folder.glob("*.json"))
    wanted = [path for path in paths if scans is None or _key(path.stem).scan_id in scans]
    listed, misnamed = [], []
    for path, content in reader.read_each(BOXES, wanted, "boxes"):
        scan_id, viewpoint_id = _key(path.stem)
        if list(content) != [viewpoint_id]:
            misnamed.append(path.name)
        listed += [(ViewpointKey(scan_id, key), objects) for key, objects in content.items()]
    return listed, misnamed


def _key(scan_and_viewpoint: str) -> ViewpointKey:
    # From the right, because names of scans other than Matterport's may contain underscores.
    scan_id, _, viewpoint_id = scan_and_viewpoint.rpartition("_")
    return ViewpointKey(scan_id, viewpoint_id)
