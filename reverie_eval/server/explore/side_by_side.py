"""The methods of an open split side by side: who solves which episode, and where walks go wrong.

Only methods whose episodes everyone may look at are among them, so that nothing shows how another
method did in an episode. What pages show of stored files is computed once for each file, and for
many in the background.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock, Thread
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from reverie_eval.analysis import WalkOutcomes
from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.errors import SubmissionError
from reverie_eval.reporting.outcomes import WalkFaults, outcome_matrix
from reverie_eval.server.errors import BusyError
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.scoring.contexts import Context, Scoring, check_signature
from reverie_eval.server.store.uploads import UploadsError, stored_upload

Result = TypeVar("Result")

MOST_COMPARED = 60
"""Methods side by side, at most: the newest."""
MOST_AWAITED = 2
"""Files that a page scores before it is shown, at most; more are scored in the background."""
DIFFICULTIES = ("no method", "one method", "less than half", "half or more", "every method")
"""How many methods solve an episode, the hardest first."""
_NONE, _ONE, _FEWER, _MORE, _ALL = range(len(DIFFICULTIES))


class ShownMethod(NamedTuple):
    """A method whose episodes everyone may look at."""

    id: str
    name: str
    sha256: str
    """The file."""
    score: float
    """The primary metric."""


class Building(NamedTuple):
    """A scan, as a table of a split shows it."""

    scan: str
    episodes: int
    solved: float
    """The share of episodes that a method solves on average."""


@dataclass(frozen=True)
class SideBySide:
    """At least one method, the best first, on all episodes of a split."""

    board: Board
    methods: Sequence[ShownMethod]
    walks: Sequence[WalkOutcomes]
    scans: Sequence[str]
    """The scan of each episode."""
    _pictures: dict[str, Sequence[tuple[str, str]]] = field(default_factory=dict)

    @cached_property
    def solved(self) -> IntArray:
        """Shape (n_episodes,): the number of methods that solve each episode."""
        is_correct: BoolArray = np.array([each.is_correct for each in self.walks])
        return np.asarray(is_correct.sum(axis=0))

    @cached_property
    def difficulty(self) -> Sequence[str]:
        """The difficulty of each episode, of :data:`DIFFICULTIES`."""
        number, solved = len(self.methods), self.solved
        chosen = np.select(
            [solved == 0, solved == number, solved == 1, 2 * solved < number],
            [_NONE, _ALL, _ONE, _FEWER],
            _MORE,
        )
        return [DIFFICULTIES[each] for each in chosen.tolist()]

    @cached_property
    def counts(self) -> Mapping[str, int]:
        """The number of episodes by difficulty; those that occur."""
        return {name: count for name in DIFFICULTIES if (count := self.difficulty.count(name))}

    @cached_property
    def buildings(self) -> Sequence[Building]:
        """The scans, the hardest first."""
        scan, share = np.array(self.scans), self.solved / len(self.methods)
        found = [
            Building(name, int((scan == name).sum()), float(share[scan == name].mean()))
            for name in dict.fromkeys(self.scans)
        ]
        return sorted(found, key=lambda each: each.solved)

    @cached_property
    def matrix(self) -> str:
        """The outcomes of all methods in all episodes, as a picture."""
        outcome = np.array([each.outcome for each in self.walks])
        return outcome_matrix(outcome, self.scans)

    def faults(self, scan: str) -> Sequence[tuple[str, str]]:
        """Return the storeys of a scan by name, with where walks end and turn wrong there."""
        if scan not in self._pictures:
            faults = WalkFaults.of(self.board.truth, scan, self.walks)
            self._pictures[scan] = faults.pictures()
        return self._pictures[scan]

    def solvers(self, row: int) -> Sequence[ShownMethod]:
        """Return the methods that solve an episode, the best first."""
        pairs = zip(self.methods, self.walks, strict=True)
        return [method for method, walks in pairs if walks.is_correct[row]]

    def lengths(self, row: int) -> Sequence[float]:
        """Return the metres that the methods which solve an episode walk there, ascending."""
        return sorted(float(each.path_length[row]) for each in self.walks if each.is_correct[row])


class FileResults(Generic[Result]):
    """Results of some work on stored files, which is done once for each.

    Parameters
    ----------
    scoring : Scoring
        What does the work.
    work : callable
        Called with the context of a process that scores, a split and the SHA-256 of a file.
    most_kept : int, optional
        The number of results that are kept; by default, all are, until they are forgotten.
    """

    def __init__(
        self,
        scoring: Scoring,
        work: Callable[[Context, str, str], Result],
        most_kept: int | None = None,
    ) -> None:
        self._scoring, self._work, self._most_kept = scoring, work, most_kept
        self._is_busy = Lock()
        self.kept: dict[tuple[str, str, str], Result | None] = {}
        """By split, signature and file; None if the file could not be read."""

    def find(
        self, board: Board, files: Sequence[str], most_awaited: int
    ) -> Mapping[str, Result | None] | None:
        """Return the result for each file; None while they are computed in the background.

        If more files than ``most_awaited`` are new, as after a correction, nobody waits for them.
        The result for a file that is missing or damaged is None; the doctor tells the organiser.
        """
        new = [each for each in files if _key(board, each) not in self.kept]
        is_busy = self._is_busy.locked()
        if len(new) > most_awaited or (new and is_busy):
            if not is_busy:
                Thread(target=self._compute_if_possible, args=(board, new), daemon=True).start()
            return None
        return {each: self._result(board, each) for each in files}

    def compute(self, board: Board, files: Sequence[str]) -> None:
        """Compute results in advance, one after the other. Raises BusyError if they must wait."""
        with self._is_busy:
            for each in files:
                self._result(board, each)

    def forget_others(self, board: Board, files: Sequence[str]) -> None:
        """Forget the results of a split for all other files, and those from before a correction."""
        shown = {_key(board, each) for each in files}
        for key in [key for key in [*self.kept] if key[0] == board.split and key not in shown]:
            self.kept.pop(key, None)  # another page may be forgetting it, too

    def _compute_if_possible(self, board: Board, files: Sequence[str]) -> None:
        with suppress(BusyError):  # the next page tries again
            self.compute(board, files)

    def _result(self, board: Board, file: str) -> Result | None:
        """Return the result for a file; None while it cannot be read."""
        key = _, signature, _ = _key(board, file)
        found = self.kept.get(key)
        if found is None:
            with suppress(UploadsError, SubmissionError):
                found = self._scoring.run(self._work, board.split, file)
                check_signature(board, signature)
            self.kept[key] = found
            while self._most_kept is not None and len(self.kept) > self._most_kept:
                self.kept.pop(next(iter(self.kept)), None)
        return found


def _key(board: Board, file: str) -> tuple[str, str, str]:
    return board.split, board.signature, file


class Comparing:
    """Puts methods side by side."""

    def __init__(self, scoring: Scoring) -> None:
        self.walks = FileResults(scoring, summarise_walks)
        self._latest: dict[str, tuple[object, SideBySide]] = {}
        """By split, with what it was made of."""

    def side_by_side(
        self, board: Board, methods: Sequence[ShownMethod], scans: Sequence[str]
    ) -> tuple[SideBySide | None, bool]:
        """Return the methods side by side, and whether they are still being compared.

        None if there are no methods, or not yet. A method whose file cannot be read is left out.
        """
        files = [each.sha256 for each in methods]
        walks = self.walks.find(board, files, MOST_AWAITED)
        if walks is None:
            return None, True
        found = {each: its for each in methods if (its := walks[each.sha256]) is not None}
        if not found:
            return None, False
        made_of = board.signature, tuple(found)
        known, beside = self._latest.get(board.split, (None, None))
        if beside is None or known != made_of:
            beside = SideBySide(board, [*found], [*found.values()], scans)
            self._latest[board.split] = made_of, beside
            self.walks.forget_others(board, files)
        return beside, False

    def compare(self, board: Board, methods: Sequence[ShownMethod]) -> None:
        """Score files in advance, one after the other. Raises BusyError if they must wait."""
        self.walks.compute(board, [each.sha256 for each in methods])


def summarise_walks(context: Context, split: str, sha256: str) -> WalkOutcomes:
    """Score a stored upload, which has outcomes, and summarise its walks."""
    board = context.boards[split]
    return WalkOutcomes.of(board.score(board.read(stored_upload(context.uploads, sha256))))
