"""A result in detail: where it succeeds and fails, and how much it differs from another.

``/submissions/{id}/analysis`` analyses a result of an open split.

``/splits/{split}/compare`` compares two. On an open split, this is on the same episodes, as
``reverie-eval compare`` does with their files. On a private split, only the differences of the
values that everyone sees are computed: an interval of a difference would reveal more about the
episodes than these digits do.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, Self, TypeAlias

import numpy as np
from fastapi import APIRouter, Query, Response
from sqlalchemy import select
from sqlalchemy.orm import Session, joinedload

from reverie_eval.analysis import Comparison, Difference, near_misses
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting import report_sections as sections
from reverie_eval.reporting.comparisons import signed
from reverie_eval.schemas.service import ScoredSubmission
from reverie_eval.scoring import CORRECT, OUTCOMES, Scores, outcome_indices
from reverie_eval.server.boards.charts import rank_chart
from reverie_eval.server.boards.entries import Row
from reverie_eval.server.boards.leaderboard import Ranking, Rankings, method_names
from reverie_eval.server.boards.pages import NamedBoard, Scale, of_every_board
from reverie_eval.server.boards.reviews import any_submission
from reverie_eval.server.boards.schedules import View
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.explore.episodes import instructions_of
from reverie_eval.server.explore.side_by_side import FileResults
from reverie_eval.server.http.callers import Call, CallReading, Visitor
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.intake.submissions import (
    SubmissionService,
    publication,
    submission_of,
    with_public_episodes,
)
from reverie_eval.server.scoring.boards import Board, find_board
from reverie_eval.server.scoring.contexts import Context
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.uploads import stored_upload

router = APIRouter()

SHOWN_GROUPS = 8
"""Rows of a breakdown that are not folded."""
NEIGHBOURS = 3
"""Results above and below one that are shown with it."""
EPISODES_AWAITED = 1000
"""Episodes of a split whose analysis a page waits for, at most; that of more takes seconds."""
_KEPT = 32
MOST_FLIPS = 10
"""Episodes that only one result has right, of each, that are listed."""
_COMPARED = 2
"""Results that are compared at a time."""
Outcomes: TypeAlias = Mapping[str, Mapping[str, int]]
"""Number of episodes, by the outcome of the first result and by that of the second."""


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


@dataclass(frozen=True, slots=True)
class ComparedPair:
    """Two ranked results of a leaderboard."""

    ranking: Ranking
    rows: Sequence[Row]
    names: Sequence[str]
    """The names of their methods, made distinct."""
    comparison: Comparison | None
    """The first result minus the second; None if they cannot be compared on the same episodes."""
    why_not: str
    """Why there is no comparison."""
    outcomes: Outcomes
    """Empty unless everyone may look at the episodes of both."""
    flips: Mapping[str, Sequence[str]]
    """The ids of the episodes in which only one is correct, by its name; empty as ``outcomes``."""

    @property
    def metrics(self) -> Sequence[Metric]:
        """The metrics that both results have, headline metrics first."""
        first, second = (row.entry.scores for row in self.rows)
        both = [metric for key, metric in CATALOGUE.items() if key in first and key in second]
        headline = self.ranking.board.task.headline
        return sorted(both, key=lambda metric: metric.key not in headline)

    def difference(self, metric: Metric) -> float:
        """Return the value of the first result minus that of the second."""
        found = self.paired(metric)
        first, second = (row.entry.scores[metric.key] for row in self.rows)
        return first - second if found is None else found.mean

    def paired(self, metric: Metric) -> Difference | None:
        """Return the difference on the same episodes, which has an interval."""
        return None if self.comparison is None else self.comparison[self.names[0]].get(metric.key)

    @property
    def most(self) -> int:
        """The largest number of episodes with the same two outcomes, at least 1."""
        return max([1, *(count for row in self.outcomes.values() for count in row.values())])

    @property
    def won(self) -> Sequence[int]:
        """The number of episodes in which only the first, and only the second, is correct."""
        *wrong, correct = OUTCOMES
        return (
            sum(self.outcomes[correct][other] for other in wrong),
            sum(self.outcomes[other][correct] for other in wrong),
        )


def compare_results(
    session: Session, submissions: SubmissionService, ranking: Ranking, ids: Sequence[str]
) -> ComparedPair:
    """Compare two results of a leaderboard.

    Raises
    ------
    MalformedError
        If these are not two results.
    NotFoundError
        If one of them is not ranked.
    """
    if len(set(ids)) != _COMPARED:
        raise MalformedError(f"tick two results to compare, not {len(set(ids))}")
    ranked = {row.entry.submission_id: row for row in ranking.rows if row.entry.is_ranked}
    ids = list(dict.fromkeys(ids))
    for each in ids:
        if each not in ranked:
            raise NotFoundError(
                f"{ranking.board.label} has no ranked result {each!r}; results that are reported, "
                "disqualified or scored under other rules cannot be compared"
            )
    rows = [ranked[each] for each in ids]
    names = method_names(ranking, rows)
    comparison, why_not = None, _why_not(ranking, rows)
    if not why_not:
        try:
            # The core computes differences from the first result that it is given.
            second_first = dict(zip(reversed(names), reversed(ids), strict=True))
            comparison = _paired(session, submissions, ranking.board, second_first)
        except (NotFoundError, ProtocolError) as error:
            why_not = str(error)
    outcomes: Outcomes = {}
    flips: Mapping[str, Sequence[str]] = {}
    if comparison is not None and _show_episodes(session, ranking, ids):
        outcomes, flips = _outcomes(comparison, names)
    return ComparedPair(ranking, rows, names, comparison, why_not, outcomes, flips)


def _why_not(ranking: Ranking, rows: Sequence[Row]) -> str:
    """Return why results must not be compared on the same episodes; empty if they may."""
    if any(row.entry.scores_held_until for row in rows):
        return "scores are held back until the phase ends"
    if ranking.board.is_private:
        return (
            "this split is private, and an interval of a difference would reveal more about its "
            "episodes than the digits that everyone sees"
        )
    return ""


def _paired(
    session: Session, submissions: SubmissionService, board: Board, named: Mapping[str, str]
) -> Comparison:
    """Compare results, by the names of their methods, on the same episodes."""
    chosen = select(Submission).where(Submission.id.in_(named.values()))
    chosen = chosen.options(joinedload(Submission.team), joinedload(Submission.person))
    reports = {row.id: row.as_scored() for row in session.scalars(chosen)}
    return submissions.compare(board, {name: reports[each] for name, each in named.items()})


def _show_episodes(session: Session, ranking: Ranking, ids: Sequence[str]) -> bool:
    """Whether everyone may look at all of these results' episodes on the pages of episodes.

    These pages show them as the split's main leaderboard scores them.
    """
    public = with_public_episodes(ranking.board.split).where(Submission.id.in_(ids))
    return not ranking.board.name and len(session.scalars(public).all()) == len(ids)


def _outcomes(
    comparison: Comparison, names: Sequence[str]
) -> tuple[Outcomes, Mapping[str, Sequence[str]]]:
    """Count episodes by their two outcomes, and list those in which only one result is correct.

    Both are empty if the protocol lacks the metrics for it.
    """
    scores = [comparison.scores[name] for name in names]
    try:
        first, second = (outcome_indices(each.episodes) for each in scores)
    except ProtocolError:
        return {}, {}
    counts = np.zeros((len(OUTCOMES), len(OUTCOMES)), dtype=np.int64)
    np.add.at(counts, (first, second), 1)
    outcomes = {
        outcome: dict(zip(OUTCOMES, row, strict=True))
        for outcome, row in zip(OUTCOMES, counts.tolist(), strict=True)
    }
    is_first, is_second = first == CORRECT, second == CORRECT
    won = (is_first & ~is_second, is_second & ~is_first)
    flips = {
        name: [scores[0].instr_ids[row] for row in np.flatnonzero(rows).tolist()]
        for name, rows in zip(names, won, strict=True)
    }
    return outcomes, flips


@of_every_board(router, "/compare")
def show_comparison(
    board: NamedBoard,
    visitor: Visitor,
    _: ScoringTurn,
    result: Annotated[list[str], Query(default_factory=list)],
) -> Response:
    """Compare two results, by their ids."""
    with visitor.reading() as reading:
        ranking = visitor.server.get(Rankings).ranking(reading.session, board)
        pair = compare_results(
            reading.session, visitor.server.get(SubmissionService), ranking, result
        )
        return page(
            reading,
            "compare.html",
            board=board,
            pair=pair,
            signed=signed,
            scale=_scale(pair),
            most_flips=MOST_FLIPS,
            instructions=instructions_of(board),
        )


def _scale(pair: ComparedPair) -> Scale:
    """Return where differences of rates lie on bars, on which no difference is shown, too."""
    found = [pair.paired(metric) for metric in pair.metrics if metric.unit == "fraction"]
    ends = [end for each in found if each for end in (each.interval.low, each.interval.high)]
    return Scale(min([0.0, *ends]), max([0.0, *ends]))
