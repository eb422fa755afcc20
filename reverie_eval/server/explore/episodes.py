"""Episodes of open splits: their annotations, and the results of submissions.

The annotations of an open split are published, so everyone may see them, and so are the walks of
the reference agents. Walks of a submission are shown to its team and the organiser; to everyone if
the team chose so, or if it is a baseline. Episodes of private splits are not shown to anyone.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Literal, NamedTuple, Self

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.agents import AGENTS, DEMO_AGENT
from reverie_eval.analysis import Episode, episode, find_grouping
from reverie_eval.arrays import BoolArray, IntArray, offsets_of
from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import GroundTruth
from reverie_eval.metrics import ABSTAINED, Metric
from reverie_eval.runner import run_agent
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import InputClass, Method, ScoredSubmission
from reverie_eval.scoring import (
    OUTCOME_METRICS,
    OUTCOMES,
    FailureModes,
    PreparedSubmission,
    Scores,
    failure_modes,
    outcome_indices,
)
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.errors import NotFoundError, NotSignedInError
from reverie_eval.server.explore.side_by_side import (
    MOST_COMPARED,
    Comparing,
    ShownMethod,
    SideBySide,
)
from reverie_eval.server.intake.submissions import (
    SubmissionService,
    has_review,
    newest_submissions,
    public_team,
    submission_of,
    with_public_episodes,
)
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.scoring.contexts import Context, EpisodeValues, check_signature
from reverie_eval.server.state import Reading, ServerState
from reverie_eval.server.store.tables import Person, Submission, read_stored
from reverie_eval.server.store.uploads import UploadsError, stored_upload
from reverie_eval.submissions import SubmissionColumns, read_headings
from reverie_eval.tasks import DEFAULT_TASK

MOST_LISTED = 200
"""Submissions to choose from, at most; older ones can be opened by their links."""
_HEADINGS_KEPT = 256
"""Walks whose headings are kept."""


@dataclass(frozen=True)
class EpisodeFilter:
    """The episodes to show; empty means any."""

    outcome: str = ""
    """The first submission's outcome: one of :data:`reverie_eval.scoring.OUTCOMES`."""
    other_outcome: str = ""
    """The second submission's outcome."""
    scan: str = ""
    category: str = ""
    """The category of the target, in lower case."""
    solved_by: str = ""
    """How many methods solve it: one of :data:`~.side_by_side.DIFFICULTIES`."""
    text: str = ""
    """Part of the instruction or the id; case is ignored."""


class Reference(NamedTuple):
    """A reference agent on a split."""

    title: str
    input_class: InputClass | None
    """The input that the agent saw; None for agents that only know the graph or the solution."""
    scores: Scores


@dataclass(frozen=True, slots=True)
class Choice:
    """A submission or a reference agent whose walks a person may look at."""

    id: str
    method: str
    """The method's name."""
    kind: Literal["own", "public", "agent"] = "own"
    team: str = ""
    """Empty for a reference agent, and for a team that chose to be anonymous."""
    at: datetime | None = None
    """When it was received or, for others, published; None for a reference agent."""
    status: str = "published"


@dataclass(frozen=True)
class Run:
    """A submission or a reference agent, with the outcome of every episode."""

    choice: Choice
    scores: Scores
    sha256: str = ""
    """The file; empty for a reference agent."""

    @property
    def primary(self) -> Metric:
        """The metric that it is ranked by, among those that it is scored by."""
        return self.scores.ground_truth.task.primary_metric(self.scores)

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
    """The scores of an agent that stays at the start and predicts nothing."""
    scan: Sequence[str]
    category: Sequence[str]
    """Empty if the task has no target objects."""
    instruction: Sequence[str]

    @classmethod
    def of(cls, board: Board) -> "Annotations":
        """Collect the annotations of a split."""
        truth = board.truth
        scores = board.score(PreparedSubmission(align_walks(truth, {}), truth))
        return cls(
            scores=scores,
            scan=find_grouping("scan").groups(scores),
            category=_categories(scores),
            instruction=truth.episodes.instructions,
        )

    @cached_property
    def searched(self) -> Sequence[str]:
        """Id and instruction of each episode, as searchable text."""
        texts = zip(self.scores.instr_ids, self.instruction, strict=True)
        return [f"{id_} {text}".casefold() for id_, text in texts]


