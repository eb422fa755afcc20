"""``/organiser/splits/test/evidence``: what the files of a split have in common."""

from typing import Annotated

from fastapi import Query

from reverie_eval.schemas.evidence import EvidenceReport
from reverie_eval.schemas.wire import LONGEST_NAME
from reverie_eval.server.http.callers import Organiser, SplitName
from reverie_eval.server.http.openapi import organiser_router, problems
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.integrity.evidence import EvidenceService

organising = organiser_router()


Team = Annotated[str | None, Query(max_length=LONGEST_NAME, examples=["Blue"])]


@organising.get("/splits/{split}/evidence", responses=problems("not-found"))
def show_evidence(
    split: SplitName, organiser: Organiser, _: ScoringTurn, team: Team = None
) -> EvidenceReport:
    """Show what the files of a split have in common, and how those of each team differ.

    With a team, also list its submissions. Each request reads a hundred more submissions;
    `left` says how many remain. `server evidence` reads all.
    """
    evidence = organiser.server.get(EvidenceService)
    with organiser.reading() as reading:
        report, read = evidence.report(reading.session, split, team)
    evidence.keep(split, read)
    return report
