"""Single lines of a ``.house`` file: a letter, and words whose number depends on it.

References
----------
.. [1] ``data_organization.md`` and ``code/gaps/apps/mpview/mp.cpp`` of niessner/Matterport.
.. [2] ``Mp3dSemanticScene.cpp`` of facebookresearch/habitat-sim, another reader.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from reverie_eval.limits import FARTHEST, LARGEST_OBJECT_ID
from reverie_eval.wording import category_in_words

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
"""Words of a line whose letter may stand for a portal as well: P in the documentation, R in files
that Matterport's own viewer has written."""
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
"""Sine of the angle between two axes below which they span no box."""

Numbers = tuple[float, ...]


class HouseObject(NamedTuple):
    """An object's line."""

    object_id: int
    category: int | None
    centre: Numbers
    first_axis: Numbers
    second_axis: Numbers
    radii: Numbers

    @property
    def has_size(self) -> bool:
        """Objects without faces have negative radii; a flat one has one radius that is zero."""
        return min(self.radii) >= 0 and max(self.radii) > 0


def kind_of(words: Sequence[str]) -> str:
    """Return what a line is about.

    Raises
    ------
    ValueError
        If there are no such lines, worded for people.
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


def read_header(words: Sequence[str]) -> dict[str, int]:
    """Return how many lines of each kind the file has. Raises ValueError like all readers here."""
    return {
        kind: _whole(words, place, f"number of {kind} lines") for kind, place in _COUNTS.items()
    }


def read_category(words: Sequence[str]) -> tuple[int, str]:
    """Return a category's index and its name in words; no name is written as -."""
    name = _word(words, 3, "name")
    return _whole(words, 1, "category index"), "" if name == "-" else category_in_words(name)


def read_object(words: Sequence[str]) -> HouseObject:
    """Return an object: half extents, and axes of any length."""
    category = _whole(words, 3, "category index", least=_NONE)
    found = HouseObject(
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


def _metres(words: Sequence[str], place: int, what: str) -> Numbers:
    """Read three lengths that a building may have."""
    numbers = _numbers(words, place, what)
    if max(map(abs, numbers)) > FARTHEST:
        raise ValueError(f"{_found(words, place, what)}; expected at most {FARTHEST:,.0f} metres")
    return numbers


def _numbers(words: Sequence[str], place: int, what: str) -> Numbers:
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
    """Say what stands in the place of three numbers."""
    found = " ".join(words[place : place + 3])
    return f"{what} {found[:60]!r} (words {place + 1} to {place + 3})"


def _span_a_plane(first: Numbers, second: Numbers) -> bool:
    if not (any(first) and any(second)):
        return False
    cosine = sum(a * b for a, b in zip(_direction(first), _direction(second), strict=True))
    return 1 - cosine * cosine > _PARALLEL**2


def _direction(axis: Numbers) -> Numbers:
    """Make an axis of any length 1 long; by its largest number first, lest its length overflow."""
    largest = max(map(abs, axis))
    scaled = [number / largest for number in axis]
    length = math.hypot(*scaled)
    return tuple(number / length for number in scaled)
