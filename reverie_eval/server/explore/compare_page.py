"""``/boards/test/compare``: two results side by side."""

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.reporting.comparisons import signed
from reverie_eval.server.boards.leaderboard import Rankings
from reverie_eval.server.boards.pages import NamedBoard, of_every_board
from reverie_eval.server.explore.comparing import compare_results
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.intake.submissions import SubmissionService

router = APIRouter()


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
        return page(reading, "compare.html", board=board, pair=pair, signed=signed)
