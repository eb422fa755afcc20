"""Splits and uploads to them, the caller's submissions, and what organisers do about both."""

import io
from collections.abc import Collection
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Response, status
from fastapi.responses import PlainTextResponse, StreamingResponse

from reverie_eval.reporting.scores import write_episodes
from reverie_eval.schemas import service as schemas
from reverie_eval.schemas.organising import NoticeReport
from reverie_eval.server.boards.schedules import Schedules, View
from reverie_eval.server.http.api import API, SUBMISSION, TEXT, Paging, file_reply, problems
from reverie_eval.server.http.callers import Anybody, BoardName, Call, Caller, Server, SplitName
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.intake import uploads
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.intake.submissions import (
    SubmissionService,
    list_submissions,
    result_on,
    submission_of,
)
from reverie_eval.server.messages.notices import current_notice
from reverie_eval.server.scoring.boards import Board

splits = APIRouter(prefix=f"{API}/splits", tags=["splits"])
router = APIRouter(prefix=f"{API}/submissions", tags=["submissions"])

SubmissionId = Annotated[str, Path(examples=["5f2b0c9a4d7e1f36"])]
_REFUSALS = ("not-signed-in", "not-found")
_OF_ONE = problems(*_REFUSALS)
_CSV = (
    "instr_id,path_length,success,...,outcome,scan,...\n"
    "4774_267_1,12.5,1.0,...,correct,QUCTc6BB5sX,...\n"
)
_FOR_ANYBODY: dict[str, Any] = {"security": [{}]}


@router.get("", responses=problems("not-signed-in"))
def list_own(caller: Caller, paging: Paging) -> list[schemas.ScoredSubmission]:
    """List your team's submissions, the newest first; the organiser sees those of all teams."""
    with caller.reading() as reading:
        person, view = reading.person, View.of(reading)
        return paging.reply(list_submissions(reading.session, person, paging.page, view))


@router.get("/{submission_id}", responses=_OF_ONE)
def show_submission(submission_id: SubmissionId, caller: Caller) -> schemas.ScoredSubmission:
    """Show a submission of your team."""
    with caller.reading() as reading:
        return submission_of(reading.session, reading.person, submission_id, View.of(reading))


@router.patch("/{submission_id}", responses=problems("not-signed-in", "not-found", "conflict"))
def change_submission(
    submission_id: SubmissionId, change: schemas.SubmissionChange, caller: Caller, _: ScoringTurn
) -> schemas.ScoredSubmission:
    """Publish, withdraw or edit a submission, or hide your team's name until a date."""
    return caller.server.get(SubmissionService).change(caller.person(), submission_id, change)


@router.get("/{submission_id}/receipt", responses=_OF_ONE)
def show_receipt(submission_id: SubmissionId, caller: Caller) -> schemas.Envelope:
    """Return the signed receipt: an in-toto statement in a DSSE envelope."""
    return show_submission(submission_id, caller).receipt


@router.get("/{submission_id}/boards/{board}/receipt", responses=_OF_ONE)
def show_named_receipt(
    submission_id: SubmissionId, board: BoardName, caller: Caller
) -> schemas.Envelope:
    """Return the signed receipt of the result on another leaderboard of the split."""
    return result_on(board, show_submission(submission_id, caller)).receipt


@router.get(
    "/{submission_id}/file",
    response_class=Response,
    responses=file_reply("application/json", *_REFUSALS, example=SUBMISSION),
)
def download_file(submission_id: SubmissionId, caller: Caller) -> Response:
    """Return the submitted file, unpacked and otherwise unchanged."""
    pieces = caller.server.get(SubmissionService).file(show_submission(submission_id, caller))
    return StreamingResponse(pieces, media_type="application/json")


@router.get(
    "/{submission_id}/episodes",
    response_class=Response,
    responses=file_reply("text/csv", *_REFUSALS, schema=TEXT, example=_CSV),
)
def download_episodes(submission_id: SubmissionId, caller: Caller, _: ScoringTurn) -> Response:
    """Return the results of every episode as CSV, for open splits only."""
    scores = caller.server.get(SubmissionService).episodes(show_submission(submission_id, caller))
    text = io.StringIO()
    write_episodes(scores, text)
    return Response(text.getvalue(), media_type="text/csv")


