"""Rules for the published files, and what checking them finds.

A rule defines what it counts, how severe it is, and what to do about it. ``lint`` checks all files
against all rules. ``compile``, ``describe`` and ``boxes`` check the files that they use against the
rules that are errors, and stop with the same messages.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, TypeVar

import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import Array, BoolArray
from reverie_eval.errors import Problem
from reverie_eval.text import first_few

S = TypeVar("S")
T = TypeVar("T")

Severity = Literal["info", "warning", "error"]
"""Info is a plain count, a warning is worth knowing but not wrong, an error is wrong."""
Purpose = Literal["compile", "describe", "boxes"]
"""The command that reads the files."""

SHOWN_EXAMPLES = 40
PERCENTILES = (0, 1, 5, 25, 50, 75, 90, 95, 99, 99.9, 100)


@dataclass(frozen=True, slots=True)
class Count:
    """How many there are, with examples."""

    number: int
    of: int | None = None
    """How many were checked; null if there is no such number."""
    examples: tuple[str, ...] = ()
    """The first few."""

    @classmethod
    def from_names(cls, names: Sequence[str], of: int | None) -> Self:
        """Count things that are given by name."""
        return cls(len(names), of, tuple(names[:SHOWN_EXAMPLES]))

    @classmethod
    def among(
        cls, several: Collection[T], which: Callable[[T], bool], name: Callable[[T], str] = str
    ) -> Self:
        """Count those that pass a test."""
        return cls.from_names([name(each) for each in several if which(each)], len(several))

    @classmethod
    def repeated(cls, names: Iterable[str]) -> Self:
        """Count the distinct names that occur more than once."""
        counts = Counter(names)
        return cls.from_names([name for name, count in counts.items() if count > 1], len(counts))

    @classmethod
    def where(cls, mask: BoolArray, name: Callable[[int], str] | None = None) -> Self:
        """Count the rows that are true; `name`, if given, is called for the first few."""
        rows = np.flatnonzero(mask)
        examples = map(name, rows[:SHOWN_EXAMPLES].tolist()) if name else ()
        return cls(len(rows), len(mask), tuple(examples))

    def __str__(self) -> str:
        return f"{self.number:,}" if self.of is None else f"{self.number:,} of {self.of:,}"


@dataclass(frozen=True, slots=True)
class Finding:
    """What a rule found."""

    code: str
    """Stable, for programs."""
    severity: Severity
    """Info is a plain count, a warning is worth knowing but not wrong, an error is wrong."""
    says: str
    """What is counted."""
    advice: str
    """What findings of the rule mean, and what to do about them; empty for info."""
    found: Count


@dataclass(frozen=True, slots=True)
class Rule(Generic[S]):
    """A rule about one subject: the graphs, the boxes, or the items of a split."""

    code: str
    severity: Severity
    says: str
    """What is counted, in words that follow a number."""
    advice: str
    find: Callable[[S], Count]
    tolerated_by: Collection[Purpose] = ()
    """Commands that continue despite this error; never ``compile``."""

    def check(self, subject: S) -> Finding:
        """Count what the rule looks for."""
        return Finding(self.code, self.severity, self.says, self.advice, self.find(subject))


def info(code: str, says: str, find: Callable[[S], Count]) -> Rule[S]:
    """Return a rule that only counts."""
    return Rule(code, "info", says, "", find)


def warning(code: str, says: str, advice: str, find: Callable[[S], Count]) -> Rule[S]:
    """Return a rule for something that is worth knowing but not wrong."""
    return Rule(code, "warning", says, advice, find)


def error(
    code: str,
    says: str,
    advice: str,
    find: Callable[[S], Count],
    *,
    tolerated_by: Collection[Purpose] = (),
) -> Rule[S]:
    """Return a rule for something that must not occur in a dataset."""
    return Rule(code, "error", says, advice, find, tolerated_by)


def find_problems(
    rules: Sequence[Rule[S]], subject: S, where: Path, purpose: Purpose
) -> Iterator[Problem]:
    """Check the rules that are errors for a purpose, and yield a problem for each broken rule."""
    for rule in rules:
        # A warning says what a dataset is like; no command stops for it.
        if rule.severity == "error" and purpose not in rule.tolerated_by:
            found = rule.find(subject)
            if found.number:
                # One problem for each rule: thousands of equal ones would hide the others.
                examples = first_few(found.examples, of=found.number)
                message = f"{found} {rule.says}: {examples}. {rule.advice}"
                yield Problem(rule.code, str(where), message)


@dataclass(frozen=True, slots=True)
class Spread:
    """The distribution of measured values."""

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
    """Percentiles by percentage, from ``"0"`` for the smallest value to ``"100"`` for the largest,
    interpolated linearly; empty if there are no values."""


def spread(code: str, says: str, unit: str, values: Array) -> Spread:
    """Return the mean and percentiles of finite values, of which there may be none.

    >>> lengths = spread("length", "of edges", "m", np.array([1.0, 2.0, 6.0]))
    >>> lengths.number, lengths.mean, lengths.percentiles["50"], lengths.percentiles["100"]
    (3, 3.0, 2.0, 6.0)
    """
    # numpy has no percentiles of nothing.
    if not values.size:
        return Spread(code, says, unit, 0, None, {})
    at_percentiles = np.percentile(values, PERCENTILES).tolist()
    percentiles = {f"{p:g}": value for p, value in zip(PERCENTILES, at_percentiles, strict=True)}
    mean = float(np.mean(values))
    return Spread(code, says, unit, len(values), mean, percentiles)
