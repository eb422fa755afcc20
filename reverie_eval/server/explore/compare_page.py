"""``/splits/test/compare``: two results side by side."""

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.reporting.comparisons import signed
from reverie_eval.server.boards.leaderboard import Rankings
from reverie_eval.server.boards.pages import NamedBoard, Scale, of_every_board
from reverie_eval.server.explore.comparing import ComparedPair, compare_results
from reverie_eval.server.explore.episodes import instructions_of
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.intake.submissions import SubmissionService

router = APIRouter()

MOST_FLIPS = 10
"""Episodes that only one result has right, of each, that are listed."""


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
