"""The outermost layer of every request: its id, its line in the log, the metrics.

Exceptions end here as problem documents; none reaches uvicorn. The reply to an error is rendered in
a thread of its own, so refusing one request never delays another.
"""

import logging

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import Request
from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from reverie_eval.server.http.exchange import Exchange, begin
from reverie_eval.server.http.labels import address_of, hint_of, method_of, route_of
from reverie_eval.server.http.metrics import Metrics
from reverie_eval.server.http.problems import log_fault, reply_to

REQUEST_ID = "X-Request-ID"
HUNG_UP = "hung-up"
"""The outcome of a request whose client disconnected before the reply."""

_LOGGER = logging.getLogger("reverie_eval.server.requests")
_TRACED = frozenset({401, 429})
"""Statuses of guessed tokens and floods of requests; the log has the address of these."""


class Following:
    """Logs and counts every request."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics
        # A thread of its own: a flood of refused requests cannot occupy the threads that answer
        # requests, and refusals need not wait while all of those wait for the database.
        self._thread = CapacityLimiter(1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, log it and count it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        exchange = begin(scope)

        async def noting(message: Message) -> None:
            if message["type"] == "http.response.start":
                exchange.status = message["status"]
                MutableHeaders(scope=message)[REQUEST_ID] = exchange.id
            exchange.sent += len(message.get("body", b""))
            await send(message)

        with self._metrics.in_flight.track_inprogress():
            try:
                await self._answer(exchange, scope, receive, noting)
            finally:
                self._metrics.count(exchange, scope)
                _LOGGER.info("request", extra={"fields": _line(exchange, scope)})

    async def _answer(self, exchange: Exchange, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await self._app(scope, receive, send)
        except ClientDisconnect:
            exchange.outcome = HUNG_UP
        except Exception as error:  # noqa: BLE001  # the last chance to turn it into a reply
            if exchange.status is None:
                reply = await run_sync(reply_to, Request(scope), error, limiter=self._thread)
                await reply(scope, receive, send)
            else:
                await run_sync(log_fault, Request(scope), error, limiter=self._thread)


def _line(exchange: Exchange, scope: Scope) -> dict[str, object]:
    line: dict[str, object] = {
        "id": exchange.id,
        "method": method_of(scope),
        "route": route_of(scope),
        "status": exchange.status,
        "milliseconds": round(1000 * exchange.seconds, 1),
        "received": exchange.received,
        "sent": exchange.sent,
        "outcome": exchange.outcome,
    }
    if exchange.status in _TRACED:
        line["address"] = address_of(scope)
    elif hint := hint_of(scope):
        line["token"] = hint
    return line
