"""``/splits/test/snapshots/3``: a state of a leaderboard, which never changes."""

from fastapi import APIRouter
from fastapi.responses import Response

from reverie_eval.reporting.service import headline_of
from reverie_eval.schemas.service import Snapshot
from reverie_eval.server.audit.receipts import read_as
from reverie_eval.server.corrections.snapshots import snapshot_of
from reverie_eval.server.http.callers import Visitor
from reverie_eval.server.http.paging import Number
from reverie_eval.server.http.rendering import page

router = APIRouter()


@router.get("/splits/{split}/snapshots/{number}")
def show_snapshot(split: str, number: Number, visitor: Visitor) -> Response:
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
