"""``/submissions``: one's own, what was uploaded, and what may be changed afterwards."""

import io
from typing import Annotated

from fastapi import APIRouter, Path, Response
from fastapi.responses import StreamingResponse

from reverie_eval.reporting._scores import write_episodes
from reverie_eval.schemas.service import Receipt, SubmissionChange, SubmissionReport
from reverie_eval.server.http.callers import Caller, Server
from reverie_eval.server.http.dependencies import Turn
from reverie_eval.server.http.examples import EPISODES_CSV, SUBMISSION
from reverie_eval.server.http.openapi import problems

router = APIRouter(prefix="/submissions", tags=["submissions"])

SubmissionId = Annotated[str, Path(examples=["5f2b0c9a4d7e1f36"])]
_OF_ONE = problems("not-signed-in", "not-found")


@router.get("", responses=problems("not-signed-in"))
def list_submissions(person: Caller, server: Server) -> list[SubmissionReport]:
    """List your team's submissions, the newest first; the organiser sees all."""
    return list(server.submissions.mine(person))


@router.get("/{submission_id}", responses=_OF_ONE)
def show_submission(
    submission_id: SubmissionId, person: Caller, server: Server
) -> SubmissionReport:
    """Show a submission of your team."""
    return server.submissions.one(person, submission_id)


@router.patch("/{submission_id}", responses=problems("not-signed-in", "not-found", "conflict"))
def change_submission(
    submission_id: SubmissionId, change: SubmissionChange, person: Caller, server: Server, _: Turn
) -> SubmissionReport:
    """Publish or withdraw a submission, edit what is said of it, hide your team until a date."""
    return server.submissions.change(person, submission_id, change)


@router.get("/{submission_id}/receipt", responses=_OF_ONE)
def show_receipt(submission_id: SubmissionId, person: Caller, server: Server) -> Receipt:
    """Return the signed receipt."""
    return server.submissions.one(person, submission_id).receipt


@router.get(
    "/{submission_id}/file",
    response_class=Response,
    responses={
        200: {"content": {"application/json": {"example": SUBMISSION}}},
        **_OF_ONE,
    },
)
def download_file(submission_id: SubmissionId, person: Caller, server: Server) -> Response:
    """Return what was uploaded, unpacked, byte for byte."""
    pieces = server.submissions.file(person, submission_id)
    return StreamingResponse(pieces, media_type="application/json")


@router.get(
    "/{submission_id}/episodes",
    response_class=Response,
    responses={
        200: {"content": {"text/csv": {"schema": {"type": "string"}, "example": EPISODES_CSV}}},
        **_OF_ONE,
    },
)
def download_episodes(
    submission_id: SubmissionId, person: Caller, server: Server, _: Turn
) -> Response:
    """Return the values of every episode as CSV; of open splits only."""
    text = io.StringIO()
    write_episodes(server.submissions.episodes(person, submission_id), text)
    return Response(text.getvalue(), media_type="text/csv")
