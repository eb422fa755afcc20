"""The methods of an open split side by side: who solves which episode, and where walks go wrong.

Only methods whose episodes everyone may look at are among them, so that nothing shows how another
method did in an episode.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock, Thread
from typing import NamedTuple

import numpy as np

from reverie_eval.analysis import WalkOutcomes
from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.errors import SubmissionError
from reverie_eval.reporting.outcome_matrix import outcome_matrix
from reverie_eval.reporting.walk_faults import WalkFaults
from reverie_eval.server.errors import BusyError
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.scoring.contexts import Context, Scoring, check_signature
from reverie_eval.server.store.uploads import UploadsError, stored_upload

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


class Comparing:
    """Puts methods side by side; each of their files is scored once."""

    def __init__(self, scoring: Scoring) -> None:
        self._scoring = scoring
        self._is_busy = Lock()
        self.walks: dict[tuple[str, str, str], WalkOutcomes | None] = {}
        """By split, signature and file; None if the file could not be read."""
        self._latest: dict[str, tuple[object, SideBySide]] = {}
        """By split, with what it was made of."""

    def side_by_side(
        self, board: Board, methods: Sequence[ShownMethod], scans: Sequence[str]
    ) -> tuple[SideBySide | None, bool]:
        """Return the methods side by side, and whether they are still being scored.

        None if there are no methods, or not yet. Nobody waits for many files, as after a
        correction: they are scored in the background. A method whose file is missing or damaged is
        left out; the search for damaged files tells the organiser.
        """
        new = [each for each in methods if _key(board, each) not in self.walks]
        is_busy = self._is_busy.locked()
        if len(new) > MOST_AWAITED or (new and is_busy):
            if not is_busy:
                Thread(target=self._score_if_possible, args=(board, new), daemon=True).start()
            return None, True
        walks = {each: self._walks_of(board, each) for each in methods}
        found = {method: each for method, each in walks.items() if each is not None}
        if not found:
            return None, False
        made_of = board.signature, tuple(found)
        known, beside = self._latest.get(board.split, (None, None))
        if beside is None or known != made_of:
            beside = SideBySide(board, [*found], [*found.values()], scans)
            self._latest[board.split] = made_of, beside
            self._forget_others(board, methods)
        return beside, False

    def _forget_others(self, board: Board, methods: Sequence[ShownMethod]) -> None:
        """Forget the walks of a split that are no longer shown, as after a correction."""
        shown = {_key(board, each) for each in methods}
        for key in [key for key in [*self.walks] if key[0] == board.split and key not in shown]:
            self.walks.pop(key, None)  # another page may be forgetting it, too

    def score(self, board: Board, methods: Sequence[ShownMethod]) -> None:
        """Score files in advance, one after the other. Raises BusyError if they must wait."""
        with self._is_busy:
            for each in methods:
                self._walks_of(board, each)

    def _score_if_possible(self, board: Board, methods: Sequence[ShownMethod]) -> None:
        with suppress(BusyError):  # the next page tries again
            self.score(board, methods)

    def _walks_of(self, board: Board, method: ShownMethod) -> WalkOutcomes | None:
        """Return the walks of a method; None while its file cannot be read."""
        key = _, signature, _ = _key(board, method)
        found = self.walks.get(key)
        if found is None:
            with suppress(UploadsError, SubmissionError):
                found = self._scoring.run(summarise_walks, board.split, method.sha256)
                check_signature(board, signature)
            self.walks[key] = found
        return found


def _key(board: Board, method: ShownMethod) -> tuple[str, str, str]:
    return board.split, board.signature, method.sha256


def summarise_walks(context: Context, split: str, sha256: str) -> WalkOutcomes:
    """Score a stored upload, which has outcomes, and summarise its walks."""
    board = context.boards[split]
    return WalkOutcomes.of(board.score(board.read(stored_upload(context.uploads, sha256))))
