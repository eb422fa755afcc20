"""``/submissions``: the caller's own, their files, and changes."""

import io
from typing import Annotated

from fastapi import APIRouter, Path, Response
from fastapi.responses import StreamingResponse

from reverie_eval.reporting.scores import write_episodes
from reverie_eval.schemas.service import Envelope, SubmissionChange, SubmissionReport
from reverie_eval.server.http.callers import Caller
from reverie_eval.server.http.examples import SUBMISSION
from reverie_eval.server.http.exchange import API
from reverie_eval.server.http.openapi import TEXT, file_reply, problems
from reverie_eval.server.http.paging import Paging
from reverie_eval.server.http.uploads import ScoringTurn
from reverie_eval.server.routes.splits import FurtherName
from reverie_eval.server.service.submissions import list_submissions, result_on, submission_of

router = APIRouter(prefix=f"{API}/submissions", tags=["submissions"])

SubmissionId = Annotated[str, Path(examples=["5f2b0c9a4d7e1f36"])]
_REFUSALS = ("not-signed-in", "not-found")
_OF_ONE = problems(*_REFUSALS)
_CSV = (
    "instr_id,path_length,success,...,outcome,scan,...\n"
    "4774_267_1,12.5,1.0,...,correct,QUCTc6BB5sX,...\n"
)


@router.get("", responses=problems("not-signed-in"))
def list_own(caller: Caller, paging: Paging) -> list[SubmissionReport]:
    """List your team's submissions, the newest first; the organiser sees those of all teams."""
    with caller.snapshot() as snapshot:
        person, view = snapshot.person, snapshot.view
        return paging.reply(list_submissions(snapshot.session, person, paging.page, view))


@router.get("/{submission_id}", responses=_OF_ONE)
def show_submission(submission_id: SubmissionId, caller: Caller) -> SubmissionReport:
    """Show a submission of your team."""
    with caller.snapshot() as snapshot:
        return submission_of(snapshot.session, snapshot.person, submission_id, snapshot.view)


@router.patch("/{submission_id}", responses=problems("not-signed-in", "not-found", "conflict"))
def change_submission(
    submission_id: SubmissionId, change: SubmissionChange, caller: Caller, _: ScoringTurn
) -> SubmissionReport:
    """Publish, withdraw or edit a submission, or hide your team's name until a date."""
    return caller.server.submissions.change(caller.person(), submission_id, change)


@router.get("/{submission_id}/receipt", responses=_OF_ONE)
def show_receipt(submission_id: SubmissionId, caller: Caller) -> Envelope:
    """Return the signed receipt: an in-toto statement in a DSSE envelope."""
    return show_submission(submission_id, caller).receipt


@router.get("/{submission_id}/also/{further}/receipt", responses=_OF_ONE)
def show_further_receipt(
    submission_id: SubmissionId, further: FurtherName, caller: Caller
) -> Envelope:
    """Return the signed receipt of the result on a further leaderboard of the split."""
    return result_on(further, show_submission(submission_id, caller)).receipt


@router.get(
    "/{submission_id}/file",
    response_class=Response,
    responses=file_reply("application/json", *_REFUSALS, example=SUBMISSION),
)
def download_file(submission_id: SubmissionId, caller: Caller) -> Response:
    """Return the submitted file, unpacked and otherwise unchanged."""
    pieces = caller.server.submissions.file(show_submission(submission_id, caller))
    return StreamingResponse(pieces, media_type="application/json")


@router.get(
    "/{submission_id}/episodes",
    response_class=Response,
    responses=file_reply("text/csv", *_REFUSALS, schema=TEXT, example=_CSV),
)
def download_episodes(submission_id: SubmissionId, caller: Caller, _: ScoringTurn) -> Response:
    """Return the results of every episode as CSV, for open splits only."""
    scores = caller.server.submissions.episodes(show_submission(submission_id, caller))
    text = io.StringIO()
    write_episodes(scores, text)
    return Response(text.getvalue(), media_type="text/csv")
