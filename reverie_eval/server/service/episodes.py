"""Episodes of open splits: their annotations, and the results of submissions.

The annotations of an open split are published, so everyone may see them. Results per episode are
shown to the team and the organiser. Episodes of private splits are not shown to anyone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from sqlalchemy.orm import Session

from reverie_eval.analysis import Episode, episode, find_grouping
from reverie_eval.arrays import BoolArray, IntArray
from reverie_eval.errors import GroundTruthError, ProtocolError
from reverie_eval.ground_truth import DEMO_BUNDLES, GroundTruth
from reverie_eval.metrics import ABSTAINED
from reverie_eval.schemas.service import SubmissionReport
from reverie_eval.scoring import OUTCOMES, FailureModes, PreparedSubmission, Scores
from reverie_eval.scoring._outcomes import failure_modes, outcome_indices
from reverie_eval.server.errors import NotFoundError, NotSignedInError
from reverie_eval.server.service.boards import Board, load_board
from reverie_eval.server.service.paging import Page
from reverie_eval.server.service.submissions import (
    SubmissionService,
    View,
    list_submissions,
    submission_of,
)
from reverie_eval.server.settings import Split
from reverie_eval.server.store.tables import Person
from reverie_eval.submissions import NO_BOXES, AlignedSubmission

MOST_LISTED = 200
"""Submissions to choose from; older ones can be opened by their links."""


@dataclass(frozen=True)
class EpisodeFilter:
    """The episodes to show; empty means any."""

    outcome: str = ""
    """Of the first submission: one of :data:`reverie_eval.scoring.OUTCOMES`."""
    other_outcome: str = ""
    """Of the second submission."""
    scan: str = ""
    category: str = ""
    """The category of the target, in lower case."""
    text: str = ""
    """Part of the instruction or the id; case is ignored."""


@dataclass(frozen=True)
class Run:
    """A submission with the outcome of every episode."""

    submission: SubmissionReport
    scores: Scores

    @cached_property
    def outcome(self) -> Sequence[str]:
        """The outcome of each episode; empty if the protocol lacks the metrics for it."""
        try:
            numbers = outcome_indices(self.scores.episodes)
        except ProtocolError:
            return ()
        return [list(OUTCOMES)[number] for number in numbers]


@dataclass(frozen=True)
class Annotations:
    """What is known about a split's episodes without a submission."""

    scores: Scores
    """Of an agent that stays at the start and predicts nothing."""
    scan: Sequence[str]
    category: Sequence[str]
    """Empty if the ground truth does not have them."""
    instruction: Sequence[str]
    """Empty if the ground truth does not have them."""

    @classmethod
    def of(cls, board: Board) -> "Annotations":
        """Collect the annotations of a split."""
        truth = board.truth
        scores = board.score(PreparedSubmission(_staying_at_start(truth), truth))
        return cls(
            scores=scores,
            scan=find_grouping("scan").groups(scores),
            category=_if_known(lambda: find_grouping("category").groups(scores)),
            instruction=_if_known(lambda: truth.episodes.instructions),
        )

    @cached_property
    def searched(self) -> Sequence[str]:
        """Id and instruction of each episode, as searchable text."""
        ids = self.scores.instr_ids
        instructions = self.instruction or [""] * len(ids)
        return [f"{id_} {text}".casefold() for id_, text in zip(ids, instructions, strict=True)]


@dataclass(frozen=True)
class Browsing:
    """A split's episodes, and up to two submissions to show with them."""

    board: Board
    annotations: Annotations
    runs: Sequence[Run]
    choices: Sequence[SubmissionReport]
    """All submissions that the person may choose."""

    def rows(self, wanted: EpisodeFilter) -> IntArray:
        """Return the indices of the episodes to show, in their order."""
        fits = self._is(self.annotations.scan, wanted.scan)
        fits &= self._is(self.annotations.category, wanted.category)
        for run, outcome in zip(self.runs, (wanted.outcome, wanted.other_outcome), strict=False):
            fits &= self._is(run.outcome, outcome)
        sought = " ".join(wanted.text.casefold().split())
        fits &= np.array([sought in text for text in self.annotations.searched], dtype=bool)
        return np.flatnonzero(fits)

    def failure_modes(self, run: Run, wanted: EpisodeFilter) -> FailureModes | None:
        """Count the outcomes of the episodes to show, ignoring the outcome in the filter.

        None if the protocol lacks the metrics for it.
        """
        if not run.outcome:
            return None
        rows = self.rows(replace(wanted, outcome="", other_outcome=""))
        return failure_modes({key: column[rows] for key, column in run.scores.episodes.items()})

    def episode(self, instr_id: str) -> Episode:
        """Return an episode without a submission.

        Raises
        ------
        NotFoundError
            If the split has no such episode.
        """
        self.row(instr_id)
        return episode(self.annotations.scores, instr_id)

    def row(self, instr_id: str) -> int:
        """Return an episode's index; raises the same errors as :meth:`episode`."""
        row = self.board.truth.episodes.index.get(instr_id)
        if row is None:
            raise NotFoundError(f"there is no episode {instr_id!r} in {self.board.name}")
        return row

    def _is(self, parts: Sequence[str], wanted: str) -> BoolArray:
        if not wanted:
            return np.ones(len(self.annotations.scan), dtype=bool)
        return np.array([part == wanted for part in parts] or [False])


