"""``/team``: one's own team, where signing in leads to."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC
from reverie_eval.server.pages.quotas import split_quotas
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.visitors import Member
from reverie_eval.server.service.charts import progress_of
from reverie_eval.server.service.teams import TeamView, team_of
from reverie_eval.server.state import ServerState

router = APIRouter()

MOST_SUBMISSIONS = 200
"""That the page shows; the API lists all."""


def _progress(
    team: TeamView, server: ServerState, now: datetime
) -> Mapping[str, Mapping[str, Any]]:
    """Return what is drawn of each split that more than one submission has a score of."""
    metric = CATALOGUE[PRIMARY_METRIC]
    of_splits = {
        split: [each for each in team.submissions if each.split == split] for split in server.boards
    }
    drawn = {
        split: progress_of(submissions, metric, now) for split, submissions in of_splits.items()
    }
    return {split: found for split, found in drawn.items() if len(found["points"]["y"]) > 1}


@router.get("/team")
def show_team(member: Member) -> Response:
    """Show who is in the team, what it has left, and what it has submitted."""
    server = member.server
    with member.snapshot() as snapshot:
        person, team = snapshot.person, team_of(snapshot.session, snapshot.person, MOST_SUBMISSIONS)
        left = [(each.board.name, each.quota) for each in split_quotas(server, snapshot)]
        return page(
            member.request,
            "team.html",
            snapshot,
            team=team,
            person=person,
            left=left,
            signed_in_with=snapshot.browser and snapshot.browser.token_id,
            columns=[metric for metric in CATALOGUE.values() if metric.headline],
            primary=PRIMARY_METRIC,
            progress=_progress(team, server, snapshot.now),
            now=snapshot.now,
        )
