"""``/splits``: what can be submitted to, uploads, and the leaderboard."""

from collections.abc import Collection
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Query, Response, status
from fastapi.responses import PlainTextResponse

from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.schemas.service import (
    Accepted,
    Checked,
    Leaderboard,
    PhaseReport,
    QuotaReport,
    SplitReport,
)
from reverie_eval.server.http.callers import Anybody, Call, Server
from reverie_eval.server.http.examples import BOARD_CSV
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.http.uploads import (
    FILE_BODY,
    METHOD_PARAMETERS,
    Content,
    Counted,
    Received,
    Sender,
    SentMethod,
)
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.leaderboard import SORTABLE, as_csv, as_json

router = APIRouter(prefix="/splits", tags=["splits"])

SplitName = Annotated[str, Path(examples=["test"])]
SortedBy = Annotated[str, Query(json_schema_extra={"enum": list(SORTABLE)})]

_ALSO_FOR_ANYBODY: dict[str, Any] = {"security": [{}]}
_OF_FILES = (
    "malformed-request",
    "not-signed-in",
    "not-found",
    "too-slow",
    "too-large",
    "submission-rejected",
    "busy",
)


@router.get("", responses=problems("not-signed-in"), openapi_extra=_ALSO_FOR_ANYBODY)
def list_splits(call: Anybody) -> list[SplitReport]:
    """List the splits, with your quota if you are signed in."""
    return _reports(call, call.server.boards.values())


@router.get(
    "/{split}",
    responses=problems("not-signed-in", "not-found"),
    openapi_extra=_ALSO_FOR_ANYBODY,
)
def show_split(split: SplitName, call: Anybody) -> SplitReport:
    """Show a split, with your quota if you are signed in."""
    (report,) = _reports(call, [call.server.board(split)])
    return report


@router.post(
    "/{split}/submissions",
    status_code=status.HTTP_201_CREATED,
    responses={
        200: {"model": Accepted, "description": "The reply to the same file or key, again"},
        **problems(*_OF_FILES, "not-open", "conflict", "quota-spent", "bytes-spent"),
    },
    openapi_extra={**FILE_BODY, "parameters": METHOD_PARAMETERS},
)
def submit(
    *,
    counted: Counted,
    split: SplitName,
    person: Sender,
    upload: Received,
    method: SentMethod,
    idempotency_key: Annotated[str | None, Header(min_length=1, max_length=200)] = None,
    server: Server,
    response: Response,
) -> Accepted:
    """Score an upload and return its scores, receipt and what is left of the quota.

    What is said of the method goes into the query or into the form beside the file. The same file,
    or the same Idempotency-Key, gets the first reply again, with status 200, and spends nothing.
    """
    accepted = server.intake.submit(
        person, split, upload.packed, method, idempotency_key, arrived=upload.arrived
    )
    counted.is_repeat = accepted.is_repeat
    response.status_code = status.HTTP_200_OK if accepted.is_repeat else status.HTTP_201_CREATED
    return accepted


@router.post(
    "/{split}/validate",
    responses=problems(*_OF_FILES),
    openapi_extra={**FILE_BODY, "parameters": METHOD_PARAMETERS},
)
def validate(split: SplitName, person: Sender, content: Content, server: Server) -> Checked:
    """Run every check of an upload without using answers; nothing is stored, no submission is used.

    It takes what an upload takes; the description of the method is not looked at.
    """
    return server.intake.validate(person, split, content)


@router.get(
    "/{split}/leaderboard",
    response_model=Leaderboard,
    responses=problems("malformed-request", "not-found"),
)
def show_leaderboard(
    split: SplitName, server: Server, metric: SortedBy = PRIMARY_METRIC
) -> Response:
    """Rank the published submissions by any metric.

    What is disqualified, reported by a paper, or scored by other rules is apart, without a rank.
    """
    with server.database.reading() as session:
        ranking = server.ranking(session, split, metric)
    return Response(as_json(ranking), media_type="application/json")


@router.get(
    "/{split}/leaderboard.csv",
    response_class=Response,
    responses={
        200: {"content": {"text/csv": {"schema": {"type": "string"}, "example": BOARD_CSV}}},
        **problems("malformed-request", "not-found"),
    },
)
def download_leaderboard(
    split: SplitName, server: Server, metric: SortedBy = PRIMARY_METRIC
) -> Response:
    """Return the leaderboard as CSV."""
    with server.database.reading() as session:
        ranking = server.ranking(session, split, metric)
    return PlainTextResponse(as_csv(ranking), media_type="text/csv")


def _reports(call: Call, boards: Collection[Board]) -> list[SplitReport]:
    with call.snapshot() as snapshot:
        names = [board.name for board in boards]
        quotas = (
            call.server.intake.quotas(snapshot.session, snapshot.caller, *names)
            if snapshot.caller
            else {}
        )
        return [_report(board, quotas.get(board.name), snapshot.now) for board in boards]


def _report(board: Board, quota: QuotaReport | None, now: datetime) -> SplitReport:
    phases = [
        PhaseReport(
            name=phase.name, opens=phase.opens, closes=phase.closes, is_open=phase.is_open(now)
        )
        for phase in board.split.phases
    ]
    return SplitReport(
        name=board.name,
        episodes=len(board.truth.episodes.instr_ids),
        visibility=board.split.visibility,
        protocol=board.split.protocol,
        dataset=board.truth.header.dataset,
        fingerprint=board.truth.fingerprint,
        public_fingerprint=board.public_fingerprint,
        phases=phases,
        release_scores=board.split.release_scores,
        quota=quota,
    )
