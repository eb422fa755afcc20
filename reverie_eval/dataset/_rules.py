"""What a rule for the published files is, and what checking it gives.

A rule says once what it looks for, how grave it is, and what to do. ``lint`` runs all rules on all
files. ``compile``, ``describe`` and ``boxes`` run the rules that are errors on the files that they
use, and stop at the same findings with the same words.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, Self, TypeVar

import numpy as np

from reverie_eval.arrays import Array, BoolArray
from reverie_eval.errors import Problem
from reverie_eval.text import first_few

S = TypeVar("S")

Severity = Literal["info", "warning", "error"]
"""Info is for the record, a warning is worth knowing and not wrong, an error is wrong."""
Purpose = Literal["compile", "describe", "boxes"]
"""What the files are read for."""

SHOWN_EXAMPLES = 40
PERCENTILES = (0, 1, 5, 25, 50, 75, 90, 95, 99, 99.9, 100)


@dataclass(frozen=True, slots=True)
class Found:
    """How many there are."""

    number: int
    of: int | None = None
    """How many were looked at; null where that says nothing."""
    examples: tuple[str, ...] = ()
    """The first few by name."""

    @classmethod
    def among(cls, names: Sequence[str], of: int | None) -> Self:
        """Count what has names already."""
        return cls(len(names), of, tuple(names[:SHOWN_EXAMPLES]))

    @classmethod
    def where(cls, mask: BoolArray, name: Callable[[int], str]) -> Self:
        """Count the rows that are true, and name the first few."""
        rows = np.flatnonzero(mask)
        examples = tuple(name(row) for row in rows[:SHOWN_EXAMPLES].tolist())
        return cls(len(rows), len(mask), examples)

    def __str__(self) -> str:
        return f"{self.number:,}" if self.of is None else f"{self.number:,} of {self.of:,}"


@dataclass(frozen=True, slots=True)
class Finding:
    """What a rule found."""

    code: str
    """Stable, for programs."""
    severity: Severity
    """Info is for the record, a warning is worth knowing and not wrong, an error is wrong."""
    says: str
    """What is counted."""
    advice: str
    """What it means if there are any, and what to do; empty for info."""
    found: Found


@dataclass(frozen=True, slots=True)
class Rule(Generic[S]):
    """Something that is counted in a subject: graphs, boxes, the tasks of a split."""

    code: str
    severity: Severity
    says: str
    """What is counted, in words that follow a number."""
    advice: str
    find: Callable[[S], Found]
    tolerated_by: Collection[Purpose] = ()
    """Who goes on although it is an error; never ``compile``."""

    def check(self, subject: S) -> Finding:
        """Count, and say what it means."""
        return Finding(self.code, self.severity, self.says, self.advice, self.find(subject))


def info(code: str, says: str, find: Callable[[S], Found]) -> Rule[S]:
    """Count something for the record."""
    return Rule(code, "info", says, "", find)


def warning(code: str, says: str, advice: str, find: Callable[[S], Found]) -> Rule[S]:
    """Count something that is worth knowing and not wrong."""
    return Rule(code, "warning", says, advice, find)


def error(
    code: str,
    says: str,
    advice: str,
    find: Callable[[S], Found],
    *,
    tolerated_by: Collection[Purpose] = (),
) -> Rule[S]:
    """Count something that must not be in a dataset."""
    return Rule(code, "error", says, advice, find, tolerated_by)


def problems(
    rules: Sequence[Rule[S]], subject: S, where: Path, purpose: Purpose
) -> Iterator[Problem]:
    """Check the rules that are errors for a purpose, and yield what is wrong."""
    for rule in rules:
        if rule.severity == "error" and purpose not in rule.tolerated_by:
            found = rule.find(subject)
            if found.number:
                examples = first_few(found.examples)
                message = f"{found} {rule.says}: {examples}. {rule.advice}"
                yield Problem(rule.code, str(where), message)


@dataclass(frozen=True, slots=True)
class Spread:
    """How measured values are spread."""

    code: str
    """Stable, for programs."""
    says: str
    """What was measured."""
    unit: str
    number: int
    """How many values there are."""
    mean: float | None
    """Null if there are no values."""
    percentiles: Mapping[str, float]
    """Values by percentage, ``"0"`` the smallest and ``"100"`` the largest, linear between; empty
    if there are no values."""


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
        return Spread(code, says, unit, 0, None, {})
    found = np.percentile(values, PERCENTILES).tolist()
    percentiles = {f"{p:g}": value for p, value in zip(PERCENTILES, found, strict=True)}
    mean = float(np.mean(values))
    return Spread(code, says, unit, len(values), mean, percentiles)
