"""What evidence about submissions adds to the server: what the files of a split have in common.

``/organiser/splits/test/evidence`` of the API, and ``/desk/evidence``.
"""

from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response

from reverie_eval.reporting.service import history_table, pairs_table, same_files_table, teams_table
from reverie_eval.reporting.tables import Table
from reverie_eval.schemas.evidence import EvidenceReport
from reverie_eval.schemas.wire import LONGEST_NAME
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.callers import Desk, Organiser, SplitName
from reverie_eval.server.http.openapi import organiser_router, problems
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.integrity.evidence import EvidenceService
from reverie_eval.server.rooms import Room, Tab

organising = organiser_router()
router = APIRouter()

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


@router.get("/desk/evidence")
def show_page(
    desk: Desk, _: ScoringTurn, split: forms.Sought = "", team: forms.Sought = ""
) -> Response:
    """Show the evidence about a split, and about the submissions of a team to it."""
    service, evidence = desk.server.get(EvidenceService), None
    with desk.reading() as reading:  # others than organisers may not have uploads read
        if split:
            evidence = service.report(reading.session, split, team or None)
        reply = page(
            reading,
            "desk/evidence.html",
            report=evidence and evidence.report,
            tables=_tables(evidence.report, team) if evidence else {},
            splits=list(desk.server.boards),
            split=split,
            team=team,
        )
    if evidence:
        service.keep(split, evidence.read)
    return reply


def _tables(report: EvidenceReport, team: str) -> Mapping[str, Table]:
    """Return the tables of the page by their headings."""
    return {
        "The same file from several teams": same_files_table(report.same_files),
        "Most similar files of two teams": pairs_table(report),
        "Files of each team": teams_table(report.teams),
        **({f"Submissions of {team}": history_table(report.history)} if team else {}),
    }


ROOM = Room(
    routes=[organising],
    pages=[router],
    desk=[Tab("Results", 2, "Evidence", "/desk/evidence")],
)
