"""Array types, and trajectories of different lengths laid end to end.

Trajectories are stored flat: ``values`` holds one element per pose and ``offsets``, of length
``n_episodes + 1``, says that episode ``i`` owns ``values[offsets[i]:offsets[i + 1]]``.
"""

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

BoolArray: TypeAlias = npt.NDArray[np.bool_]
FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.integer[Any]]
Array: TypeAlias = npt.NDArray[Any]


def offsets_of(lengths: IntArray) -> IntArray:
    """Return the offsets of rows with these lengths.

    >>> offsets_of(np.array([2, 0, 3]))
    array([0, 2, 2, 5])
    """
    return np.concatenate([[0], np.cumsum(lengths)])


def row_of(offsets: IntArray) -> IntArray:
    """Return for every flat element the row that owns it.

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
    """Return the flat indices that lay the given rows end to end, in the given order.

    >>> take_rows(np.array([2, 0]), np.array([0, 2, 2, 5]))
    array([2, 3, 4, 0, 1])
    """
    lengths = np.diff(offsets)[rows]
    shift = offsets[rows] - offsets_of(lengths)[:-1]
    return np.arange(lengths.sum()) + np.repeat(shift, lengths)


def find_sorted(keys: IntArray, wanted: IntArray) -> tuple[IntArray, BoolArray]:
    """Return where each wanted key is among ascending ones, and whether it is there at all.

    Where it is not, the place is some other key's.

    >>> find_sorted(np.array([2, 5]), np.array([5, 3]))
    (array([1, 1]), array([ True, False]))
    """
    place = np.searchsorted(keys, wanted).clip(max=len(keys) - 1)
    return place, np.equal(keys[place], wanted).astype(np.bool_)


def frozen(array: Array) -> Array:
    """Make an array read-only and return it."""
    array.setflags(write=False)
    return array
