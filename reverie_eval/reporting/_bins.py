"""How histograms divide a range: in round steps, alike for whatever is shown together."""

from collections.abc import Iterator
from itertools import count

import numpy as np

from reverie_eval.arrays import FloatArray


def bin_edges(values: FloatArray, most: int) -> FloatArray:
    """Divide a range into steps of 1, 2, 5, 10, 20, 50 and so on, as few as ``most``.

    >>> bin_edges(np.array([3.2, 5.0]), 3)
    array([3., 4., 5., 6.])
    """
    first, last = np.floor(values.min()), np.floor(values.max()) + 1
    width = next(width for width in round_numbers() if (last - first) / width <= most)
    return np.arange(np.floor(first / width) * width, last + width, width)


def count_edges(counts: FloatArray, most: int) -> FloatArray:
    """Divide a range of counts likewise; each has a bar that stands over it, if there is room.

    >>> count_edges(np.array([3.0, 5.0]), 3), count_edges(np.array([3.0, 5.0]), 2)
    (array([2.5, 3.5, 4.5, 5.5]), array([2., 4., 6.]))
    """
    edges = bin_edges(counts, most)
    return edges - 0.5 if edges[1] - edges[0] == 1 else edges


def round_numbers() -> Iterator[int]:
    """Count 1, 2, 5, 10, 20, 50, 100 and so on."""
    return (digit * 10**exponent for exponent in count() for digit in (1, 2, 5))
