"""Read Matterport's ``.house`` files: the objects of a scan, their names and oriented boxes.

A file begins with its version. Each other line describes a level, region, portal and so on: a
letter, followed by words whose number depends on the letter. Boxes need the objects and their
categories only, so all other lines are just counted.

Coordinates are metres in the scan's own frame, z up, in which camera poses are given too.

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
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import LARGEST_OBJECT_ID, BoolArray, FloatArray, IntArray
from reverie_eval.dataset._reader import FARTHEST
from reverie_eval.errors import DatasetError, Problem
from reverie_eval.geometry import OrientedBoxes
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
# Number of words in a line whose letter may also mean a portal: P according to the documentation, R
# in files that Matterport's own viewer wrote. The number of words tells which one it is.
_SHARED: Mapping[str, int] = MappingProxyType({"R": 20, "P": 13})
# Number of words in a portal's line.
_PORTAL = 15
# The index of the header's word that gives the number of lines of each kind.
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
_NO_CATEGORY = -1
# The smallest sine of the angle between two axes that span a box; below it, they count as parallel.
_PARALLEL = 1e-3

_Numbers = tuple[float, ...]


class _HouseObject(NamedTuple):
    """The content of an object's line."""

    object_id: int
    category: int | None
    centre: _Numbers
    first_axis: _Numbers
    second_axis: _Numbers
    radii: _Numbers

    @property
    def has_size(self) -> bool:
        """Whether the box is larger than a point; objects without faces have negative radii."""
        return min(self.radii) >= 0 and max(self.radii) > 0


@dataclass(frozen=True, eq=False, slots=True)
class House:
    """The objects of a scan that have a size, in the order of their ids."""

    object_id: IntArray
    """Shape (n,): the dataset's ``objId``; unique within the scan only."""
    names: tuple[str, ...]
    """The raw category of each object; empty if it has none."""
    boxes: OrientedBoxes

    def take(self, mask: BoolArray) -> Self:
        """Return the house with only the objects for which the mask is true."""
        names = tuple(name for name, taken in zip(self.names, mask, strict=True) if taken)
        return type(self)(self.object_id[mask], names, self.boxes[mask])


def read_house(path: Path) -> House:
    """Read the objects of a ``.house`` file of version 1.1.

    Raises
    ------
    DatasetError
        Listing every malformed line with its number.
    """
    return parse_house(path.read_text(encoding="utf-8", errors="replace"), str(path))


def parse_house(text: str, where: str) -> House:
    """Read the objects from the text of a ``.house`` file, which problems call `where`."""
    first, *lines = text.splitlines() or [""]
    contents = _Contents(where)
    if first.split()[:1] != _VERSION[:1]:
        contents.report(1, f"found {first[:20]!r}, expected 'ASCII 1.1'; this is not a .house file")
    elif first.split() != _VERSION:
        found = first[6:20].strip()
        contents.report(1, f"found version {found!r}, expected '1.1'; fetch the file again")
    else:
        for number, line in enumerate(lines, start=2):
            contents.read(number, line.split())
        if not contents.problems:  # an unreadable line makes counts and references wrong too
            contents.check()
    if contents.problems:
        raise DatasetError(contents.problems)
    return contents.house()


@dataclass
class _Contents:
    """What was read so far, and the problems in it."""

    where: str
    problems: list[Problem] = field(default_factory=list)
    _announced: dict[str, int] = field(default_factory=dict)
    """The number of lines of each kind, according to the header."""
    _counts: Counter[str] = field(default_factory=Counter)
    """The number of lines of each kind."""
    _categories: dict[int, str] = field(default_factory=dict)
    _objects: dict[int, _HouseObject] = field(default_factory=dict)
    _lines: dict[tuple[str, int], int] = field(default_factory=dict)
    """The line number of each category and each object."""

    def report(self, line: int, message: str) -> None:
        self.problems.append(Problem("malformed-house", f"{self.where}:{line}", message, (line,)))

    def read(self, line: int, words: Sequence[str]) -> None:
        """Read a line, or report the problem in it."""
        if not words:
            return
        try:
            kind = _kind_of(words)
            self._counts[kind] += 1
            if kind == "header":
                self._announced = {
                    counted: _integer(words, index, f"number of {counted} lines")
                    for counted, index in _COUNTS.items()
                }
            elif kind == "category":
                name, index = _word(words, 3, "name"), _integer(words, 1, "category index")
                self._remember("category", index, line)
                self._categories[index] = "" if name == "-" else category_text(name)
            elif kind == "object":
                house_object = _read_object(words)
                self._remember("object", house_object.object_id, line)
                self._objects[house_object.object_id] = house_object
        except ValueError as error:
            self.report(line, str(error))

    def _remember(self, kind: str, index: int, line: int) -> None:
        """Remember the line of a category or an object, which must have only one."""
        first = self._lines.setdefault((kind, index), line)
        if first != line:
            raise ValueError(f"{kind} {index} already has line {first}")

    def check(self) -> None:
        """Report problems that only the complete file shows."""
        if self._counts["header"] != 1:
            self.report(2, f"{self._counts['header']} H lines in the file; expected one")
        for kind, announced in self._announced.items():
            if self._counts[kind] != announced:
                self.report(
                    2,
                    f"the header announces {announced} {kind} lines, the file has "
                    f"{self._counts[kind]}; fetch it again",
                )
        for it in self._objects.values():
            if it.category is not None and it.category not in self._categories:
                self.report(
                    self._lines["object", it.object_id],
                    f"category {it.category} of object {it.object_id} has no C line",
                )

    def house(self) -> House:
        """Return the objects that have a size."""
        objects = [it for _, it in sorted(self._objects.items()) if it.has_size]
        return House(
            object_id=np.array([it.object_id for it in objects], dtype=np.int64),
            names=tuple(
                "" if it.category is None else self._categories[it.category] for it in objects
            ),
            boxes=OrientedBoxes.along(
                centre=_rows([it.centre for it in objects]),
                first_axis=_rows([it.first_axis for it in objects]),
                second_axis=_rows([it.second_axis for it in objects]),
                radii=_rows([it.radii for it in objects]),
            ),
        )


