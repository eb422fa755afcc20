"""What pages show of stored files: computed once for each, and for many in the background."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from threading import Lock, Thread
from typing import Generic, TypeVar

from reverie_eval.errors import SubmissionError
from reverie_eval.server.errors import BusyError
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.scoring.contexts import Context, Scoring, check_signature
from reverie_eval.server.store.uploads import UploadsError

Result = TypeVar("Result")


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
