"""What corrections, snapshots and the audit log add to the server.

Everyone may read snapshots, over the API and at ``/splits/test/snapshots/3``.
"""

from collections.abc import Iterable, Mapping
from datetime import datetime
from functools import partial

from fastapi import APIRouter
from fastapi.responses import PlainTextResponse, Response
from sqlalchemy.orm import Session

from reverie_eval.reporting.service import headline_of
from reverie_eval.schemas.service import Envelope, Snapshot, SnapshotEntry
from reverie_eval.server.audit.signing import read_as
from reverie_eval.server.boards.leaderboard import csv_of
from reverie_eval.server.boards.pages import LEADERBOARD_CSV
from reverie_eval.server.corrections import desk
from reverie_eval.server.corrections.snapshots import Snapshots, list_snapshots, snapshot_of
from reverie_eval.server.http.api import API, TEXT, Number, Paging, file_reply, problems
from reverie_eval.server.http.callers import Server, SplitName, Visitor
from reverie_eval.server.http.rendering import page
from reverie_eval.server.jobs import MINUTE, Job
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState

routes, pages = APIRouter(prefix=f"{API}/splits", tags=["splits"]), APIRouter()


@routes.get("/{split}/snapshots", responses=problems("not-found"))
def list_split_snapshots(split: SplitName, server: Server, paging: Paging) -> list[SnapshotEntry]:
    """List the snapshots of the leaderboard, the latest first."""
    name = server.board(split).split
    with server.database.reading() as session:
        return paging.reply(list_snapshots(session, paging.page, name))


@routes.get(
    "/{split}/snapshots/{number}.csv",
    response_class=Response,
    responses=file_reply("text/csv", "not-found", "conflict", schema=TEXT, example=LEADERBOARD_CSV),
)
def download_snapshot(split: SplitName, number: Number, server: Server) -> Response:
    """Return a snapshot as CSV; only the JSON is signed."""
    snapshot = read_as(Snapshot, show_snapshot(split, number, server))
    text = csv_of(snapshot.leaderboard.model_dump(mode="json"))
    return PlainTextResponse(text, media_type="text/csv")


@routes.get("/{split}/snapshots/{number}", responses=problems("not-found"))
def show_snapshot(split: SplitName, number: Number, server: Server) -> Envelope:
    """Return a signed snapshot of the leaderboard, in a DSSE envelope; it never changes."""
    with server.database.reading() as session:
        return snapshot_of(session, split, number)


@pages.get("/splits/{split}/snapshots/{number}")
def show_page(split: str, number: Number, visitor: Visitor) -> Response:
    """Show a snapshot of a leaderboard, which never changes."""
    with visitor.reading() as reading:
        shown = read_as(Snapshot, snapshot_of(reading.session, split, number))
        rows = [*shown.leaderboard.rows, *shown.leaderboard.apart]
        scored = {key for row in rows for key in row.scores}
        return page(
            reading,
            "snapshot.html",
            shown=shown,
            columns=headline_of(shown.leaderboard.signature, scored),
        )


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that takes snapshots that are due."""
    snapshots = server.get(Snapshots)

    def due(session: Session, now: datetime) -> Mapping[str, int]:
        return {"due": len(snapshots.due(session, now))}

    yield Job("snapshots", partial(snapshots.take_if_due, server.transactions), MINUTE, due)


ROOM = Room(
    routes=[routes, desk.routes],
    pages=[pages, desk.pages],
    jobs=jobs,
    desk=[
        Tab("Results", 3, "Corrections", "/desk/corrections"),
        Tab("In public", 4, "Snapshots", "/desk/snapshots"),
        Tab("Records", 1, "Audit log", "/desk/audit"),
    ],
)
