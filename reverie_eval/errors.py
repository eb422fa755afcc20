"""Errors a caller can act on.

ReverieEvalError
    RejectedError           what was given is wrong; every problem found is listed
        SubmissionError     a submission
        DatasetError        the published files of the dataset
    GroundTruthError        the bundle is missing, damaged, or cannot score what was asked
    ProtocolError           there is no protocol of that name
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

SHOWN_PROBLEMS = 40


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong: a stable code, its place in the caller's file, and the remedy."""

    code: str
    """What kind of problem it is, for programs: ``unknown-viewpoint``."""
    where: str
    """Where it is in the caller's file: ``[3].trajectory[0]``, or a file's path."""
    message: str
    """What was found, what was expected, and what to do."""
    position: tuple[int, ...] = field(default=(), repr=False, compare=False)
    """The numbers of the place, so that problems can be listed in the file's own order."""

    def __str__(self) -> str:
        return f"{self.where}: {self.message}"


class ReverieEvalError(Exception):
    """Base of every error that this package raises on purpose."""


class GroundTruthError(ReverieEvalError):
    """The bundle is missing, damaged, or cannot score what was asked."""


class ProtocolError(ReverieEvalError):
    """There is no protocol of that name."""


class RejectedError(ReverieEvalError):
    """What was given is wrong; ``problems`` lists everything that was found, in its order."""

    subject: ClassVar[str]

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(sorted(problems, key=lambda problem: problem.position))
        super().__init__(self.problems)

    def __str__(self) -> str:
        count = len(self.problems)
        title = f"{self.subject} rejected, {count} problem{'s' if count > 1 else ''}"
        return "\n".join([title, *_listing(self.problems)])


class SubmissionError(RejectedError):
    """The submission is wrong."""

    subject = "submission"


class DatasetError(RejectedError):
    """The published files of the dataset are wrong."""

    subject = "dataset"


def _listing(problems: Sequence[Problem]) -> Iterator[str]:
    """List the problems in order; where there are too many, each kind gets its fair share."""
    totals = Counter(problem.code for problem in problems)
    share = len(problems) if len(problems) <= SHOWN_PROBLEMS else SHOWN_PROBLEMS // len(totals)
    shown: Counter[str] = Counter()
    for problem in problems:
        if shown[problem.code] < max(share, 1):
            shown[problem.code] += 1
            yield str(problem)
    for code, hidden in (totals - shown).items():
        yield f"... and {hidden:,} more {code}"
