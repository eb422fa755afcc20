"""What watching over itself adds to the server.

``/desk`` shows its state, and the uploads of the last day; ``/healthz``, ``/readyz`` and
``/metrics`` are for monitoring.
"""

import ipaddress
import shutil
from collections.abc import Iterable
from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Depends, Request, status
from fastapi.responses import Response

from reverie_eval.schemas.service import HealthReport
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.http.callers import Anybody, Desk, Server
from reverie_eval.server.http.exchange import address_of
from reverie_eval.server.http.openapi import TEXT, file_reply
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.http.telemetry import MEDIA_TYPE
from reverie_eval.server.intake import attempts
from reverie_eval.server.jobs import SECOND, Job
from reverie_eval.server.operations.health import Examined
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.paging import Page

router = APIRouter()
monitoring = APIRouter(tags=["operations"])

A_FEW = 8
_METRICS = "# TYPE reverie_eval_requests_total counter\n..."


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
            attempts=attempts.list_attempts(session, Page(A_FEW)).rows,
            counts=attempts.counts_of_splits(session),
            totals=attempts.totals(session, reading.now),
            recently=attempts.RECENTLY.days,
            day=attempts.last_day(session, reading.now),
            missed=server.get(Snapshots).missed(session, reading.now),
            schedules=server.get(Schedules).in_effect(session),
            disk=shutil.disk_usage(server.settings.folder),
        )


@monitoring.get("/healthz", responses={503: {"model": HealthReport}})
async def show_health(health: Examined, response: Response) -> HealthReport:
    """Check whether the server can score and store submissions, and does its jobs; for monitors."""
    return _with_status(await health.report(), response)


@monitoring.get("/readyz", responses={503: {"model": HealthReport}})
async def show_readiness(health: Examined, response: Response) -> HealthReport:
    """Check whether the server can score and store submissions; for load balancers.

    A job that fails, such as mail, fails on all servers alike, and is no reason to send requests to
    none of them.
    """
    return _with_status((await health.report()).readiness(), response)


def _with_status(report: HealthReport, response: Response) -> HealthReport:
    if report.failed:
        response.status_code = status.HTTP_503_SERVICE_UNAVAILABLE
    return report


@monitoring.get(
    "/metrics",
    response_class=Response,
    responses=file_reply(
        "text/plain", "not-signed-in", "not-allowed", schema=TEXT, example=_METRICS
    ),
)
def show_metrics(request: Request, call: Anybody, server: Server, runtime: Runtime) -> Response:
    """Return metrics for Prometheus, to organisers and to addresses in the settings."""
    with call.reading() as reading:
        is_anonymous = reading.caller is None
    readers = server.settings.metrics_readers
    if not (is_anonymous and _is_named(address_of(request.scope), readers)):
        replace(call, required="organiser").person()
    return Response(runtime.metrics.text(), media_type=MEDIA_TYPE)


def _is_named(
    address: str, networks: tuple[ipaddress.IPv4Network | ipaddress.IPv6Network, ...]
) -> bool:
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return False
    return any(parsed in network for network in networks)


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
