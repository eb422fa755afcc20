"""Errors a caller can act on.

ReverieEvalError
    RejectedError           the input is invalid; lists every problem
        SubmissionError     a submission
        DatasetError        the published files of the dataset
        SubsetError         a list of episodes
        LogError            the log of a run
    GroundTruthError        the bundle is missing, damaged, or lacks what is needed
    ProtocolError           the protocol, or another option of scoring, is invalid
    ActionError             the agent cannot do this where it is
    RunError                a run cannot begin, go on, or end in a submission
    MissingPartError        a part of the package is not installed
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import ClassVar

SHOWN_PROBLEMS = 20
"""The most problems that an error's text lists one by one: with their title they fit a screen."""
# How many problems of each kind the text lists where not all are listed.
_SHOWN_OF_A_KIND = 3

# What needs a package, and the extra that brings it, by the package's name.
_PARTS: Mapping[str, tuple[str, str]] = {
    "PIL": ("pictures need", "report"),
    "cryptography": ("receipts need", "client"),
    "gymnasium": ("environments in Gymnasium need", "gymnasium"),
    "httpx": ("calling a server needs", "client"),
    "jinja2": ("an HTML report needs", "report"),
    "matplotlib": ("figures need", "report"),
    "pandas": ("a data frame needs", "report"),
    "platformdirs": ("calling a server needs", "client"),
    "safetensors": ("trained agents need", "agents"),
    "pylatexenc": ("tables in LaTeX need", "analysis"),
    "scipy": ("intervals, comparisons and plans need", "analysis"),
    "tenacity": ("calling a server needs", "client"),
    "torch": ("trained agents need", "agents"),
    "vl_convert": ("figures of episodes as PDF or PNG need", "report"),
    "yaml": ("metadata in YAML need", "report"),
}


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem in a file: a stable code, its location, and how to fix it."""

    code: str
    """The kind of problem, for programs: ``unknown-viewpoint``."""
    where: str
    """The problem's location in the file, ``[3].trajectory[0]``, or the path of a file."""
    message: str
    """What was found, what was expected, and what to do."""
    position: tuple[int, ...] = field(default=(), repr=False, compare=False)
    """The numbers in ``where``: they sort problems in the file's order, as text would not."""
    split: str | None = field(default=None, repr=False, compare=False)
    """The split that the whole file seems to be for, if it is another."""

    def __str__(self) -> str:
        return f"{self.where}: {self.message}"


class ReverieEvalError(Exception):
    """Base of every error that this package raises on purpose."""


class GroundTruthError(ReverieEvalError):
    """The bundle is missing, damaged, or lacks what is needed."""


class ProtocolError(ReverieEvalError):
    """The protocol, or another option of scoring, is invalid."""


class ActionError(ReverieEvalError):
    """The agent cannot do this where it is."""


class RunError(ReverieEvalError):
    """A run cannot begin, go on, or end in a submission."""


class MissingPartError(ReverieEvalError, ImportError):
    """A part of the package is not installed; the message says how to install it."""


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

    def __repr__(self) -> str:
        # Not the default, which would print thousands of problems in a notebook or a debugger.
        more = ", ..." if len(self.problems) > 1 else ""
        return f"{type(self).__name__}([{self.problems[0]!r}{more}])"


class SubmissionError(RejectedError):
    """The submission is invalid."""

    subject = "submission"


class DatasetError(RejectedError):
    """The published files of the dataset are invalid."""

    subject = "dataset"


class SubsetError(RejectedError):
    """The list of episodes of a subset is invalid."""

    subject = "subset"


class LogError(RejectedError):
    """The log of a run is invalid."""

    subject = "log"


def _listing(problems: Sequence[Problem]) -> Iterator[str]:
    """List the problems in order; of too many, equal ones once and the first of each kind."""
    if len(problems) <= SHOWN_PROBLEMS:
        yield from map(str, problems)
        return
    equal: dict[tuple[str, str], list[Problem]] = {}
    for problem in problems:
        equal.setdefault((problem.code, problem.message), []).append(problem)
    # A mistake repeated in every episode would otherwise hide all other kinds of problems.
    most = len(equal) if len(equal) <= SHOWN_PROBLEMS else _SHOWN_OF_A_KIND
    shown: Counter[str] = Counter()
    hidden: Counter[str] = Counter()
    for (code, message), [first, *others] in equal.items():
        if shown[code] < most:
            shown[code] += 1
            more = f" and {len(others):,} more" if others else ""
            yield f"{first.where}{more}: {message}"
        else:
            hidden[code] += 1 + len(others)
    for code, count in hidden.items():
        yield f"... and {count:,} more {code}"


@contextmanager
def naming_missing_parts() -> Iterator[None]:
    """Say how to install the part that is missing if an import fails for lack of one.

    Raises
    ------
    MissingPartError
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in _PARTS:
            raise
        what, extra = _PARTS[package]
        raise MissingPartError(f"{what}: pip install 'reverie-eval[{extra}]'") from error
