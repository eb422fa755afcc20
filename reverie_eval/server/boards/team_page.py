"""``/teams/{id}``: the published results of a team, and its rank over time."""

from collections.abc import Sequence
from typing import NamedTuple

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.metrics import Metric
from reverie_eval.server.boards.charts import rank_chart
from reverie_eval.server.boards.entries import Entry, Row
from reverie_eval.server.boards.leaderboard import Ranking, Rankings
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.rendering import page
from reverie_eval.server.scoring.boards import Board

router = APIRouter()


class TeamResults(NamedTuple):
    """What a team has on a leaderboard."""

    board: Board
    rows: Sequence[Row]
    """At least one."""
    metrics: Sequence[Metric]
    rank_over_time: str
    """A picture; empty if no result has a rank."""


@router.get("/teams/{team_id}")
def show_public_team(team_id: Number, visitor: Visitor) -> Response:
    """Show what everyone may see of a team; results for which it is anonymous are left out."""
    server = visitor.server
    with visitor.reading() as reading:
        rankings = server.get(Rankings).rankings(reading.session, [*server.boards.values()])
        found = [each for ranking in rankings if ranking for each in _of_team(ranking, team_id)]
        if not found:
            raise NotFoundError("there is no team with published results here")
        name = found[0].rows[0].entry.team
        return page(reading, "public-team.html", name=name, results=found)


def _of_team(ranking: Ranking, team_id: int) -> Sequence[TeamResults]:
    """Return the results on a leaderboard; none if there are none, or all are anonymous."""

    def is_own(entry: Entry) -> bool:
        return entry.team_id == team_id and ranking.team(entry) != ""

    rows = [row for row in (*ranking.rows, *ranking.apart) if is_own(row.entry)]
    if not rows:
        return ()
    task = ranking.board.task
    metrics = task.headline_metrics({key for row in rows for key in row.entry.scores})
    title = f"Best rank of {rows[0].entry.team} on {ranking.board.label}"
    return [TeamResults(ranking.board, rows, metrics, rank_chart(ranking, title, is_own))]
