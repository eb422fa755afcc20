"""All published boxes as columns, whatever their values."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from pydantic import TypeAdapter

from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.linting.graphs import Place
from reverie_eval.linting.reader import Reader
from reverie_eval.schemas.dataset import object_key

Number = Annotated[int, msgspec.Meta(ge=-(2**31), lt=2**31)]
_FILE = TypeAdapter(dict[str, dict[str, Any]])


class Entry(msgspec.Struct, frozen=True):
    """An object listed at a viewpoint: of the right types, and nothing more is sure."""

    visible_pos: list[Number]
    bbox2d: list[tuple[Number, Number, Number, Number]]
    name: str = ""


class Listed(NamedTuple):
    """An entry and where it is."""

    place: int
    """Index into the places."""
    object_id: int
    entry: Entry


@dataclass(frozen=True, eq=False)
class Boxes:
    """Every object that is listed anywhere, and every box."""

    places: Sequence[Place]
    """Viewpoints that have boxes, if only an empty record of them."""
    listed: Sequence[Listed]
    misnamed: Sequence[str]
    """Files that do not hold the one viewpoint that they are named after."""
    malformed: Sequence[str]
    """Entries that are no ``Entry``, with the reason."""
    is_folder: bool
    """Whether there is a file per viewpoint; one file for all may leave viewpoints out."""

    @cached_property
    def place(self) -> IntArray:
        """Shape (n_entries,): where each object is listed."""
        return np.array([place for place, _, _ in self.listed], dtype=np.int64)

    @cached_property
    def scan_object(self) -> IntArray:
        """Shape (n_entries,): a number for each object, the same wherever it is listed."""
        number = {scan_id: n for n, scan_id in enumerate(sorted({p.scan_id for p in self.places}))}
        scan = np.array([number[place.scan_id] for place in self.places], dtype=np.int64)
        object_id = np.array([object_id for _, object_id, _ in self.listed], dtype=np.int64)
        return (scan[self.place] << 32) | object_id

    @cached_property
    def n_views(self) -> IntArray:
        """Shape (n_entries,): in how many views each object is visible from there."""
        return np.array([len(entry.visible_pos) for _, _, entry in self.listed], dtype=np.int64)

    @cached_property
    def n_boxes(self) -> IntArray:
        """Shape (n_entries,): for how many views there is a box."""
        return np.array([len(entry.bbox2d) for _, _, entry in self.listed], dtype=np.int64)

    @property
    def is_visible(self) -> BoolArray:
        """Shape (n_entries,): whether any view shows the object; listed alone is not visible."""
        return self.n_views > 0

    @cached_property
    def visible(self) -> IntArray:
        """Shape (n_visible,): the entries that are visible."""
        return np.flatnonzero(self.is_visible)

    @cached_property
    def box_entry(self) -> IntArray:
        """Shape (n_boxes,): the entry of each box that has a view."""
        return np.repeat(np.arange(len(self.listed)), np.minimum(self.n_views, self.n_boxes))

    @cached_property
    def box_view(self) -> IntArray:
        """Shape (n_boxes,): the view that each box is in."""
        return np.array([view for view, _ in self._pairs()], dtype=np.int64)

    @cached_property
    def box_xywh(self) -> IntArray:
        """Shape (n_boxes, 4): left, top, width and height."""
        return np.array([box for _, box in self._pairs()], dtype=np.int64).reshape(-1, 4)

    @cached_property
    def entry_at(self) -> Mapping[tuple[Place, int], int]:
        """The entry of each object at each viewpoint where it is listed."""
        return {
            (self.places[place], object_id): row
            for row, (place, object_id, _) in enumerate(self.listed)
        }

    def name_of_entry(self, entry: int) -> str:
        """Name a listed object in an example."""
        place, object_id, _ = self.listed[entry]
        return f"{self.places[place]} object {object_id}"

    def name_of_box(self, box: int) -> str:
        """Name a box in an example, with what is in it."""
        numbers = self.box_xywh[box].tolist()
        return f"{self.name_of_entry(self.box_entry[box])} view {self.box_view[box]} {numbers}"

    def _pairs(self) -> Iterator[tuple[int, tuple[int, int, int, int]]]:
        for _, _, entry in self.listed:
            yield from zip(entry.visible_pos, entry.bbox2d, strict=False)


def read_boxes(reader: Reader, path: Path) -> Boxes:
    """Read the ``BBox`` folder, or one file with all boxes."""
    is_folder = path.is_dir()
    records, misnamed = _folder(reader, path) if is_folder else (_one_file(reader, path), [])
    listed, malformed = [], []
    for number, (place, objects) in enumerate(records):
        for key, entry in objects.items():
            try:
                object_id = int(object_key(key))
                listed.append(Listed(number, object_id, msgspec.convert(entry, Entry)))
            except ValueError as error:  # msgspec's own is one too
                malformed.append(f"{place} object {key}: {error}")
    places = [place for place, _ in records]
    return Boxes(places, listed, misnamed, malformed, is_folder=is_folder)


_Records = list[tuple[Place, dict[str, Any]]]


def _folder(reader: Reader, folder: Path) -> tuple[_Records, list[str]]:
    records, misnamed = [], []
    for path in reader.tracked(sorted(folder.glob("*.json")), "boxes"):
        content = reader.read(_FILE, path)
        if content is None:
            continue
        scan_id, _, viewpoint_id = path.stem.rpartition("_")
        if list(content) != [viewpoint_id]:
            misnamed.append(path.name)
        records += [(Place(scan_id, key), objects) for key, objects in content.items()]
    return records, misnamed


def _one_file(reader: Reader, path: Path) -> _Records:
    content = reader.read(_FILE, path) or {}
    return [(_place(key), objects) for key, objects in content.items()]


def _place(scan_and_viewpoint: str) -> Place:
    scan_id, _, viewpoint_id = scan_and_viewpoint.rpartition("_")
    return Place(scan_id, viewpoint_id)
