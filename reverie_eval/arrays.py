"""Array types, and helpers for rows of different lengths stored end to end.

Trajectories are stored flat: ``values`` has one element per pose, and with ``offsets``, of length
``n_episodes + 1``, those of episode ``i`` are ``values[offsets[i]:offsets[i + 1]]``.
"""

import tokenize
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile

import numpy as np
import numpy.typing as npt

BoolArray: TypeAlias = npt.NDArray[np.bool_]
FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.integer[Any]]
Array: TypeAlias = npt.NDArray[Any]

INT32_END = 2**31
"""Bundles store whole numbers in 32 bits: this is the first that is too large."""
LARGEST_OBJECT_ID = INT32_END - 1

ROUNDING = 1e-9
"""Relative; numbers that differ by less are equal, because the order of summation may differ."""

# Elements that are worked on at once: arrays of so many fit the processor's cache, and their memory
# is used again. That of whole columns of a million episodes would be new, and cleared, each time.
_PART = 1 << 16
# How numpy packs arrays. Each other way has exceptions of its own for damaged files.
_COMPRESSIONS = (ZIP_STORED, ZIP_DEFLATED)
# numpy parses the header of each array as Python source, hence the last two of the first line.
# Exceptions that zipfile and numpy raise for damaged files.
_DAMAGE = (
    *(ValueError, TypeError, AttributeError, KeyError, EOFError, tokenize.TokenError, SyntaxError),
    *(NotImplementedError, RuntimeError, BadZipFile, zlib.error),
)


def offsets_of(lengths: IntArray) -> IntArray:
    """Return the offsets of rows with these lengths.

    >>> offsets_of(np.array([2, 0, 3]))
    array([0, 2, 2, 5])
    """
    return np.concatenate([[0], np.cumsum(lengths)])


def row_of(offsets: IntArray) -> IntArray:
    """Return the row of each flat element.

    >>> row_of(np.array([0, 2, 2, 5]))
    array([0, 0, 2, 2, 2])
    """
    return np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))


def last_of(offsets: IntArray) -> IntArray:
    """Return the flat index of each row's last element; no row may be empty.

    >>> last_of(np.array([0, 2, 5]))
    array([1, 4])
    """
    return offsets[1:] - 1


def take_rows(rows: IntArray, offsets: IntArray) -> IntArray:
    """Return the flat indices of the elements of the given rows, in the given order.

    >>> take_rows(np.array([2, 0]), np.array([0, 2, 2, 5]))
    array([2, 3, 4, 0, 1])
    """
    begin = offsets[rows]
    lengths = offsets[rows + 1] - begin
    # How far each row moves from its index in the output to its index in the input.
    shift = begin - offsets_of(lengths)[:-1]
    # In place: no second array of this length is needed.
    taken = np.repeat(shift, lengths)
    taken += np.arange(len(taken))
    return taken


def in_parts(function: Callable[..., Array], *columns: Array) -> Array:
    """Apply a function of columns of the same length to their parts, and join the results.

    >>> in_parts(np.add, np.arange(3), np.arange(3))
    array([0, 2, 4])
    """
    starts = range(0, max(len(columns[0]), 1), _PART)
    parts = ([column[start : start + _PART] for column in columns] for start in starts)
    return np.concatenate([function(*part) for part in parts])


def find_sorted(keys: IntArray, wanted: IntArray) -> tuple[IntArray, BoolArray]:
    """Return the index of each wanted key in ascending keys, and whether it is among them.

    The index of a key that is not among them is that of another key, so it is safe to use.

    >>> find_sorted(np.array([2, 5]), np.array([5, 3]))
    (array([1, 1]), array([ True, False]))
    """
    if not keys.size:
        return np.zeros(len(wanted), dtype=np.int64), np.zeros(len(wanted), dtype=np.bool_)
    # A key above all others would be searched behind the end; clipped, its index is safe to take.
    index = np.searchsorted(keys, wanted).clip(max=len(keys) - 1)
    return index, np.equal(keys[index], wanted).astype(np.bool_)


