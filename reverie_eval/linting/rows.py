"""What a check of the dataset comes to: counts of things, and spreads of measured values."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, Self

import numpy as np

from reverie_eval.arrays import Array, BoolArray

Kind = Literal["fact", "remark", "fault"]
"""Facts are for the record, remarks are worth knowing and not wrong, faults are wrong."""

SHOWN_EXAMPLES = 40
PERCENTILES = (0, 1, 5, 25, 50, 75, 90, 95, 99, 99.9, 100)


@dataclass(frozen=True, slots=True)
class Found:
    """How many of how many, and the first few of them by name."""

    number: int
    of: int | None = None
    examples: tuple[str, ...] = ()

    @classmethod
    def among(cls, names: Sequence[str], of: int) -> Self:
        """Count what was named already."""
        return cls(len(names), of, tuple(names[:SHOWN_EXAMPLES]))

    @classmethod
    def where(cls, mask: BoolArray, name: Callable[[int], str]) -> Self:
        """Count the rows that are true, and name the first few."""
        rows = np.flatnonzero(mask)
        examples = tuple(name(row) for row in rows[:SHOWN_EXAMPLES].tolist())
        return cls(len(rows), len(mask), examples)


@dataclass(frozen=True, slots=True)
class Count:
    """One row of the report: a stable code, what is counted, and how many there are."""

    code: str
    kind: Kind
    says: str
    """What is counted, in words that follow a number."""
    advice: str
    """What it means if there are any, and what to do; empty for a fact."""
    found: Found


def fact(code: str, says: str, number: int, of: int | None = None) -> Count:
    """Count something for the record."""
    return Count(code, "fact", says, "", Found(number, of))


def remark(code: str, says: str, advice: str, found: Found) -> Count:
    """Count something that is worth knowing and not wrong."""
    return Count(code, "remark", says, advice, found)


def fault(code: str, says: str, advice: str, found: Found) -> Count:
    """Count something that no sound dataset has."""
    return Count(code, "fault", says, advice, found)


@dataclass(frozen=True, slots=True)
class Spread:
    """How measured values are spread."""

    code: str
    says: str
    unit: str
    number: int
    mean: float | None
    """None if there was nothing to measure."""
    percentiles: Mapping[str, float]
    """Values by percentage, ``"0"`` the smallest and ``"100"`` the largest; linear between."""


def spread(code: str, says: str, unit: str, values: Array) -> Spread:
    """Describe values by their mean and percentiles.

    Parameters
    ----------
    code, says, unit : str
        What was measured.
    values : float or int array of shape (n,)
        Finite; may be empty.

    Examples
    --------
    >>> lengths = spread("length", "of edges", "m", np.array([1.0, 2.0, 6.0]))
    >>> lengths.number, lengths.mean, lengths.percentiles["50"], lengths.percentiles["100"]
    (3, 3.0, 2.0, 6.0)
    """
    if not values.size:
        return Spread(code, says, unit, 0, None, MappingProxyType({}))
    found = np.percentile(values, PERCENTILES).tolist()
    percentiles = {f"{p:g}": value for p, value in zip(PERCENTILES, found, strict=True)}
    mean = float(np.mean(values))
    return Spread(code, says, unit, len(values), mean, MappingProxyType(percentiles))
