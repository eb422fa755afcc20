"""``/desk``: the overview, the list of uploads, and the audit log."""

import shutil
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from fastapi.responses import Response

from reverie_eval.schemas.service import HealthReport
from reverie_eval.server.http.callers import Desk
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.service.attempts import (
    DAYS_KEPT,
    FAILURES,
    RECENTLY,
    counts_of_splits,
    last_day,
    list_attempts,
    totals,
)
from reverie_eval.server.service.audit import list_entries, names_in
from reverie_eval.server.service.paging import Page

router = APIRouter()

A_FEW, ON_A_PAGE = 8, 50
ALL_OUTCOMES = ("scored", "repeat", *(kind.code for kind in FAILURES))
Cursor = Annotated[str | None, Query(max_length=200)]
LONGEST_SOUGHT = 200
Sought = Annotated[str, Query(max_length=LONGEST_SOUGHT)]


async def examined(runtime: Runtime) -> HealthReport:
    """Return the report of ``/healthz``."""
    return await runtime.health.report()


@router.get("/desk")
def show_desk(desk: Desk, health: Annotated[HealthReport, Depends(examined)]) -> Response:
    """Show the state of the server, and the uploads of the last day."""
    server = desk.server
    with desk.snapshot() as snapshot:
        session = snapshot.session
        return page(
            snapshot,
            "desk/overview.html",
            health=health,
            boards=server.boards.values(),
            attempts=list_attempts(session, Page(A_FEW)).rows,
            counts=counts_of_splits(session),
            totals=totals(session, snapshot.now),
            recently=RECENTLY.days,
            day=last_day(session, snapshot.now),
            missed=server.snapshots.missed(session, snapshot.now),
            schedules=server.schedules.in_effect(session),
            disk=shutil.disk_usage(server.settings.folder),
        )


@router.get("/desk/uploads")
def show_uploads(desk: Desk, cursor: Cursor = None, outcome: Sought = "") -> Response:
    """List uploads, the latest first."""
    chosen = outcome if outcome in ALL_OUTCOMES else ""
    with desk.snapshot() as snapshot:
        return page(
            snapshot,
            "desk/uploads.html",
            attempts=list_attempts(snapshot.session, Page(ON_A_PAGE, cursor), chosen),
            is_first=cursor is None,
            outcome=chosen,
            outcomes=ALL_OUTCOMES,
            days=DAYS_KEPT,
        )


@router.get("/desk/audit")
def show_audit(
    desk: Desk, cursor: Cursor = None, actor: Sought = "", subject: Sought = "", whole: Sought = ""
) -> Response:
    """Show the audit log, the latest entry first, and whether it is unchanged.

    The entries on the page are always checked; the whole chain, which may be long, on request.
    """
    actor, subject, audit_log = _findable(actor), _findable(subject), desk.server.audit_log
    with desk.snapshot() as snapshot:
        session, wanted = snapshot.session, Page(ON_A_PAGE, cursor)
        listed = list_entries(session, wanted, actor=actor, subject=subject, newest_first=True)
        altered = (
            audit_log.broken_links(session) if whole else audit_log.altered(session, listed.rows)
        )
        return page(
            snapshot,
            "desk/audit.html",
            entries=listed,
            names=names_in(session, listed.rows),
            is_first=cursor is None,
            actor=actor,
            subject=subject,
            broken=list(altered),
            is_whole=bool(whole),
            unprovable=sum(audit_log.unprovable(session).values()),
            longest_sought=LONGEST_SOUGHT,
        )


def _findable(text: str) -> str:
    """Remove zero bytes, which PostgreSQL does not allow in texts."""
    return text.replace("\0", "").strip()
