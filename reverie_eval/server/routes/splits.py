"""``/splits``: the splits, uploads, and leaderboards."""

from collections.abc import Collection
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Query, Response, status
from fastapi.responses import PlainTextResponse

from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.organising import NoticeReport
from reverie_eval.schemas.service import (
    Accepted,
    Checked,
    Envelope,
    FurtherBoard,
    Leaderboard,
    PhaseReport,
    QuotaReport,
    Schedule,
    Snapshot,
    SnapshotEntry,
    SplitReport,
)
from reverie_eval.server.http.callers import Anybody, Call, Server
from reverie_eval.server.http.exchange import API
from reverie_eval.server.http.openapi import TEXT, file_reply, problems
from reverie_eval.server.http.paging import Number, Paging
from reverie_eval.server.http.uploads import (
    FILE_BODY,
    METHOD_PARAMETERS,
    OF_FILES,
    OF_UPLOADS,
    Counted,
    Received,
    Sender,
    SentMethod,
)
from reverie_eval.server.service.announcements import corrections_of
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.leaderboard import as_csv, as_json, csv_of
from reverie_eval.server.service.receipts import read_as
from reverie_eval.server.service.snapshots import list_snapshots, snapshot_of
from reverie_eval.server.state import ServerState

router = APIRouter(prefix=f"{API}/splits", tags=["splits"])

SplitName = Annotated[str, Path(examples=["test"])]
FurtherName = Annotated[str, Path(examples=["grounding"])]
_SORTABLE = [key for key, metric in CATALOGUE.items() if metric.better != "neither"]
"""The metrics of all tasks; a leaderboard has those of its own."""
SortedBy = Annotated[str | None, Query(json_schema_extra={"enum": _SORTABLE})]

_CSV = (
    "rank,submission_id,team,published_at,...\n1,5f2b0c9a4d7e1f36,Blue,2027-06-02T12:00:00Z,...\n"
)
_ALSO_FOR_ANYBODY: dict[str, Any] = {"security": [{}]}
_OF_CSV = file_reply("text/csv", "malformed-request", "not-found", schema=TEXT, example=_CSV)


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


@router.get(
    "/{split}/episodes.txt",
    response_class=Response,
    responses=file_reply("text/plain", "not-found", schema=TEXT, example="4_402_2\n4_402_1\n"),
)
def download_episodes(split: SplitName, server: Server) -> Response:
    """List the instr_ids of the episodes that are scored, one a line, as ``--episodes-from`` reads.

    A submission to a declared sample has these episodes and no others.
    """
    ids = server.board(split).truth.episodes.instr_ids
    return PlainTextResponse("".join(f"{each}\n" for each in ids))