class EpisodeService:
    """Access to episodes."""

    def __init__(self, boards: Mapping[str, Board], submissions: SubmissionService) -> None:
        self.boards: Sequence[Board] = [board for board in boards.values() if not board.is_private]
        """Of the open splits."""
        self._submissions = submissions
        self._annotations = lru_cache(len(boards))(lambda split: Annotations.of(self._board(split)))

    @cached_property
    def example(self) -> tuple[Board, Episode]:
        """An episode to show what the task is, and its split: an open one, else the demo world's.

        Of all episodes, its shortest length is the median.
        """
        unseen_first = sorted(self.boards, key=lambda board: board.name != "val_unseen")
        board = unseen_first[0] if unseen_first else _demo_board()
        scores = Annotations.of(board).scores
        by_length = np.argsort(scores.episodes["shortest_length"], kind="stable")
        return board, episode(scores, scores.instr_ids[by_length[len(by_length) // 2]])

    def browse(
        self, session: Session, person: Person | None, split: str, submissions: Sequence[str]
    ) -> Browsing:
        """Return a split's episodes, with up to two submissions.

        Parameters
        ----------
        session : Session
        person : Person or None
            Who is asking; None if nobody is signed in.
        split : str
        submissions : sequence of str
            Ids of the submissions.

        Raises
        ------
        NotFoundError
            If there is no such open split, or the person has no such submission to it.
        NotSignedInError
            If submissions are requested and nobody is signed in.
        """
        board = self._board(split)
        runs = [self._run(session, person, split, submission) for submission in submissions]
        choices = self.choices(session, person, split)
        return Browsing(board, self._annotations(split), runs, choices)

    def choices(
        self, session: Session, person: Person | None, split: str
    ) -> Sequence[SubmissionReport]:
        """Return the submissions to an open split that a person may see, the newest first."""
        if person is None:
            return []
        return list_submissions(session, person, Page(MOST_LISTED), self._view(session), split).rows

    def _view(self, session: Session) -> View:
        return self._submissions.view(session, self._submissions.transactions.clock())

    def _board(self, split: str) -> Board:
        board = next((board for board in self.boards if board.name == split), None)
        if board is None:
            raise NotFoundError(
                f"there are no episodes of {split!r} to look at; those of private splits never "
                "leave the server"
            )
        return board

    def _run(self, session: Session, person: Person | None, split: str, submission_id: str) -> Run:
        if person is None:
            raise NotSignedInError("sign in to look at a submission of your team")
        report = submission_of(session, person, submission_id, self._view(session))
        if report.split != split:
            raise NotFoundError(f"your team has no submission {submission_id!r}")
        return Run(report, self._submissions.episodes(report))


def _demo_board() -> Board:
    bundle = DEMO_BUNDLES / "val_unseen.npz"
    return load_board("val_unseen", Split(bundle=bundle, visibility="open"), bundle)


def _staying_at_start(truth: GroundTruth) -> AlignedSubmission:
    count = len(truth.episodes.instr_ids)
    return AlignedSubmission(
        viewpoint=truth.episodes.start,
        offsets=np.arange(count + 1),
        predicted_object=np.full(count, ABSTAINED),
        answer_is_text=np.zeros(count, dtype=bool),
        has_leading_zeros=np.zeros(count, dtype=bool),
        boxes=NO_BOXES,
    )


def _if_known(texts: Callable[[], Sequence[str]]) -> Sequence[str]:
    try:
        return texts()
    except GroundTruthError:
        return ()
