"""``/desk/evidence``: what files have in common, and how those of a team differ."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.reporting._evidence import (
    history_table,
    pairs_table,
    same_files_table,
    teams_table,
)
from reverie_eval.server.http.callers import Desk
from reverie_eval.server.http.uploads import ScoringSlot
from reverie_eval.server.pages.desk.overview import Sought
from reverie_eval.server.pages.rendering import page

router = APIRouter()


@router.get("/desk/evidence")
def show_evidence(desk: Desk, _: ScoringSlot, split: Sought = "", team: Sought = "") -> Response:
    """Show the evidence about a split, and about the submissions of a team to it."""
    desk.person()  # others may not have uploads read
    boards = list(desk.server.boards)
    report = desk.server.evidence.report(split, team or None) if split else None
    tables = {}
    if report is not None:
        tables["The same file from several teams"] = same_files_table(report.same_files)
        tables["Most similar files of two teams"] = pairs_table(report)
        tables["Files of each team"] = teams_table(report.teams)
        if team:
            tables[f"Submissions of {team}"] = history_table(report.history)
    with desk.snapshot() as snapshot:
        return page(
            snapshot,
            "desk/evidence.html",
            report=report,
            tables=tables,
            splits=boards,
            split=split,
            team=team,
        )
