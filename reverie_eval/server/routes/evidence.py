"""``/organiser/splits``: evidence about the submissions to a split, and all of them at once."""

from typing import Annotated

from fastapi import APIRouter, Query, Response
from fastapi.responses import StreamingResponse

from reverie_eval.schemas.evidence import EvidenceReport
from reverie_eval.schemas.wire import LONGEST_NAME
from reverie_eval.server.http.callers import Organiser
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.http.uploads import ScoringSlot
from reverie_eval.server.routes.splits import SplitName
from reverie_eval.server.service.bulk import archive_of

router = APIRouter(
    prefix="/organiser/splits",
    tags=["organiser"],
    responses=problems("not-signed-in", "not-allowed", "not-found"),
)

_BINARY = {"type": "string", "format": "binary"}
Team = Annotated[str | None, Query(max_length=LONGEST_NAME, examples=["Blue"])]


@router.get("/{split}/evidence")
def show_evidence(
    split: SplitName, organiser: Organiser, _: ScoringSlot, team: Team = None
) -> EvidenceReport:
    """Show what the files of a split have in common, and how those of each team differ.

    With a team, also list its submissions. Each request reads a hundred more submissions;
    `left` says how many remain. `server evidence` reads all.
    """
    organiser.person()
    return organiser.server.evidence.report(split, team)


@router.get(
    "/{split}/submissions.tar",
    response_class=Response,
    responses={200: {"content": {"application/x-tar": {"schema": _BINARY}}}},
)
def download_submissions(split: SplitName, organiser: Organiser) -> Response:
    """Return all submissions to a split as a tar archive: metadata.csv, then every file, unpacked.

    Content-Length is the length of the whole archive: if an upload cannot be read, the connection
    is closed before that.
    """
    server = organiser.server
    with organiser.snapshot() as snapshot:
        view = server.submissions.view(snapshot.session, snapshot.now)
        archive = archive_of(snapshot.session, server.board(split), server.uploads, view)
    headers = {
        "Content-Length": str(archive.length),
        "Content-Disposition": 'attachment; filename="submissions.tar"',
    }
    return StreamingResponse(archive.pieces(), media_type="application/x-tar", headers=headers)