@splits.get("", responses=problems("not-signed-in"), openapi_extra=_FOR_ANYBODY)
def list_splits(call: Anybody) -> list[schemas.SplitReport]:
    """List the splits, with your quota if you are signed in."""
    return _reports(call, call.server.boards.values())


@splits.get(
    "/{split}",
    responses=problems("not-signed-in", "not-found"),
    openapi_extra=_FOR_ANYBODY,
)
def show_split(split: SplitName, call: Anybody) -> schemas.SplitReport:
    """Show a split, with your quota if you are signed in."""
    (report,) = _reports(call, [call.server.board(split)])
    return report


@splits.get(
    "/{split}/episodes.txt",
    response_class=Response,
    responses=file_reply("text/plain", "not-found", schema=TEXT, example="4_402_2\n4_402_1\n"),
)
def download_split_episodes(split: SplitName, server: Server) -> Response:
    """List the instr_ids of the episodes that are scored, one a line, as ``--episodes-from`` reads.

    A submission to a declared sample has these episodes and no others.
    """
    ids = server.board(split).truth.episodes.instr_ids
    return PlainTextResponse("".join(f"{each}\n" for each in ids))


@splits.post(
    "/{split}/submissions",
    status_code=status.HTTP_201_CREATED,
    responses={
        200: {"model": schemas.Accepted, "description": "The reply to the same file or key, again"},
        **problems(*uploads.OF_UPLOADS),
    },
    openapi_extra={**uploads.FILE_BODY, "parameters": uploads.METHOD_PARAMETERS},
)
def submit(
    *,
    counted: uploads.Counted,
    split: SplitName,
    caller: Caller,
    file: uploads.Received,
    method: uploads.SentMethod,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200)] = None,
    response: Response,
) -> schemas.Accepted:
    """Score an upload and return its scores, its receipt and the submissions left.

    Describe the method in the query, or in fields of the form. Uploading the same file again, or
    using the same Idempotency-Key, returns the first result with status 200 and uses no submission.
    """
    accepted = caller.server.get(Intake).submit(
        caller.person(), split, file.packed, method, idempotency_key, arrived=file.arrived
    )
    counted.note(accepted)
    response.status_code = status.HTTP_200_OK if accepted.is_repeat else status.HTTP_201_CREATED
    return accepted


@splits.post(
    "/{split}/validate",
    responses=problems(*uploads.OF_FILES),
    openapi_extra={**uploads.FILE_BODY, "parameters": uploads.METHOD_PARAMETERS},
)
def validate(split: SplitName, caller: Caller, file: uploads.Received) -> schemas.Checked:
    """Check a file as for scoring; nothing is stored, and no submission is used.

    The solution is not used. The parameters are those of an upload; the method is ignored.
    """
    return caller.server.get(Intake).validate(caller.person(), split, file.packed)


def _reports(call: Call, boards: Collection[Board]) -> list[schemas.SplitReport]:
    with call.reading() as reading:
        names = [board.split for board in boards]
        quotas = (
            call.server.get(Intake).quotas(reading.session, reading.caller, *names)
            if reading.caller
            else {}
        )
        schedules = call.server.get(Schedules).in_effect(reading.session)
        notice = current_notice(reading.session)
        return [
            _report(board, schedules[board.split], notice, quotas.get(board.split), reading.now)
            for board in boards
        ]


def _report(
    board: Board,
    schedule: schemas.Schedule,
    notice: NoticeReport,
    quota: schemas.QuotaReport | None,
    now: datetime,
) -> schemas.SplitReport:
    phases = [
        schemas.PhaseReport(**dict(phase), is_open=phase.is_open(now)) for phase in schedule.phases
    ]
    return schemas.SplitReport(
        name=board.split,
        task=board.task.name,
        episodes=len(board.truth.episodes.instr_ids),
        subset=board.truth.subset_digest,
        split_episodes=board.n_split,
        visibility=board.settings.visibility,
        protocol=board.settings.protocol,
        track=board.settings.track,
        dataset=board.truth.header.dataset,
        fingerprint=board.truth.fingerprint,
        public_fingerprint=board.public_fingerprint,
        phases=phases,
        release_scores=schedule.release_scores,
        paused=schedule.is_paused_on(paused_server=notice.paused),
        one_per_team=board.settings.one_per_team,
        boards={
            name: schemas.BoardRules(protocol=each.settings.protocol, track=each.settings.track)
            for name, each in board.others.items()
        },
        quota=quota,
    )
