"""``/healthz``, ``/readyz`` and ``/metrics``, for monitoring."""

import ipaddress
from dataclasses import replace

from fastapi import APIRouter, Request, Response, status

from reverie_eval.schemas.service import HealthReport
from reverie_eval.server.http.callers import Anybody, Server
from reverie_eval.server.http.exchange import address_of
from reverie_eval.server.http.openapi import TEXT, file_reply
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.http.telemetry import MEDIA_TYPE
from reverie_eval.server.operations.health import Examined

router = APIRouter(tags=["operations"])

_METRICS = "# TYPE reverie_eval_requests_total counter\n..."


@router.get("/healthz", responses={503: {"model": HealthReport}})
async def show_health(health: Examined, response: Response) -> HealthReport:
    """Check whether the server can score and store submissions, and does its jobs; for monitors."""
    return _with_status(await health.report(), response)


@router.get("/readyz", responses={503: {"model": HealthReport}})
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


@router.get(
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
