"""``/desk``: what the organiser looks at, what uploads came to, and who did what."""

import shutil
from typing import Annotated

from fastapi import APIRouter, Depends, Query
from fastapi.responses import Response

from reverie_eval.schemas.service import HealthReport
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.pages.desk.forms import Here
from reverie_eval.server.service.attempts import FAILURES, latest_attempts
from reverie_eval.server.service.audit import altered, broken_links, latest_entries
from reverie_eval.server.service.overview import counts_of_splits, last_day, totals

router = APIRouter()

A_FEW, ON_A_PAGE = 8, 50
ALL_OUTCOMES = ("scored", "repeat", *(kind.code for kind in FAILURES))
_LARGEST = 2**31 - 1
Before = Annotated[int | None, Query(ge=1, le=_LARGEST)]
Sought = Annotated[str, Query(max_length=200)]


async def examined(runtime: Runtime) -> HealthReport:
    """Return what ``/healthz`` says."""
    return await runtime.health.report()


@router.get("/desk")
def show_desk(here: Here, health: Annotated[HealthReport, Depends(examined)]) -> Response:
    """Show whether all is well, and what the last day brought."""
    server, now = here.server, here.now()
    with server.database.reading() as session:
        attempts = latest_attempts(session, A_FEW)
        counts = counts_of_splits(session)
        kept = totals(session)
        day = last_day(session, now)
        standing = server.notices.standing(session)
    return here.draw(
        "desk/overview.html",
        health=health,
        boards=server.boards.values(),
        now=now,
        attempts=attempts,
        counts=counts,
        kept=kept,
        day=day,
        standing=standing,
        disk=shutil.disk_usage(server.settings.folder),
    )


@router.get("/desk/uploads")
def show_uploads(here: Here, before: Before = None, outcome: Sought = "") -> Response:
    """List uploads, the latest first."""
    chosen = outcome if outcome in ALL_OUTCOMES else ""
    with here.server.database.reading() as session:
        found = latest_attempts(session, ON_A_PAGE + 1, before, chosen)
    return here.draw(
        "desk/uploads.html",
        attempts=found[:ON_A_PAGE],
        next_before=found[ON_A_PAGE - 1].id if len(found) > ON_A_PAGE else None,
        is_first=before is None,
        outcome=chosen,
        outcomes=ALL_OUTCOMES,
    )


@router.get("/desk/audit")
def show_audit(
    here: Here, before: Before = None, actor: Sought = "", subject: Sought = "", whole: Sought = ""
) -> Response:
    """Show who did what, the latest first, and whether it is what was written.

    That of the entries on the page; of the whole chain, which may be long, if somebody asks.
    """
    actor, subject = _findable(actor), _findable(subject)
    with here.server.database.reading() as session:
        found = latest_entries(session, ON_A_PAGE + 1, before, actor=actor, subject=subject)
        broken = list(broken_links(session)) if whole else altered(found[:ON_A_PAGE])
    return here.draw(
        "desk/audit.html",
        entries=found[:ON_A_PAGE],
        next_before=found[ON_A_PAGE - 1].id if len(found) > ON_A_PAGE else None,
        is_first=before is None,
        actor=actor,
        subject=subject,
        broken=broken,
        is_whole=bool(whole),
    )


def _findable(text: str) -> str:
    """Return what a database can look for: PostgreSQL has no text with a zero byte."""
    return text.replace("\0", "").strip()