@dataclass(frozen=True)
class Browsing:
    """A split's episodes, and up to two submissions to show with them."""

    board: Board
    annotations: Annotations
    runs: Sequence[Run]
    choices: Sequence[Choice]
    """All that the person may choose."""
    compare: Callable[[], tuple[SideBySide | None, bool]]
    """Returns the methods, and whether they are still being compared."""

    @cached_property
    def _compared(self) -> tuple[SideBySide | None, bool]:
        return self.compare()

    @property
    def methods(self) -> SideBySide | None:
        """All that everyone may look at, side by side; None if there are none, or not yet."""
        return self._compared[0]

    @property
    def is_comparing(self) -> bool:
        """Whether the methods are being compared in the background; nobody waits for it."""
        return self._compared[1]

    def rows(self, wanted: EpisodeFilter) -> IntArray:
        """Return the indices of the episodes to show, in their order."""
        fits = self._is(self.annotations.scan, wanted.scan)
        fits &= self._is(self.annotations.category, wanted.category)
        if wanted.solved_by:
            fits &= self._is(self.methods.difficulty if self.methods else (), wanted.solved_by)
        for run, outcome in zip(self.runs, (wanted.outcome, wanted.other_outcome), strict=False):
            fits &= self._is(run.outcome, outcome)
        sought = " ".join(wanted.text.casefold().split())
        fits &= np.array([sought in text for text in self.annotations.searched], dtype=bool)
        return np.flatnonzero(fits)

    def failure_modes(self, run: Run, wanted: EpisodeFilter) -> FailureModes:
        """Count the outcomes of the episodes to show, ignoring the outcome in the filter.

        Raises ProtocolError if the run has no outcomes.
        """
        rows = self.rows(replace(wanted, outcome="", other_outcome=""))
        return failure_modes({key: column[rows] for key, column in run.scores.episodes.items()})

    def episode(self, instr_id: str) -> Episode:
        """Return an episode without a submission.

        Raises NotFoundError if the split does not have it.
        """
        self.row(instr_id)
        return episode(self.annotations.scores, instr_id)

    def row(self, instr_id: str) -> int:
        """Return an episode's index; raises the same errors as :meth:`episode`."""
        row = self.board.truth.episodes.index.get(instr_id)
        if row is None:
            raise NotFoundError(f"there is no episode {instr_id!r} in {self.board.split}")
        return row

    def _is(self, parts: Sequence[str], wanted: str) -> BoolArray:
        if not wanted:
            return np.ones(len(self.annotations.scan), dtype=bool)
        return np.array([part == wanted for part in parts] or [False])


