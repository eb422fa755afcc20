"""The server's metrics, for Prometheus.

None reveals a team, a person or a score: labels are routes, statuses, splits and codes.
"""

from collections.abc import Callable, Collection

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from starlette.types import Scope

from reverie_eval.server.http.exchange import OK, Exchange
from reverie_eval.server.http.labels import method_of, route_of

MEDIA_TYPE = CONTENT_TYPE_LATEST

_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)


class Metrics:
    """The counts of one application."""

    def __init__(self, splits: Collection[str], waiting: Callable[[], float]) -> None:
        self._splits = frozenset(splits)
        self._registry = registry = CollectorRegistry()
        self.in_flight = Gauge(
            "reverie_eval_requests_in_flight", "Requests being answered.", registry=registry
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
        queue = Gauge(
            "reverie_eval_uploads_waiting",
            "Uploads waiting to be read.",
            registry=registry,
        )
        queue.set_function(waiting)

    def count(self, exchange: Exchange, scope: Scope) -> None:
        """Count a request that has been answered."""
        method, route = method_of(scope), route_of(scope)
        self._requests.labels(method, route, exchange.status or "none").inc()
        self._seconds.labels(method, route).observe(exchange.seconds)
        if exchange.uploaded_to is not None:
            split = exchange.uploaded_to if exchange.uploaded_to in self._splits else "unknown"
            self._uploads.labels(split, _outcome_of(exchange)).inc()

    def text(self) -> bytes:
        """Return the metrics in Prometheus's text format."""
        return generate_latest(self._registry)


def _outcome_of(exchange: Exchange) -> str:
    if exchange.outcome != OK:
        return exchange.outcome
    return "repeated" if exchange.is_repeat else "scored"
