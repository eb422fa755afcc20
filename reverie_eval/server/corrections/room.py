"""What corrections, snapshots and the audit log add to the server."""

from collections.abc import Iterable, Mapping
from datetime import datetime
from functools import partial

from sqlalchemy.orm import Session

from reverie_eval.server.corrections import desk, pages, routes
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.jobs import MINUTE, Job
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that takes snapshots that are due."""
    snapshots = server.get(Snapshots)

    def due(session: Session, now: datetime) -> Mapping[str, int]:
        return {"due": len(snapshots.due(session, now))}

    yield Job("snapshots", partial(snapshots.take_if_due, server.transactions), MINUTE, due)


ROOM = Room(
    routes=[routes.router, desk.routes],
    pages=[pages.router, desk.pages],
    jobs=jobs,
    desk=[
        Tab("Results", 3, "Corrections", "/desk/corrections"),
        Tab("In public", 4, "Snapshots", "/desk/snapshots"),
        Tab("Records", 1, "Audit log", "/desk/audit"),
    ],
)