class EpisodeService:
    """Access to episodes."""

    def __init__(self, server: ServerState) -> None:
        self._server, self._submissions = server, server.get(SubmissionService)
        self.comparing = Comparing(server.scoring)
        # A correction changes signatures.
        self._annotations = lru_cache(len(server.boards))(
            lambda split, signature: Annotations.of(self._board_of(split, signature))
        )
        self._walked = lru_cache(len(server.boards) * (len(AGENTS) + 1))(
            lambda split, signature, agent: self._walk(self._board_of(split, signature), agent)
        )
        self._headings = lru_cache(_HEADINGS_KEPT)(
            lambda *of_walk: server.scoring.run(headings_of, *of_walk)
        )

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the service of a server."""
        return cls(server)

    @property
    def boards(self) -> Sequence[Board]:
        """The leaderboards of the open splits."""
        return [board for board in self._server.boards.values() if not board.is_private]

    def _board_of(self, split: str, signature: str) -> Board:
        """Return the board of a split. Raises BusyError if it was corrected meanwhile."""
        board = self._board(split)
        check_signature(board, signature)
        return board

    def _walk(self, board: Board, agent: str) -> Scores:
        return self._server.scoring.run(score_agent, board.split, agent).scores(board)

    def references(self, board: Board) -> Sequence[Reference]:
        """Return the reference agents' scores on a split, the best first; none on a private one.

        There, the scores of the random agent would reveal something about the solution.
        """
        if board.is_private:
            return []
        found = [
            Reference(title, input_class, self._walked(board.split, board.signature, agent))
            for agent, title, input_class in _references(board)
        ]
        return sorted(found, key=lambda each: each.scores[board.primary.key], reverse=True)

    def browse(
        self, reading: Reading, person: Person | None, split: str, submissions: Sequence[str]
    ) -> Browsing:
        """Return a split's episodes, with up to two submissions, for a person or a visitor.

        ``submissions`` are the ids of submissions, or names of reference agents.

        Raises
        ------
        NotFoundError
            If there is no such open split, or the person may not look at such a submission to it.
        NotSignedInError
            If nobody is signed in, and not everyone may look at a submission.
        """
        board = self._board(split)
        annotations = self._annotations(split, board.signature)
        return Browsing(
            board=board,
            annotations=annotations,
            runs=self._runs(reading, person, split, submissions),
            choices=self.choices(reading, person, board),
            compare=lambda: self.comparing.side_by_side(
                board, self.shown_methods(reading.session, board), annotations.scan
            ),
        )

    def headings(self, board: Board, run: Run, instr_id: str) -> Sequence[float | None]:
        """Return the headings of a submission's poses, as ``read_headings`` does.

        Empty for a reference agent, and if the file is missing or damaged.
        """
        try:
            return self._headings(board.split, run.sha256, instr_id) if run.sha256 else ()
        except UploadsError:
            return ()

    def shown_methods(self, session: Session, board: Board) -> Sequence[ShownMethod]:
        """Return the newest methods whose episodes everyone may look at, the best first.

        Disqualified ones do not count.
        """
        chosen = with_public_episodes(board.split).where(~has_review("disqualified"))
        rows = session.scalars(chosen.limit(MOST_COMPARED))
        shown = [self._shown(row, board) for row in rows if row.upload_deleted_at is None]
        sign = -1 if board.primary.better == "higher" else 1
        return sorted(filter(None, shown), key=lambda each: sign * each.score)

    def _shown(self, row: Submission, board: Board) -> ShownMethod | None:
        """Return a published submission; None if it has no outcomes, or under other rules."""
        report, key = read_stored(ScoreReport, row.report), board.primary.key
        if not board.measures_as(report) or not {key, *OUTCOME_METRICS} <= report.scores.keys():
            return None
        return ShownMethod(row.id, _name_of_method(row), row.sha256, report.scores[key])

    def choices(self, reading: Reading, person: Person | None, board: Board) -> Sequence[Choice]:
        """Return what a person may look at on an open split.

        Their own submissions first, then those that everyone may see, each the newest first; then
        the reference agents. Raises UnreadableValueError if a row cannot be read.
        """
        session, split = reading.session, board.split
        own = newest_submissions(session, person, split, MOST_LISTED) if person else ()
        public = session.scalars(with_public_episodes(split).limit(MOST_LISTED)).all()
        known = {row.id for row in own}
        others = [
            _public(row, reading.now)
            for row in public
            if row.id not in known and board.measures_as(read_stored(ScoreReport, row.report))
        ]
        theirs = [_own(row, row.team.name, _name_of_method(row)) for row in own]
        return [*theirs, *others, *map(_agent, AGENTS)]

    def _board(self, split: str) -> Board:
        board = next((board for board in self.boards if board.split == split), None)
        if board is None:
            raise NotFoundError(
                f"no episodes of {split!r} are shown here; those of private splits never leave "
                "the server"
            )
        return board

    def _runs(
        self, reading: Reading, person: Person | None, split: str, chosen: Sequence[str]
    ) -> Sequence[Run]:
        # All at once, so that looking up each takes no statement.
        named = [each for each in chosen if each.isalnum() and each not in AGENTS]
        ids, session = Submission.id.in_(named), reading.session
        rows = session.scalars(select(Submission).where(ids)) if named else ()
        known = {row.id: row for row in rows}
        public = with_public_episodes(split).where(ids).with_only_columns(Submission.id)
        shown = set(session.scalars(public)) if known else set()
        return [
            self._run(reading, person, split, each, known[each] if each in shown else None)
            for each in chosen
        ]

    def _run(
        self,
        reading: Reading,
        person: Person | None,
        split: str,
        chosen: str,
        public: Submission | None,
    ) -> Run:
        """Return a submission or an agent; ``public`` is its row if everyone may look at it."""
        if chosen in AGENTS:
            return Run(_agent(chosen), self._walked(split, self._board(split).signature, chosen))
        if public is not None and (person is None or public.team_id != person.team_id):
            report, choice = public.as_scored(), _public(public, reading.now)
        elif person is None:
            raise NotSignedInError("sign in to look at a submission of your team")
        else:
            report = submission_of(reading.session, person, chosen, View.of(reading))
            if report.split != split:
                raise NotFoundError(f"your team has no submission {chosen!r}")
            choice = _own(report, report.team, report.method.name)
        return Run(choice, self._submissions.episodes(report), report.sha256)


def instructions_of(board: Board) -> Mapping[str, str]:
    """Return the instructions of a split by episode."""
    episodes = board.truth.episodes
    return dict(zip(episodes.instr_ids, episodes.instructions, strict=True))


def _name_of_method(row: Submission) -> str:
    return read_stored(Method, row.method).name


def _references(board: Board) -> Iterator[tuple[str, str, InputClass | None]]:
    """Yield the agents that serve as a reference on a split, with their title and input class."""
    for name in AGENTS:
        yield name, f"{name.capitalize()} agent", None
    if board.truth.is_demo and board.task.name == DEFAULT_TASK and _demo_walks(board).is_file():
        yield DEMO_AGENT.name, "FAST-Short on names", "objects"


def _demo_walks(board: Board) -> Path:
    """Return the submission of the demo world's trained agent to a split, which may not exist."""
    return DEMO_AGENT / f"{board.truth.split}.json"


