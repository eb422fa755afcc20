"""The outermost layer of every request: its id, its line in the log, the metrics.

No metric reveals a team, a person or a score: labels are routes, statuses, splits and codes.

Exceptions end here as problem documents; none reaches uvicorn. The reply to an error is rendered in
a thread of its own, so refusing one request never delays another.
"""

import logging
from collections.abc import Collection, Iterable

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import Request
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from reverie_eval.server.errors import NotSignedInError, TooManyError
from reverie_eval.server.http.callers import OK, Exchange, address_of, begin, token_of
from reverie_eval.server.http.middleware import Middleware
from reverie_eval.server.http.problems import log_fault, reply_to
from reverie_eval.server.identity import HINT_LENGTH, PREFIX
from reverie_eval.server.jobs import Jobs

MEDIA_TYPE = CONTENT_TYPE_LATEST
"""The media type of the metrics."""
REQUEST_ID = "X-Request-ID"
HUNG_UP = "hung-up"
"""The outcome of a request whose client disconnected before the reply."""

_LOGGER = logging.getLogger("reverie_eval.server.requests")
_TRACED = frozenset({NotSignedInError.status, TooManyError.status})
"""Statuses of guessed tokens and floods of requests; the log has the address of these."""
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
_UNMATCHED = "unmatched"
"""The route of a request that matches none."""
_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)


class Metrics:
    """The counts of one application."""

    def __init__(self, splits: Collection[str], jobs: Jobs) -> None:
        self.splits = frozenset(splits)
        self._registry = registry = CollectorRegistry()
        self.in_flight = Gauge(
            "reverie_eval_requests_in_flight",
            "Requests being answered.",
            registry=registry,
        )
        self._requests = Counter(
            "reverie_eval_requests",
            "Requests answered.",
            ("method", "route", "status"),
            registry=registry,
        )
        self._seconds = Histogram(
            "reverie_eval_request_seconds",
            "Time from a request's headers to the last byte of the reply.",
            ("method", "route"),
            buckets=_SECONDS,
            registry=registry,
        )
        self._uploads = Counter(
            "reverie_eval_uploads",
            "Uploads to be scored, by outcome.",
            ("split", "outcome"),
            registry=registry,
        )
        self.uploads_waiting = Gauge(
            "reverie_eval_uploads_waiting",
            "Uploads waiting to be read.",
            registry=registry,
        )
        self.scoring_waiting = Gauge(
            "reverie_eval_scoring_waiting",
            "Requests waiting for a process that scores.",
            registry=registry,
        )
        registry.register(_JobMetrics(jobs))

    def count(self, exchange: Exchange, scope: Scope) -> None:
        """Count a request that has been answered."""
        method, route = _method_of(scope), _route_of(scope)
        self._requests.labels(method, route, exchange.status or "none").inc()
        self._seconds.labels(method, route).observe(exchange.seconds)
        if exchange.uploaded_to is not None:
            split = exchange.uploaded_to if exchange.uploaded_to in self.splits else "unknown"
            scored = "repeated" if exchange.is_repeat else "scored"
            outcome = scored if exchange.outcome == OK else exchange.outcome
            self._uploads.labels(split, outcome).inc()

    def text(self) -> bytes:
        """Return the metrics in Prometheus's text format."""
        return generate_latest(self._registry)


class _JobMetrics(Collector):
    """What is known of the jobs of a server, whenever metrics are read."""

    def __init__(self, jobs: Jobs) -> None:
        self._jobs = jobs

    def describe(self) -> Iterable[Metric]:
        """Return nothing, so that registering it does not read the database."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Return the metrics of all jobs."""
        runs = CounterMetricFamily(
            "reverie_eval_job_runs", "Runs of a job that have ended.", labels=["name"]
        )
        failures = CounterMetricFamily(
            "reverie_eval_job_failures", "Runs of a job that have failed.", labels=["name"]
        )
        is_failing = GaugeMetricFamily(
            "reverie_eval_job_failing",
            "1 if the last run of a job failed or the current one is overdue, else 0.",
            labels=["name"],
        )
        last_success = GaugeMetricFamily(
            "reverie_eval_job_last_success_timestamp_seconds",
            "When a job last succeeded.",
            labels=["name"],
        )
        backlog = GaugeMetricFamily(
            "reverie_eval_job_backlog",
            "What a job has still to do, by kind; given_up: what it does not try any more.",
            labels=["name", "kind"],
        )
        for job in self._jobs.reports():
            runs.add_metric([job.name], job.runs)
            failures.add_metric([job.name], job.failures)
            is_failing.add_metric([job.name], bool(job.error) or job.is_overdue)
            if job.last_success_at is not None:
                last_success.add_metric([job.name], job.last_success_at.timestamp())
            for kind, number in job.backlog.items():
                backlog.add_metric([job.name, kind], number)
        return runs, failures, is_failing, last_success, backlog


