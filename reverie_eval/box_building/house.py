"""Matterport's ``.house`` files: the objects of a scan, their names and their oriented boxes.

A file begins with its version and goes on with a line for each level, region, portal and so on.
Lines that no box depends on are counted, not read.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.box_building.house_lines import (
    HouseObject,
    Numbers,
    kind_of,
    read_category,
    read_header,
    read_object,
)
from reverie_eval.errors import DatasetError, Problem
from reverie_eval.geometry.oriented_boxes import OrientedBoxes

_VERSION = ["ASCII", "1.1"]


@dataclass(frozen=True, eq=False, slots=True)
class House:
    """The objects of a scan that have a size, in the order of their ids."""

    object_id: IntArray
    """Shape (n,): the dataset's ``objId``; unique within the scan only."""
    names: tuple[str, ...]
    """The raw category of each; empty for an object without one."""
    boxes: OrientedBoxes

    def take(self, which: BoolArray) -> Self:
        """Return the house with some of its objects only."""
        names = tuple(name for name, taken in zip(self.names, which, strict=True) if taken)
        return type(self)(self.object_id[which], names, self.boxes[which])


def read_house(path: Path) -> House:
    """Read the objects of a ``.house`` file.

    Parameters
    ----------
    path : Path
        A file of version 1.1.

    Raises
    ------
    DatasetError
        Naming every malformed line with its number.
    """
    return parse_house(path.read_text(encoding="utf-8", errors="replace"), str(path))


def parse_house(text: str, where: str) -> House:
    """Read the objects from the text of a ``.house`` file; `where` names it in problems."""
    first, *lines = text.splitlines() or [""]
    contents = _Contents(where)
    if first.split() == _VERSION:
        for number, line in enumerate(lines, start=2):
            contents.read(number, line.split())
        if not contents.problems:  # else counts and references are off for that reason
            contents.check()
    else:
        contents.report(1, _wrong_version(first))
    if contents.problems:
        raise DatasetError(contents.problems)
    return contents.house()


def _wrong_version(line: str) -> str:
    if line.split()[:1] == _VERSION[:1]:
        return f"found version {line[6:20].strip()!r}, expected '1.1'; fetch the file again"
    return f"found {line[:20]!r}, expected 'ASCII 1.1'; this is no .house file"


@dataclass
class _Contents:
    """What has been read of a file, and what is wrong with it."""

    where: str
    problems: list[Problem] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=dict)
    _found: Counter[str] = field(default_factory=Counter)
    _categories: dict[int, str] = field(default_factory=dict)
    _objects: dict[int, HouseObject] = field(default_factory=dict)
    _lines: dict[tuple[str, int], int] = field(default_factory=dict)
    """Where each category and each object stands."""

    def report(self, line: int, message: str) -> None:
        self.problems.append(Problem("malformed-house", f"{self.where}:{line}", message, (line,)))

    def read(self, line: int, words: Sequence[str]) -> None:
        """Read a line, or report what is wrong with it."""
        try:
            if words:
                self._read(line, words)
        except ValueError as error:
            self.report(line, str(error))

    def _read(self, line: int, words: Sequence[str]) -> None:
        kind = kind_of(words)
        self._found[kind] += 1
        if kind == "header":
            self._counts = read_header(words)
        elif kind == "category":
            index, name = read_category(words)
            self._note("category", index, line)
            self._categories[index] = name
        elif kind == "object":
            found = read_object(words)
            self._note("object", found.object_id, line)
            self._objects[found.object_id] = found

    def _note(self, kind: str, index: int, line: int) -> None:
        """Note where something stands, which stands once."""
        first = self._lines.setdefault((kind, index), line)
        if first != line:
            raise ValueError(f"{kind} {index} stands in line {first} already")

    def check(self) -> None:
        """Report what only the whole file shows."""
        if self._found["header"] != 1:
            self.report(2, f"{self._found['header']} H lines in the file; expected one")
        for kind, count in self._counts.items():
            if self._found[kind] != count:
                self.report(
                    2,
                    f"the header counts {count} {kind} lines, the file has {self._found[kind]}; "
                    "fetch it again",
                )
        for found in self._objects.values():
            if found.category is not None and found.category not in self._categories:
                self.report(
                    self._lines["object", found.object_id],
                    f"category {found.category} of object {found.object_id} has no C line",
                )

    def house(self) -> House:
        """Return the objects that have a size."""
        objects = [found for _, found in sorted(self._objects.items()) if found.has_size]
        return House(
            object_id=np.array([found.object_id for found in objects], dtype=np.int64),
            names=tuple(
                "" if found.category is None else self._categories[found.category]
                for found in objects
            ),
            boxes=OrientedBoxes.along(
                centre=_rows([found.centre for found in objects]),
                first_axis=_rows([found.first_axis for found in objects]),
                second_axis=_rows([found.second_axis for found in objects]),
                radii=_rows([found.radii for found in objects]),
            ),
        )


def _rows(vectors: Sequence[Numbers]) -> FloatArray:
    return np.array(vectors, dtype=np.float64).reshape(-1, 3)
