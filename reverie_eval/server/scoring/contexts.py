"""Where files are read, checked and scored: in this process, or in processes of their own.

What people send may hold the interpreter for seconds, whatever its size. So a server that answers
requests leaves all of it to :mod:`~.scoring.processes`, and commands, which delay nobody, do it
themselves. Either way the work is a function that takes a :class:`Context` and returns a result
that can be pickled. What every server soon needs is here, where a process finds it without
importing more.
"""

import hashlib
import typing
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import Concatenate, NamedTuple, ParamSpec, Self, TypeVar

from reverie_eval.arrays import Array
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.scoring import BoxScores, Scores
from reverie_eval.server.errors import BusyError
from reverie_eval.server.scoring.boards import Board, find_board
from reverie_eval.server.store.uploads import Uploads, pack, stored_upload
from reverie_eval.submissions import SubmissionColumns, check_navigation_only, unpack

SECONDS_TO_RETRY = 10
STOPPED = "the process that was reading the file was stopped"

Given = ParamSpec("Given")
Result = TypeVar("Result")


@dataclass
class Context:
    """What a file is scored with, and the file that was opened last."""

    boards: Mapping[str, Board]
    uploads: Uploads
    opened: bytes | None = None

    @property
    def content(self) -> bytes:
        """The JSON text that was opened. Raises BusyError if its process was replaced since."""
        if self.opened is None:
            raise BusyError(SECONDS_TO_RETRY, STOPPED)
        return self.opened


class Opened(NamedTuple):
    """A file that was unpacked."""

    sha256: str
    size: int
    """Bytes."""


class Runner(typing.Protocol):
    """One process, for as long as it is held."""

    def run(
        self,
        work: Callable[Concatenate[Context, Given], Result],
        *given: Given.args,
        **named: Given.kwargs,
    ) -> Result:
        """Call a function with the context of that process, and raise what it raises.

        Raises
        ------
        SubmissionError
            If it needs more time or memory than any file may.
        BusyError
            If the process was killed, or cannot load the ground truth.
        """


class Scoring(AbstractContextManager["Scoring", None]):
    """All processes that read and score files; they run during the context."""

    number: int
    """How many calls they answer at once."""
    turns: int
    """How many files may be scored or stored at once: more than ``number`` if a process can score
    the next one while the last result is being stored."""

    @abstractmethod
    def hold(self) -> AbstractContextManager[Runner]:
        """Wait for a process and hold it: what it has opened is there until the end."""

    def run(
        self,
        work: Callable[Concatenate[Context, Given], Result],
        *given: Given.args,
        **named: Given.kwargs,
    ) -> Result:
        """Hold a process for a single call; see :meth:`Runner.run`."""
        with self.hold() as runner:
            return runner.run(work, *given, **named)


class ScoringHere(Scoring):
    """Scores in the process that asks for it."""

    number = turns = 1

    def __init__(self, boards: Mapping[str, Board], uploads: Uploads) -> None:
        self._boards, self._uploads = boards, uploads

    @contextmanager
    def hold(self) -> Iterator[Runner]:
        """Return a context of its own."""
        yield _Here(Context(self._boards, self._uploads))

    def __exit__(self, *_: object) -> None:
        """End nothing."""


@dataclass(frozen=True)
class _Here:
    context: Context

    def run(
        self,
        work: Callable[Concatenate[Context, Given], Result],
        *given: Given.args,
        **named: Given.kwargs,
    ) -> Result:
        return work(self.context, *given, **named)


def check_signature(board: Board, signature: str) -> None:
    """Raise BusyError if a leaderboard was corrected since it had this signature."""
    if board.signature != signature:
        raise BusyError(SECONDS_TO_RETRY, f"the ground truth of {board.split} was just corrected")


class EpisodeValues(NamedTuple):
    """Scores without the ground truth, which both processes have; it may be 100 times as large."""

    signature: str
    """The rules and the ground truth by which the episodes were scored."""
    episodes: Mapping[str, Array]
    hints: Sequence[str]
    qualifier: str
    boxes: BoxScores | None
    submission: SubmissionColumns | None

    @classmethod
    def of(cls, board: Board, scores: Scores) -> Self:
        """Compute all values of every episode."""
        return cls(
            board.signature,
            {key: scores.episodes[key] for key in scores.episodes},
            scores.hints,
            scores.qualifier,
            scores.boxes,
            scores.submission,
        )

    def scores(self, board: Board) -> Scores:
        """Return them as scores of a leaderboard. Raises BusyError if it was corrected since."""
        check_signature(board, self.signature)
        return Scores(
            ground_truth=board.truth,
            protocol=board.protocol,
            episodes=MappingProxyType(self.episodes),
            hints=self.hints,
            qualifier=self.qualifier,
            boxes=self.boxes,
            submission=self.submission,
        )


class Read(NamedTuple):
    """What was read of a file, and its scores."""

    reports: Mapping[str, ScoreReport]
    """By leaderboard of the split."""
    packed: bytes
    """The file as it is kept."""


def open_file(context: Context, packed: bytes, limit: int) -> Opened:
    """Unpack an upload, for the calls that follow.

    Raises SubmissionError if that fails, or gives more bytes than the limit.
    """
    context.opened = unpack(packed, limit)
    return Opened(hashlib.sha256(context.opened).hexdigest(), len(context.opened))


def check_file(context: Context, split: str) -> Sequence[str]:
    """Check the opened file without using the solution, and return the notes."""
    return list(context.boards[split].check(context.content).validation().notes)


def score_file(context: Context, split: str, *, navigation_only: bool | None) -> Read:
    """Read and score the opened file; its method may be declared as navigation only, or as not.

    Raises SubmissionError if it is rejected; lists all problems.
    """
    board = context.boards[split]
    reading = board.read(context.content)
    if board.task.has_targets:
        found = reading.submission.is_navigation_only
        check_navigation_only(found=found, declared=navigation_only)
    return Read(board.reports(context.content, reading), pack(context.content))


def score_content(context: Context, split: str, name: str, content: bytes) -> ScoreReport:
    """Score a JSON text on a leaderboard."""
    return find_board(context.boards, split, name).scored(content).report


def score_episodes(context: Context, split: str, name: str, sha256: str) -> EpisodeValues:
    """Score a stored upload, and return the values of each episode."""
    board = find_board(context.boards, split, name)
    return EpisodeValues.of(board, board.score(board.read(stored_upload(context.uploads, sha256))))