@router.post(
    "/{split}/submissions",
    status_code=status.HTTP_201_CREATED,
    responses={
        200: {"model": Accepted, "description": "The reply to the same file or key, again"},
        **problems(*OF_UPLOADS),
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
    """Score an upload and return its scores, its receipt and the submissions left.

    Describe the method in the query, or in fields of the form. Uploading the same file again, or
    using the same Idempotency-Key, returns the first result with status 200 and uses no submission.
    """
    accepted = server.intake.submit(
        person, split, upload.packed, method, idempotency_key, arrived=upload.arrived
    )
    counted.note(accepted)
    response.status_code = status.HTTP_200_OK if accepted.is_repeat else status.HTTP_201_CREATED
    return accepted


@router.post(
    "/{split}/validate",
    responses=problems(*OF_FILES),
    openapi_extra={**FILE_BODY, "parameters": METHOD_PARAMETERS},
)
def validate(split: SplitName, person: Sender, upload: Received, server: Server) -> Checked:
    """Check a file as for scoring; nothing is stored, and no submission is used.

    The solution is not used. The parameters are those of an upload; the method is ignored.
    """
    return server.intake.validate(person, split, upload.packed)


@router.get(
    "/{split}/leaderboard",
    response_model=Leaderboard,
    responses=problems("malformed-request", "not-found"),
)
def show_leaderboard(split: SplitName, server: Server, metric: SortedBy = None) -> Response:
    """Rank the published submissions by a metric; by default the split's primary one.

    Reported results are among the others, without a rank. Results that are disqualified, on another
    version of the dataset, or scored under other rules are in `apart`.
    """
    return _as_json(server, metric, split)


@router.get(
    "/{split}/leaderboard.csv",
    response_class=Response,
    responses=_OF_CSV,
)
def download_leaderboard(split: SplitName, server: Server, metric: SortedBy = None) -> Response:
    """Return the leaderboard as CSV."""
    return _as_csv(server, metric, split)


@router.get(
    "/{split}/also/{further}/leaderboard",
    response_model=Leaderboard,
    responses=problems("malformed-request", "not-found"),
)
def show_further_leaderboard(
    split: SplitName, further: FurtherName, server: Server, metric: SortedBy = None
) -> Response:
    """Rank the submissions on a further leaderboard of the split."""
    return _as_json(server, metric, split, further)


@router.get(
    "/{split}/also/{further}/leaderboard.csv",
    response_class=Response,
    responses=_OF_CSV,
)
def download_further_leaderboard(
    split: SplitName, further: FurtherName, server: Server, metric: SortedBy = None
) -> Response:
    """Return a further leaderboard of the split as CSV."""
    return _as_csv(server, metric, split, further)


@router.get("/{split}/snapshots", responses=problems("not-found"))
def list_split_snapshots(split: SplitName, server: Server, paging: Paging) -> list[SnapshotEntry]:
    """List the snapshots of the leaderboard, the latest first."""
    name = server.board(split).name
    with server.database.reading() as session:
        return paging.reply(list_snapshots(session, paging.page, name))


@router.get(
    "/{split}/snapshots/{number}.csv",
    response_class=Response,
    responses=file_reply("text/csv", "not-found", "conflict", schema=TEXT, example=_CSV),
)
def download_snapshot(split: SplitName, number: Number, server: Server) -> Response:
    """Return a snapshot as CSV; only the JSON is signed."""
    snapshot = read_as(Snapshot, show_snapshot(split, number, server))
    text = csv_of(snapshot.leaderboard.model_dump(mode="json"))
    return PlainTextResponse(text, media_type="text/csv")


@router.get("/{split}/snapshots/{number}", responses=problems("not-found"))
def show_snapshot(split: SplitName, number: Number, server: Server) -> Envelope:
    """Return a signed snapshot of the leaderboard, in a DSSE envelope; it never changes."""
    with server.database.reading() as session:
        return snapshot_of(session, split, number)


# Who asks for a leaderboard makes no difference, so a token that ended is not refused.
def _as_json(server: ServerState, metric: str | None, split: str, further: str = "") -> Response:
    board = server.board(split, further)
    with server.database.reading() as session:
        ranking = server.with_details(session, server.ranking(session, board, metric))
        corrections = corrections_of(session, [board])[board.name]
    content = as_json(ranking, corrections, server.settings.organiser)
    return Response(content, media_type="application/json")


def _as_csv(server: ServerState, metric: str | None, split: str, further: str = "") -> Response:
    board = server.board(split, further)
    with server.database.reading() as session:
        ranking = server.with_details(session, server.ranking(session, board, metric))
    return PlainTextResponse(as_csv(ranking), media_type="text/csv")


def _reports(call: Call, boards: Collection[Board]) -> list[SplitReport]:
    with call.snapshot() as snapshot:
        names = [board.name for board in boards]
        quotas = (
            call.server.intake.quotas(snapshot.session, snapshot.caller, *names)
            if snapshot.caller
            else {}
        )
        schedules = call.server.schedules.in_effect(snapshot.session)
        notice = call.server.notices.current(snapshot.session)
        return [
            _report(board, schedules[board.name], notice, quotas.get(board.name), snapshot.now)
            for board in boards
        ]


def _report(
    board: Board,
    schedule: Schedule,
    notice: NoticeReport,
    quota: QuotaReport | None,
    now: datetime,
) -> SplitReport:
    phases = [PhaseReport(**dict(phase), is_open=phase.is_open(now)) for phase in schedule.phases]
    return SplitReport(
        name=board.name,
        task=board.task.name,
        episodes=len(board.truth.episodes.instr_ids),
        subset=board.truth.subset_digest,
        split_episodes=board.n_split,
        visibility=board.split.visibility,
        protocol=board.split.protocol,
        track=board.split.track,
        dataset=board.truth.header.dataset,
        fingerprint=board.truth.fingerprint,
        public_fingerprint=board.public_fingerprint,
        phases=phases,
        release_scores=schedule.release_scores,
        paused=schedule.is_paused_on(paused_server=notice.paused),
        one_per_team=board.split.one_per_team,
        also={
            name: FurtherBoard(protocol=each.split.protocol, track=each.split.track)
            for name, each in board.also.items()
        },
        quota=quota,
    )