class RequestTelemetry(Middleware):
    """Logs and counts every request."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        super().__init__(app)
        self._metrics = metrics
        # A thread of its own: a flood of refused requests cannot occupy the threads that answer
        # requests, and refusals need not wait while all of those wait for the database.
        self._thread = CapacityLimiter(1)

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, log it and count it."""
        exchange = begin(scope)

        async def recording(message: Message) -> None:
            if message["type"] == "http.response.start":
                exchange.status = message["status"]
                MutableHeaders(scope=message)[REQUEST_ID] = exchange.id
            exchange.sent += len(message.get("body", b""))
            await send(message)

        with self._metrics.in_flight.track_inprogress():
            try:
                await self._answer(exchange, scope, receive, recording)
            finally:
                self._metrics.count(exchange, scope)
                line = _line(exchange, scope, self._metrics.splits)
                _LOGGER.info("request", extra={"fields": line})

    async def _answer(self, exchange: Exchange, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await self.app(scope, receive, send)
        except ClientDisconnect:
            exchange.outcome = HUNG_UP
        except Exception as error:  # noqa: BLE001  # the last chance to turn it into a reply
            if exchange.status is None:
                reply = await run_sync(reply_to, Request(scope), error, limiter=self._thread)
                await reply(scope, receive, send)
            else:
                await run_sync(log_fault, Request(scope), error, limiter=self._thread)


def _line(exchange: Exchange, scope: Scope, splits: Collection[str]) -> dict[str, object]:
    line: dict[str, object] = {
        "id": exchange.id,
        "method": _method_of(scope),
        "route": _route_of(scope),
        "status": exchange.status,
        "milliseconds": round(1000 * exchange.seconds, 1),
        "received": exchange.received,
        "sent": exchange.sent,
        "outcome": exchange.outcome,
        "caller": _caller_of(scope),
    }
    split = exchange.split or scope.get("path_params", {}).get("split")
    if split in splits:  # else it is text that the sender made up
        line["split"] = split
    if exchange.team is not None:
        line["team"] = exchange.team
    if exchange.submission:
        line["submission"] = exchange.submission
    if exchange.status in _TRACED:
        line["address"] = address_of(scope)
    elif hint := _hint_of(scope):
        line["token"] = hint
    return line


def _route_of(scope: Scope) -> str:
    """Return the template of the route that a request matched: ``/api/v1/splits/{split}``.

    Of a mounted application, such as the static files, this is the path that it is mounted at.
    FastAPI leaves out the prefix with which a router was included, but not the router's own: so
    ours are included without one.
    """
    template: str | None = getattr(scope.get("route"), "path", None)
    if template is not None:
        return template
    if "app_root_path" in scope:  # only mounting sets it
        mounted_at: str = scope["root_path"]
        return mounted_at.removeprefix(scope["app_root_path"])
    return _UNMATCHED


def _method_of(scope: Scope) -> str:
    """Return the method, or ``other`` if it is not a standard one."""
    method: str = scope["method"]
    return method if method in _METHODS else "other"


def _caller_of(scope: Scope) -> str:
    """Return by what the sender is known, and whether as an organiser: ``organiser, session``."""
    browser, person = scope.get("state", {}).get("sender", (None, None))
    if person is None:
        return "anonymous"
    return f"{person.role}, {'token' if browser is None else 'session'}"


def _hint_of(scope: Scope) -> str:
    """Return the first characters of a token, which identify it to the organiser; never more."""
    token = token_of(scope)
    return token[:HINT_LENGTH] if token.startswith(PREFIX) else ""
