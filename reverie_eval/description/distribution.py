"""One quantity over many tasks or instructions."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from reverie_eval.arrays import FloatArray, frozen


@dataclass(frozen=True, eq=False, slots=True)
class Distribution:
    """The values of one quantity, and what they come to.

    >>> lengths = Distribution.of([2, 2, 5, 11])
    >>> lengths.mean, lengths.median, lengths.minimum, lengths.maximum
    (5.0, 3.5, 2.0, 11.0)
    """

    values: FloatArray
    """Shape (n,), n > 0; read-only."""

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Take the values, of which there is at least one."""
        return cls(frozen(np.fromiter(values, dtype=np.float64)))

    @property
    def mean(self) -> float:
        """The mean."""
        return float(self.values.mean())

    @property
    def median(self) -> float:
        """The middle value; of an even number, the mean of the two in the middle."""
        return float(np.median(self.values))

    @property
    def minimum(self) -> float:
        """The smallest value."""
        return float(self.values.min())

    @property
    def maximum(self) -> float:
        """The largest value."""
        return float(self.values.max())

    @property
    def counts(self) -> Mapping[int, int]:
        """How many values there are from each whole number up to below the next.

        >>> Distribution.of([2.0, 2.9, 5.0]).counts
        {2: 2, 5: 1}
        """
        return dict(sorted(Counter(np.floor(self.values).astype(int).tolist()).items()))