class KeyTable:
    """Ascending keys, found by a hash: five times as fast as by binary search for many at once."""

    def __init__(self, keys: IntArray) -> None:
        self._keys = keys
        # Eight slots for each key, so that few keys share one.
        self._shift = np.uint64(64 - max(len(keys), 1).bit_length() - 3)
        slots, rows = self._slots(keys), np.arange(len(keys))
        self._row = np.zeros(1 << (64 - int(self._shift)), dtype=np.int64)
        self._row[slots] = rows
        self._is_shared = np.zeros(len(self._row), dtype=np.bool_)
        self._is_shared[slots[self._row[slots] != rows]] = True

    def find(self, wanted: IntArray) -> tuple[IntArray, BoolArray]:
        """Return what :func:`find_sorted` returns.

        >>> KeyTable(np.array([2, 5])).find(np.array([5, 3]))[1]
        array([ True, False])
        """
        if not self._keys.size:
            return find_sorted(self._keys, wanted)
        slots = self._slots(wanted)
        # `take` needs two thirds of the time of an index in brackets.
        index = self._row.take(slots)
        is_found = np.equal(self._keys.take(index), wanted)
        left = np.flatnonzero(self._is_shared[slots] & ~is_found)
        index[left], is_found[left] = find_sorted(self._keys, wanted[left])
        return index, is_found

    def _slots(self, keys: IntArray) -> IntArray:
        # The first bits of a product with a large odd number depend on all bits of a key.
        mixed = keys.view(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        return (mixed >> self._shift).view(np.int64)


def difference(values: FloatArray, others: FloatArray) -> FloatArray:
    """Return values minus others, and 0 where they differ by less than rounding could.

    A loop walked in opposite directions has lengths that differ in the last bit; nobody won it.

    Parameters
    ----------
    values, others : float arrays of the same shape

    Returns
    -------
    float array of that shape
        Exactly 0 where the difference is less than ``ROUNDING`` of the larger of the two, or of 1.

    >>> difference(np.array([0.1 + 0.2, 0.5]), np.array([0.3, 0.3]))
    array([0. , 0.2])
    """
    changed = values - others
    magnitude = np.maximum(np.maximum(np.abs(values), np.abs(others)), 1.0)
    # Relative to 1 at least, or two means near 0 would never be equal.
    changed[np.abs(changed) < ROUNDING * magnitude] = 0.0
    return changed


def with_object(index: IntArray, object_id: IntArray) -> IntArray:
    """Return one number for each pair of a scan, viewpoint or item and an object, in their order.

    Object ids are unique within a scan only, and fit into 32 bits. With a single number, numpy can
    sort, count and search pairs at once.

    >>> with_object(np.array([0, 1]), np.array([7, 7]))
    array([         7, 4294967303])
    """
    # The object is in the lower half, so the numbers sort by index first and by object second.
    return (index.astype(np.int64) << 32) | object_id


def frozen(array: Array) -> Array:
    """Make an array read-only and return it.

    Arrays are shared between scores, evaluators and threads, so nobody may change one in place.
    """
    array.setflags(write=False)
    return array


def take_prefixed(arrays: dict[str, Array], prefix: str) -> dict[str, Array]:
    """Remove the arrays whose names have a prefix, and return them by the rest of the name."""
    names = [name for name in arrays if name.startswith(prefix)]
    return {name.removeprefix(prefix): arrays.pop(name) for name in names}


def read_arrays(path: Path) -> dict[str, Array]:
    """Read the arrays of an ``.npz`` file by their names, without unpickling anything.

    Raises
    ------
    ValueError
        If it is another kind of file, or damaged.
    OSError
        If it cannot be read.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if any(member.compress_type not in _COMPRESSIONS for member in archive.zip.infolist()):
                raise ValueError("an array is packed in a way that numpy does not use")
            return {name: np.asarray(archive[name]) for name in archive.files}
    except _DAMAGE as error:
        raise ValueError(f"{path} is not an .npz file, or is damaged") from error
