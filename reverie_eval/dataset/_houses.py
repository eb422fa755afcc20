"""Read Matterport's ``.house`` files: the objects of a scan, their names and oriented boxes.

A file begins with its version, and has a line for each level, region, portal and so on: a letter,
and words whose number depends on it. Lines that no box depends on are counted, not read.

References
----------
.. [1] ``data_organization.md`` and ``code/gaps/apps/mpview/mp.cpp`` of niessner/Matterport.
.. [2] ``Mp3dSemanticScene.cpp`` of facebookresearch/habitat-sim, another reader.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, Self

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray
from reverie_eval.dataset._records import FARTHEST
from reverie_eval.errors import DatasetError, Problem
from reverie_eval.geometry._oriented_boxes import OrientedBoxes
from reverie_eval.ground_truth import LARGEST_OBJECT_ID
from reverie_eval.text import category_text

_VERSION = ["ASCII", "1.1"]
_KINDS: Mapping[str, str] = MappingProxyType(
    {
        "H": "header",
        "L": "level",
        "R": "region",
        "P": "panorama",
        "S": "surface",
        "V": "vertex",
        "I": "image",
        "C": "category",
        "O": "object",
        "E": "segment",
    }
)
_SHARED: Mapping[str, int] = MappingProxyType({"R": 20, "P": 13})
"""Words of a line whose letter may also mean a portal: P in the documentation, R in files that
Matterport's own viewer wrote."""
_PORTAL = 15
"""Words of a portal's line."""
_COUNTS: Mapping[str, int] = MappingProxyType(
    {
        "image": 3,
        "panorama": 4,
        "vertex": 5,
        "surface": 6,
        "segment": 7,
        "object": 8,
        "category": 9,
        "region": 10,
        "portal": 11,
        "level": 12,
    }
)
"""Which words of the header say how many lines of a kind there are."""
_NONE = -1
_PARALLEL = 1e-3
"""Sine of the angle between two axes below which they do not span a box."""

_Numbers = tuple[float, ...]


class _HouseObject(NamedTuple):
    """An object's line."""

    object_id: int
    category: int | None
    centre: _Numbers
    first_axis: _Numbers
    second_axis: _Numbers
    radii: _Numbers

    @property
    def has_size(self) -> bool:
        """Objects without faces have negative radii; a flat one has one radius that is zero."""
        return min(self.radii) >= 0 and max(self.radii) > 0


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
        Listing every malformed line with its number.
    """
    return parse_house(path.read_text(encoding="utf-8", errors="replace"), str(path))


def parse_house(text: str, where: str) -> House:
    """Read the objects from the text of a ``.house`` file; `where` names it in problems."""
    first, *lines = text.splitlines() or [""]
    contents = _Contents(where)
    if first.split() == _VERSION:
        for number, line in enumerate(lines, start=2):
            contents.read(number, line.split())
        if not contents.problems:  # otherwise counts and references are off for that reason
            contents.check()
    else:
        contents.report(1, _wrong_version(first))
    if contents.problems:
        raise DatasetError(contents.problems)
    return contents.house()


def _wrong_version(line: str) -> str:
    if line.split()[:1] == _VERSION[:1]:
        return f"found version {line[6:20].strip()!r}, expected '1.1'; fetch the file again"
    return f"found {line[:20]!r}, expected 'ASCII 1.1'; this is not a .house file"


@dataclass
class _Contents:
    """What was read so far, and what is wrong with it."""

    where: str
    problems: list[Problem] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=dict)
    _found: Counter[str] = field(default_factory=Counter)
    _categories: dict[int, str] = field(default_factory=dict)
    _objects: dict[int, _HouseObject] = field(default_factory=dict)
    _lines: dict[tuple[str, int], int] = field(default_factory=dict)
    """The line of each category and each object."""

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
        kind = _kind_of(words)
        self._found[kind] += 1
        if kind == "header":
            self._counts = _read_header(words)
        elif kind == "category":
            index, name = _read_category(words)
            self._remember("category", index, line)
            self._categories[index] = name
        elif kind == "object":
            found = _read_object(words)
            self._remember("object", found.object_id, line)
            self._objects[found.object_id] = found

    def _remember(self, kind: str, index: int, line: int) -> None:
        """Remember a line; a second one for the same thing is wrong."""
        first = self._lines.setdefault((kind, index), line)
        if first != line:
            raise ValueError(f"{kind} {index} was given in line {first} already")

    def check(self) -> None:
        """Report what only the complete file shows."""
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


def _rows(vectors: Sequence[_Numbers]) -> FloatArray:
    return np.array(vectors, dtype=np.float64).reshape(-1, 3)


def _kind_of(words: Sequence[str]) -> str:
    """Return what a line describes.

    Raises
    ------
    ValueError
        If no line begins so; the message is for people, as in all readers below.
    """
    letter = words[0]
    if letter not in _KINDS:
        raise ValueError(f"no line begins with {letter[:20]!r}; expected one of {' '.join(_KINDS)}")
    if letter not in _SHARED or len(words) == _SHARED[letter]:
        return _KINDS[letter]
    if len(words) == _PORTAL:
        return "portal"
    raise ValueError(
        f"a {letter} line of {len(words)} words; a {_KINDS[letter]} has {_SHARED[letter]}, "
        f"a portal {_PORTAL}"
    )


def _read_header(words: Sequence[str]) -> dict[str, int]:
    """Return how many lines of each kind the file has."""
    return {
        kind: _whole(words, place, f"number of {kind} lines") for kind, place in _COUNTS.items()
    }


def _read_category(words: Sequence[str]) -> tuple[int, str]:
    """Return a category's index and its name; ``-`` stands for no name."""
    name = _word(words, 3, "name")
    return _whole(words, 1, "category index"), "" if name == "-" else category_text(name)


