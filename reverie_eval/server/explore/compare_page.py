"""``/splits/test/compare``: how much two results differ, and whether significantly.

On an open split, they are compared on the same episodes, as ``reverie-eval compare`` does with
their files. On a private split, only the differences of the values that everyone sees are computed:
an interval of a difference would reveal more about the episodes than these digits do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
from fastapi import APIRouter, Query
from fastapi.responses import Response
from sqlalchemy import select
from sqlalchemy.orm import Session, joinedload

from reverie_eval.analysis import Comparison, Difference
from reverie_eval.errors import ProtocolError
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.comparisons import signed
from reverie_eval.scoring import CORRECT, OUTCOMES, outcome_indices
from reverie_eval.server.boards.entries import Row
from reverie_eval.server.boards.leaderboard import Ranking, Rankings, method_names
from reverie_eval.server.boards.pages import NamedBoard, Scale, of_every_board
from reverie_eval.server.errors import MalformedError, NotFoundError
from reverie_eval.server.explore.episodes import instructions_of
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.intake.submissions import SubmissionService, with_public_episodes
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.store.tables import Submission

router = APIRouter()

MOST_FLIPS = 10
"""Episodes that only one result has right, of each, that are listed."""
_COMPARED = 2
"""Results that are compared at a time."""
Outcomes: TypeAlias = Mapping[str, Mapping[str, int]]
"""Number of episodes, by the outcome of the first result and by that of the second."""


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
