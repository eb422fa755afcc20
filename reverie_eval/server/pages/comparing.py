"""``/boards/SPLIT/compare``: two results of a leaderboard side by side."""

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.reporting._comparison import signed
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.uploads import ScoringSlot
from reverie_eval.server.pages.boards import PATHS, NamedBoard
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.service.comparing import compare_results

router = APIRouter()
of_board = APIRouter()


@of_board.get("/compare")
def show_comparison(
    board: NamedBoard,
    visitor: Visitor,
    _: ScoringSlot,
    result: Annotated[list[str], Query(default_factory=list)],
) -> Response:
    """Compare two results, by their ids."""
    with visitor.snapshot() as snapshot:
        ranking = visitor.server.ranking(snapshot.session, board)
        pair = compare_results(snapshot.session, visitor.server.submissions, ranking, result)
        return page(snapshot, "compare.html", board=board, pair=pair, signed=signed)


for path in PATHS:
    router.include_router(of_board, prefix=path)
