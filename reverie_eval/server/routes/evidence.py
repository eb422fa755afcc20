"""``/organiser/splits``: what organisers find out about the submissions to a split."""

from typing import Annotated

from fastapi import APIRouter, Query

from reverie_eval.schemas.evidence import EvidenceReport
from reverie_eval.schemas.wire import LONGEST_NAME
from reverie_eval.server.http.callers import Organiser
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.http.uploads import ScoringSlot
from reverie_eval.server.routes.splits import SplitName

router = APIRouter(
    prefix="/organiser/splits",
    tags=["organiser"],
    responses=problems("not-signed-in", "not-allowed", "not-found"),
)

Team = Annotated[str | None, Query(max_length=LONGEST_NAME, examples=["Blue"])]


@router.get("/{split}/evidence")
def show_evidence(
    split: SplitName, organiser: Organiser, _: ScoringSlot, team: Team = None
) -> EvidenceReport:
    """Show what files of a split have in common, and how those of each team differ.

    With a team, also its submissions one by one. Each request reads a hundred further submissions;
    `left` says how many remain. `server evidence` reads all.
    """
    organiser.person()
    return organiser.server.evidence.report(split, team)