def _read_object(words: Sequence[str]) -> _HouseObject:
    """Return an object: half extents, and axes of any length."""
    category = _whole(words, 3, "category index", least=_NONE)
    found = _HouseObject(
        object_id=_whole(words, 1, "object index", most=LARGEST_OBJECT_ID),
        category=None if category == _NONE else category,
        centre=_metres(words, 4, "centre"),
        first_axis=_numbers(words, 7, "first axis"),
        second_axis=_numbers(words, 10, "second axis"),
        radii=_metres(words, 13, "radii"),
    )
    if found.has_size and not _span_a_plane(found.first_axis, found.second_axis):
        raise ValueError(
            f"axes {found.first_axis} and {found.second_axis}; expected two at right angles"
        )
    return found


def _word(words: Sequence[str], place: int, what: str) -> str:
    if place >= len(words):
        raise ValueError(f"{len(words)} words; the {what} is word {place + 1}: the line is cut off")
    return words[place]


def _whole(
    words: Sequence[str], place: int, what: str, least: int = 0, most: int | None = None
) -> int:
    word = _word(words, place, what)
    try:
        number = int(word)
    except ValueError:
        number = least - 1
    if number < least or (most is not None and number > most):
        limit = "" if most is None else f" of at most {most:,}"
        raise ValueError(f"{what} {word[:20]!r} (word {place + 1}); expected a whole number{limit}")
    return number


def _metres(words: Sequence[str], place: int, what: str) -> _Numbers:
    """Read three lengths that a building can have."""
    numbers = _numbers(words, place, what)
    if max(map(abs, numbers)) > FARTHEST:
        raise ValueError(f"{_found(words, place, what)}; expected at most {FARTHEST:,.0f} metres")
    return numbers


def _numbers(words: Sequence[str], place: int, what: str) -> _Numbers:
    """Read three numbers that belong together."""
    _word(words, place + 2, what)
    try:
        numbers = tuple(map(float, words[place : place + 3]))
    except ValueError:
        numbers = (math.nan,)
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"{_found(words, place, what)}; expected three numbers")
    return numbers


def _found(words: Sequence[str], place: int, what: str) -> str:
    """Say what was found in the place of three numbers."""
    found = " ".join(words[place : place + 3])
    return f"{what} {found[:60]!r} (words {place + 1} to {place + 3})"


def _span_a_plane(first: _Numbers, second: _Numbers) -> bool:
    if not (any(first) and any(second)):
        return False
    cosine = sum(a * b for a, b in zip(_direction(first), _direction(second), strict=True))
    return 1 - cosine * cosine > _PARALLEL**2


def _direction(axis: _Numbers) -> _Numbers:
    """Return the direction of an axis; scaled by its largest number first, to avoid overflow."""
    largest = max(map(abs, axis))
    scaled = [number / largest for number in axis]
    length = math.hypot(*scaled)
    return tuple(number / length for number in scaled)
