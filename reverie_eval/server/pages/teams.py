"""``/team``: one's own team, where signing in leads to."""

from collections.abc import Mapping
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import Response

from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC
from reverie_eval.server.http.callers import Server
from reverie_eval.server.pages.quotas import split_quotas
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.visitors import Member
from reverie_eval.server.service.charts import progress_of
from reverie_eval.server.service.teams import TeamView, team_of
from reverie_eval.server.state import ServerState

router = APIRouter()

MOST_SUBMISSIONS = 200
"""That the page shows; the API lists all."""


def _progress(team: TeamView, server: ServerState) -> Mapping[str, Mapping[str, Any]]:
    """Return what is drawn of each split that more than one submission has a score of."""
    metric, now = CATALOGUE[PRIMARY_METRIC], server.clock()
    of_splits = {
        split: [each for each in team.submissions if each.split == split] for split in server.boards
    }
    drawn = {
        split: progress_of(submissions, metric, now) for split, submissions in of_splits.items()
    }
    return {split: found for split, found in drawn.items() if len(found["points"]["y"]) > 1}


@router.get("/team")
def show_team(request: Request, server: Server, member: Member) -> Response:
    """Show who is in the team, what it has left, and what it has submitted."""
    person = member.token.person
    with server.database.reading() as session:
        team = team_of(session, person, MOST_SUBMISSIONS)
    return page(
        request,
        "team.html",
        member,
        team=team,
        person=person,
        left=[(each.board.name, each.quota) for each in split_quotas(server, person)],
        signed_in_with=member.token_id,
        columns=[metric for metric in CATALOGUE.values() if metric.headline],
        primary=PRIMARY_METRIC,
        progress=_progress(team, server),
        now=server.clock(),
    )
