"""``/splits``: what can be submitted to, uploads, and the leaderboard."""

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Response, status
from fastapi.responses import PlainTextResponse

from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.schemas.service import Accepted, Checked, Leaderboard, PhaseReport, SplitReport
from reverie_eval.server.http.callers import Anybody, Caller, Server
from reverie_eval.server.http.dependencies import (
    FILE_BODY,
    METHOD_PARAMETERS,
    Content,
    Counted,
    Entered,
)
from reverie_eval.server.http.examples import BOARD_CSV
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.leaderboard import SORTABLE, as_csv, as_json
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import Person

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
def list_splits(server: Server, person: Anybody) -> list[SplitReport]:
    """List the splits, with your quota if you are signed in."""
    return [_report(server, board, person) for board in server.boards.values()]


@router.get(
    "/{split}",
    responses=problems("not-signed-in", "not-found"),
    openapi_extra=_ALSO_FOR_ANYBODY,
)
def show_split(split: SplitName, server: Server, person: Anybody) -> SplitReport:
    """Show a split, with your quota if you are signed in."""
    return _report(server, server.board(split), person)


@router.post(
    "/{split}/submissions",
    status_code=status.HTTP_201_CREATED,
    responses={
        200: {"model": Accepted, "description": "The reply to the same file or key, again"},
        **problems(*_OF_FILES, "not-open", "conflict", "quota-spent"),
    },
    openapi_extra={**FILE_BODY, "parameters": METHOD_PARAMETERS},
)
def submit(
    *,
    counted: Counted,
    split: SplitName,
    person: Caller,
    entry: Entered,
    server: Server,
    response: Response,
) -> Accepted:
    """Score an upload and return its scores, receipt and what is left of the quota.

    What is said of the method goes into the query or into the form beside the file. The same file,
    or the same Idempotency-Key, gets the first reply again, with status 200, and spends nothing.
    """
    accepted = server.intake.submit(person, split, entry.packed, entry.method, entry.key)
    counted.is_repeat = accepted.is_repeat
    response.status_code = status.HTTP_200_OK if accepted.is_repeat else status.HTTP_201_CREATED
    return accepted


@router.post("/{split}/validate", responses=problems(*_OF_FILES), openapi_extra=FILE_BODY)
def validate(split: SplitName, person: Caller, content: Content, server: Server) -> Checked:
    """Run every check of an upload; no answer is looked at, and nothing is spent or kept."""
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
    return Response(as_json(server.ranking(split, metric)), media_type="application/json")


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
    return PlainTextResponse(as_csv(server.ranking(split, metric)), media_type="text/csv")


def _report(server: ServerState, board: Board, person: Person | None) -> SplitReport:
    now = server.clock()
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
        quota=server.intake.quota(person, board.name) if person else None,
    )
