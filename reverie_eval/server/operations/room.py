"""What watching over itself adds to the server.

``/desk`` shows its state, and the uploads of the last day.
"""

import shutil
from collections.abc import Iterable
from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import Response

from reverie_eval.schemas.service import HealthReport
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.http.callers import Desk
from reverie_eval.server.http.rendering import page
from reverie_eval.server.intake.attempts import (
    RECENTLY,
    counts_of_splits,
    last_day,
    list_attempts,
    totals,
)
from reverie_eval.server.jobs import SECOND, Job
from reverie_eval.server.operations.health import Examined
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.paging import Page

router = APIRouter()

A_FEW = 8


async def examined(health: Examined) -> HealthReport:
    """Return the report of ``/healthz``."""
    return await health.report()


@router.get("/desk")
def show_desk(desk: Desk, health: Annotated[HealthReport, Depends(examined)]) -> Response:
    """Show the state of the server, and the uploads of the last day."""
    server = desk.server
    with desk.reading() as reading:
        session = reading.session
        return page(
            reading,
            "desk/overview.html",
            health=health,
            boards=server.boards.values(),
            attempts=list_attempts(session, Page(A_FEW)).rows,
            counts=counts_of_splits(session),
            totals=totals(session, reading.now),
            recently=RECENTLY.days,
            day=last_day(session, reading.now),
            missed=server.get(Snapshots).missed(session, reading.now),
            schedules=server.get(Schedules).in_effect(session),
            disk=shutil.disk_usage(server.settings.folder),
        )


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that follows corrected ground truth."""

    def follow_rules() -> None:  # uploads and leaderboards do not wait for this
        with server.database.reading() as session:
            server.rules.follow(session)

    yield Job("ground-truth", follow_rules, SECOND)


ROOM = Room(
    pages=[router],
    jobs=jobs,
    desk=[Tab("Today", 1, "Overview", "/desk")],
)
