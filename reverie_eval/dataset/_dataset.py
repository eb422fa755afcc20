"""The content of a dataset's files, valid or not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from reverie_eval.dataset._boxes import Boxes, read_boxes
from reverie_eval.dataset._files import DatasetFiles, find_graphs
from reverie_eval.dataset._graphs import Graphs, read_graphs
from reverie_eval.dataset._reader import Progress, Reader
from reverie_eval.dataset._records import OBJECT_POSITIONS, Position
from reverie_eval.dataset._splits import Split, read_split

Centres = Mapping[str, Mapping[str, Position]]
"""Centres of objects by scan and object id, metres."""


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
    def has_answers(self) -> bool:
        """Whether any task has a target; boxes are needed only then."""
        return any(split.has_answers for split in self.splits)


def read_dataset(files: DatasetFiles, progress: Progress) -> Dataset:
    """Read all splits, and the graphs and boxes of all scans."""
    reader = Reader(progress)
    graphs = read_graphs(reader, find_graphs(files.connectivity))
    splits = [read_split(reader, name, path) for name, path in files.annotations.items()]
    boxes = read_boxes(reader, files.boxes, graphs)
    return Dataset(files, reader, splits, graphs, boxes, _read_centres(reader, files))


def read_one_split(files: DatasetFiles, name: str, progress: Progress) -> Dataset:
    """Read one split, and the graphs and boxes of its scans."""
    reader = Reader(progress)
    split = read_split(reader, name, files.annotations[name])
    graphs = read_graphs(reader, find_graphs(files.connectivity, split.scans))
    boxes = Boxes([], [], graphs)
    if split.has_answers:
        boxes = read_boxes(reader, files.boxes, graphs, split.scans)
    return Dataset(files, reader, [split], graphs, boxes, _read_centres(reader, files))


def _read_centres(reader: Reader, files: DatasetFiles) -> Centres | None:
    if files.object_positions is None:
        return None
    return reader.read(OBJECT_POSITIONS, files.object_positions, "object_positions") or {}
