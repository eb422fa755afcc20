"""``/submissions/{id}/analysis``: where a result of an open split succeeds and where it fails."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Self

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.analysis import near_misses
from reverie_eval.reporting import report_sections as sections
from reverie_eval.schemas.service import ScoredSubmission
from reverie_eval.scoring import OUTCOMES, Scores
from reverie_eval.server.boards.charts import rank_chart
from reverie_eval.server.boards.entries import Row
from reverie_eval.server.boards.leaderboard import Ranking, Rankings
from reverie_eval.server.boards.reviews import any_submission
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.explore.episodes import instructions_of
from reverie_eval.server.explore.file_results import FileResults
from reverie_eval.server.http.callers import Call, CallReading, Visitor
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.intake.submissions import SubmissionService, publication, submission_of
from reverie_eval.server.scoring.boards import Board, find_board
from reverie_eval.server.scoring.contexts import Context
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.uploads import stored_upload

router = APIRouter()

SHOWN_GROUPS = 8
"""Rows of a breakdown that are not folded."""
NEIGHBOURS = 3
"""Results above and below one that are shown with it."""
EPISODES_AWAITED = 1000
"""Episodes of a split whose analysis a page waits for, at most; that of more takes seconds."""
_KEPT = 32


@dataclass(frozen=True)
class Analysis:
    """What a report says of a submission, without its pictures of episodes."""

    finding: str
    primary: str
    """The key of the metric that groups are compared by."""
    has_walks: bool
    outcomes: Sequence[sections.CountRow]
    """Empty if the split scores no outcomes."""
    funnel: Sequence[sections.CountRow]
    notes: Sequence[str]
    breakdowns: Sequence[sections.Breakdown]
    scans: sections.Breakdown
    near_misses: Mapping[str, Sequence[str]]
    """Ids of episodes by outcome."""

    @classmethod
    def of(cls, scores: Scores) -> Self:
        """Analyse a submission; its breakdowns have the intervals of those of a report."""
        named = {"": scores.with_intervals()}
        has_outcomes = sections.has_outcomes(named)
        modes = [scores.failure_modes] if has_outcomes else []
        return cls(
            finding=sections.main_finding(scores),
            primary=sections.shared_primary(named).key,
            has_walks=sections.has_walks(named),
            outcomes=sections.outcome_rows(modes) if modes else (),
            funnel=sections.funnel_rows(modes) if modes else (),
            notes=sections.goal_reached_notes(named) if modes else (),
            breakdowns=sections.breakdowns(named)[0],
            scans=sections.scans_worst_first(named),
            near_misses=near_misses(scores) if modes else {},
        )

    def without_small_groups(self) -> Self:
        """Return it as for those who must not learn how single episodes went."""
        tables = [_without_small_groups(each) for each in self.breakdowns]
        return replace(
            self,
            breakdowns=[each for each in tables if each.rows],
            scans=_without_small_groups(self.scans),
        )


def _without_small_groups(table: sections.Breakdown) -> sections.Breakdown:
    """Leave out groups of few episodes, and a larger one if they are few even together.

    The scores of all that is left out follow from the total.
    """
    small: set[str] = set()
    episodes = 0
    for row in sorted(table.rows, key=lambda row: row.episodes):
        if row.episodes < sections.FEW_EPISODES or 0 < episodes < sections.FEW_EPISODES:
            small.add(row.name)
            episodes += row.episodes
    return replace(table, rows=[row for row in table.rows if row.name not in small])


class Analyses(FileResults[Analysis]):
    """The analyses of results."""

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return those of a server."""
        return cls(server.scoring, analyse, _KEPT)


def analyse(context: Context, split: str, sha256: str) -> Analysis:
    """Score a stored upload, and analyse it."""
    board = context.boards[split]
    return Analysis.of(board.score(board.read(stored_upload(context.uploads, sha256))))


@router.get("/submissions/{submission_id}/analysis")
def show_analysis(submission_id: str, visitor: Visitor, _: ScoringTurn) -> Response:
    """Show what the scores of a result consist of: to everyone if it is published."""
    server = visitor.server
    with visitor.reading() as reading:
        shown, has_episodes = _shown(reading, submission_id)
        server.get(SubmissionService).check_episodes(shown)
        board = find_board(server.boards, shown.split)
        ranking = _ranking(reading, board)
        analysis = _analysis(visitor, board, shown.sha256)
        if analysis is not None and not has_episodes:
            analysis = analysis.without_small_groups()
        return page(
            reading,
            "method-analysis.html",
            shown=shown,
            board=board,
            analysis=analysis,
            few_episodes=sections.FEW_EPISODES,
            has_episodes=has_episodes,
            instructions=instructions_of(board),
            meanings=OUTCOMES,
            shown_groups=SHOWN_GROUPS,
            ranking=ranking,
            neighbours=_neighbours(ranking, shown.id),
            over_time=rank_chart(
                ranking,
                f"Rank of {shown.method.name}",
                lambda entry: entry.submission_id == shown.id,
            ),
        )


def _analysis(visitor: Call, board: Board, sha256: str) -> Analysis | None:
    """Return the analysis of a file; None while it is made in the background.

    Raises NotFoundError if the file cannot be read.
    """
    is_short = len(board.truth.episodes.instr_ids) <= EPISODES_AWAITED
    # A copy's pages are read once.
    most_awaited = 1 if is_short or visitor.request.app.state.is_copy else 0
    found = visitor.server.get(Analyses).find(board, [sha256], most_awaited)
    if found is None:
        return None
    analysis = found[sha256]
    if analysis is None:
        raise NotFoundError("its stored file is missing or damaged; the organiser is told")
    return analysis


def _shown(reading: CallReading, submission_id: str) -> tuple[ScoredSubmission, bool]:
    """Return a submission, and whether the visitor may look at its episodes.

    It is published, or one of the visitor's team.
    """
    session, view, own = reading.session, View.of(reading), None
    if reading.caller is not None:
        with suppress(NotFoundError):  # it may be published
            own = submission_of(session, reading.caller, submission_id, view)
    has_episodes = own is not None or publication(session, submission_id, view).shows_episodes
    report = own or view.report(any_submission(session, submission_id))
    if report.scores_held_until is not None:
        raise NotFoundError("its scores are held back until the phase ends")
    return report, has_episodes


def _ranking(reading: CallReading, board: Board) -> Ranking:
    rankings = reading.server.get(Rankings)
    return rankings.with_rank_intervals(reading.session, rankings.ranking(reading.session, board))


def _neighbours(ranking: Ranking, submission_id: str) -> Sequence[Row]:
    """Return the ranked results around one; none if it is not ranked itself."""
    ranked = [row for row in ranking.rows if row.rank is not None]
    ids = [row.entry.submission_id for row in ranked]
    if submission_id not in ids:
        return ()
    index = ids.index(submission_id)
    return ranked[max(index - NEIGHBOURS, 0) : index + NEIGHBOURS + 1]
