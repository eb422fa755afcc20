"""``/desk/evidence``: what the files of a split have in common."""

from collections.abc import Mapping

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.reporting.service import history_table, pairs_table, same_files_table, teams_table
from reverie_eval.reporting.tables import Table
from reverie_eval.schemas.evidence import EvidenceReport
from reverie_eval.server.http import desk as forms
from reverie_eval.server.http.callers import Desk
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.integrity.evidence import EvidenceService

router = APIRouter()


@router.get("/desk/evidence")
def show_evidence(
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
