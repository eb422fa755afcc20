"""``/team``: one's own team, where signing in leads to, and what it has left on each split."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.metrics import CATALOGUE, PRIMARY_METRIC
from reverie_eval.schemas.service import QuotaReport
from reverie_eval.server.http.callers import Member, Snapshot
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.charts import progress_of
from reverie_eval.server.service.people import TeamView, team_of
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
        person, view = snapshot.person, server.submissions.view(snapshot.now)
        team = team_of(snapshot.session, person, MOST_SUBMISSIONS, view)
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


@dataclass(frozen=True, slots=True)
class SplitQuota:
    """A split, for one person."""

    board: Board
    quota: QuotaReport
    is_open: bool
    opens_at: datetime | None
    """When the next phase begins; None if none will."""
    closes_at: datetime | None
    """When the phase ends that is open now; None if it does not, or none is."""


def split_quotas(server: ServerState, snapshot: Snapshot) -> Sequence[SplitQuota]:
    """Return the quota of every split for the visitor."""
    quotas = server.intake.quotas(snapshot.session, snapshot.person)
    return [
        _split_quota(board, quotas[name], snapshot.now) for name, board in server.boards.items()
    ]


def _split_quota(board: Board, quota: QuotaReport, now: datetime) -> SplitQuota:
    phases = board.split.phases
    coming = [phase.opens for phase in phases if phase.opens and phase.opens > now]
    ending = [phase.closes for phase in phases if phase.is_open(now)]
    closing = [closes for closes in ending if closes is not None]
    return SplitQuota(
        board=board,
        quota=quota,
        is_open=board.is_open(now),
        opens_at=min(coming, default=None),
        closes_at=max(closing) if closing and len(closing) == len(ending) else None,
    )
