"""Errors a caller can act on.

ReverieEvalError
    RejectedError           the input is invalid; lists every problem
        SubmissionError     a submission
        DatasetError        the published files of the dataset
    GroundTruthError        the bundle is missing, damaged, or lacks what is needed
    ProtocolError           the protocol, or another option of scoring, is invalid
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

SHOWN_PROBLEMS = 40
"""The most problems that an error's text lists."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem in a file: a stable code, its location, and how to fix it."""

    code: str
    """The kind of problem, for programs: ``unknown-viewpoint``."""
    where: str
    """Its location in the file: ``[3].trajectory[0]``, or a file's path."""
    message: str
    """What was found, what was expected, and what to do."""
    position: tuple[int, ...] = field(default=(), repr=False, compare=False)
    """The numbers in ``where``: they sort problems in the file's order, as text would not."""

    def __str__(self) -> str:
        return f"{self.where}: {self.message}"


class ReverieEvalError(Exception):
    """Base of every error that this package raises on purpose."""


class GroundTruthError(ReverieEvalError):
    """The bundle is missing, damaged, or lacks what is needed."""


class ProtocolError(ReverieEvalError):
    """The protocol, or another option of scoring, is invalid."""


class RejectedError(ReverieEvalError):
    """The input is invalid; ``problems`` lists every problem, in the file's order."""

    subject: ClassVar[str]

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(sorted(problems, key=lambda problem: problem.position))
        # The problems instead of a text, so that the error can be pickled to another process.
        super().__init__(self.problems)

    def __str__(self) -> str:
        count = len(self.problems)
        title = f"{self.subject} rejected, {count} problem{'s' if count > 1 else ''}"
        return "\n".join([title, *_listing(self.problems)])


class SubmissionError(RejectedError):
    """The submission is invalid."""

    subject = "submission"


class DatasetError(RejectedError):
    """The published files of the dataset are invalid."""

    subject = "dataset"


def _listing(problems: Sequence[Problem]) -> Iterator[str]:
    """List the problems in order; if there are too many, equally many of each kind."""
    # A mistake repeated in every episode would otherwise hide all other kinds of problems.
    totals = Counter(problem.code for problem in problems)
    share = len(problems) if len(problems) <= SHOWN_PROBLEMS else SHOWN_PROBLEMS // len(totals)
    shown: Counter[str] = Counter()
    for problem in problems:
        if shown[problem.code] < max(share, 1):
            shown[problem.code] += 1
            yield str(problem)
    for code, hidden in (totals - shown).items():
        yield f"... and {hidden:,} more {code}"