def _rows(vectors: Sequence[_Numbers]) -> FloatArray:
    return np.array(vectors, dtype=np.float64).reshape(-1, 3)


def _kind_of(words: Sequence[str]) -> str:
    """Return what a line describes.

    As in all readers below, the message of a ValueError is for people.
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


def _read_object(words: Sequence[str]) -> _HouseObject:
    """Return an object. Its radii are half extents; its axes may have any length."""
    category = _integer(words, 3, "category index", least=_NO_CATEGORY)
    house_object = _HouseObject(
        object_id=_integer(words, 1, "object index", most=LARGEST_OBJECT_ID),
        category=None if category == _NO_CATEGORY else category,
        centre=_metres(words, 4, "centre"),
        first_axis=_numbers(words, 7, "first axis"),
        second_axis=_numbers(words, 10, "second axis"),
        radii=_metres(words, 13, "radii"),
    )
    first, second = house_object.first_axis, house_object.second_axis
    if house_object.has_size and not _span_plane(first, second):
        raise ValueError(f"axes {first} and {second}; expected two at right angles")
    return house_object


def _word(words: Sequence[str], index: int, what: str) -> str:
    if index >= len(words):
        raise ValueError(f"{len(words)} words; the {what} is word {index + 1}: the line is cut off")
    return words[index]


def _integer(
    words: Sequence[str], index: int, what: str, least: int = 0, most: int | None = None
) -> int:
    word = _word(words, index, what)
    try:
        number = int(word)
    except ValueError:
        # Out of range, and thereby reported below.
        number = least - 1
    if number < least or (most is not None and number > most):
        limit = "" if most is None else f" of at most {most:,}"
        raise ValueError(f"{what} {word[:20]!r} (word {index + 1}); expected a whole number{limit}")
    return number


def _metres(words: Sequence[str], index: int, what: str) -> _Numbers:
    """Read three coordinates or lengths that a building can have."""
    numbers = _numbers(words, index, what)
    if max(map(abs, numbers)) > FARTHEST:
        found = _quote(words, index, what)
        raise ValueError(f"{found}; expected at most {FARTHEST:,.0f} metres")
    return numbers


def _numbers(words: Sequence[str], index: int, what: str) -> _Numbers:
    """Read three numbers that belong together."""
    _word(words, index + 2, what)
    try:
        numbers = tuple(map(float, words[index : index + 3]))
    except ValueError:
        numbers = (math.nan,)
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"{_quote(words, index, what)}; expected three numbers")
    return numbers


def _quote(words: Sequence[str], index: int, what: str) -> str:
    """Return three words as messages show them."""
    quoted = " ".join(words[index : index + 3])[:60]
    return f"{what} {quoted!r} (words {index + 1} to {index + 3})"


def _span_plane(first: _Numbers, second: _Numbers) -> bool:
    if not (any(first) and any(second)):
        return False
    cosine = sum(a * b for a, b in zip(_direction(first), _direction(second), strict=True))
    return 1 - cosine * cosine > _PARALLEL**2


def _direction(axis: _Numbers) -> _Numbers:
    """Return an axis scaled to length 1."""
    # Divided by the largest number first, because the squares of huge numbers overflow.
    largest = max(map(abs, axis))
    scaled = [number / largest for number in axis]
    length = math.hypot(*scaled)
    return tuple(number / length for number in scaled)