def _public(row: Submission, now: datetime) -> Choice:
    team = public_team(row, now)
    return Choice(row.id, _name_of_method(row), "public", team, row.published_at)


def _own(found: Submission | ScoredSubmission, team: str, method: str) -> Choice:
    return Choice(found.id, method, team=team, at=found.received_at, status=found.status)


def _agent(name: str) -> Choice:
    return Choice(name, f"{name.capitalize()} (reference agent)", "agent")


def score_agent(context: Context, split: str, agent: str) -> EpisodeValues:
    """Let a reference agent walk, and score it."""
    board = context.boards[split]
    if agent == DEMO_AGENT.name:
        # It walked when it was trained: a server need not have PyTorch.
        walked = json.loads(_demo_walks(board).read_bytes())
        known = {*board.truth.episodes.instr_ids}
        records = [record for record in walked if record["instr_id"] in known]
    else:
        records = run_agent(agent, board.truth)
    if board.settings.track == "grounding":  # takes answers alone
        records = [{key: record[key] for key in ("instr_id", "predObjId")} for record in records]
    return EpisodeValues.of(board, board.score(board.read(json.dumps(records).encode())))


def headings_of(context: Context, split: str, sha256: str, instr_id: str) -> Sequence[float | None]:
    """Read the headings of an episode from a stored upload."""
    content = stored_upload(context.uploads, sha256)
    return read_headings(content, instr_id, context.boards[split].task)


def align_walks(
    truth: GroundTruth, walks: Mapping[int, tuple[Sequence[int], int]]
) -> SubmissionColumns:
    """Return a submission with some walks; elsewhere, the agent stays and predicts nothing.

    ``walks`` are viewpoints from the start on and the predicted object, by the row of the episode.
    """
    count = len(truth.episodes.instr_ids)
    visited = [[start] for start in truth.episodes.start.tolist()]
    predicted = np.full(count, ABSTAINED)
    for row, (viewpoints, object_id) in walks.items():
        visited[row] = list(viewpoints)
        predicted[row] = object_id
    return SubmissionColumns(
        viewpoint=np.concatenate(visited),
        offsets=offsets_of(np.array([len(each) for each in visited])),
        predicted_object=predicted,
        answer_is_text=np.zeros(count, dtype=bool),
        has_leading_zeros=np.zeros(count, dtype=bool),
    )


def _categories(scores: Scores) -> Sequence[str]:
    """Return the category of each episode's target; none if the task has no target objects."""
    try:
        return find_grouping("category").groups(scores)
    except ProtocolError:
        return ()
