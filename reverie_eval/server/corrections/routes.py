"""Signed snapshots of leaderboards."""

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse

from reverie_eval.schemas.service import Envelope, Snapshot, SnapshotEntry
from reverie_eval.server.audit.receipts import read_as
from reverie_eval.server.boards.leaderboard import csv_of
from reverie_eval.server.boards.routes import LEADERBOARD_CSV
from reverie_eval.server.corrections.snapshots import list_snapshots, snapshot_of
from reverie_eval.server.http.callers import Server, SplitName
from reverie_eval.server.http.exchange import API
from reverie_eval.server.http.openapi import TEXT, file_reply, problems
from reverie_eval.server.http.paging import Number, Paging

router = APIRouter(prefix=f"{API}/splits", tags=["splits"])


@router.get("/{split}/snapshots", responses=problems("not-found"))
def list_split_snapshots(split: SplitName, server: Server, paging: Paging) -> list[SnapshotEntry]:
    """List the snapshots of the leaderboard, the latest first."""
    name = server.board(split).split
    with server.database.reading() as session:
        return paging.reply(list_snapshots(session, paging.page, name))


@router.get(
    "/{split}/snapshots/{number}.csv",
    response_class=Response,
    responses=file_reply("text/csv", "not-found", "conflict", schema=TEXT, example=LEADERBOARD_CSV),
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
