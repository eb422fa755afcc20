"""Rate limits: requests per minute of an address, a token and a browser session."""

import hashlib
import ipaddress
import math
import time

from limits import RateLimitItemPerMinute
from limits.storage import MemoryStorage
from limits.strategies import FixedWindowRateLimiter
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from reverie_eval.server.errors import TooManyError
from reverie_eval.server.http.labels import address_of, session_of, token_of

FAILED_COST = 10
"""How many requests a wrong token or invitation counts for. Expired sessions cost no more than
others: browsers send them without being asked, and they cannot be guessed, because they are
signed."""
EXEMPT = ("/healthz", "/static/")
"""Monitoring must never be refused, and its result is cached for some seconds; static files are
cached by browsers."""

_NOT_SIGNED_IN = 401
_IPV6_SITE = 64
"""Prefix length of the network that a provider assigns to one customer."""


class RateLimits:
    """Refuses requests over the limit."""

    def __init__(self, app: ASGIApp, per_minute: int) -> None:
        self._app = app
        self._limit = RateLimitItemPerMinute(per_minute)
        self._counts = FixedWindowRateLimiter(MemoryStorage())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that is within the limits.

        Raises
        ------
        TooManyError
            If it exceeds one.
        """
        if scope["type"] != "http" or scope["path"].startswith(EXEMPT):
            await self._app(scope, receive, send)
            return
        address, token = site_of(address_of(scope)), token_of(scope)
        self._take("address", address)
        for kind, shown in (("token", token), ("session", session_of(scope))):
            if shown:
                self._take(kind, hashlib.sha256(shown.encode()).hexdigest())
        attempts = bool(token) or scope["method"] == "POST"

        async def watching(message: Message) -> None:
            if message.get("status") == _NOT_SIGNED_IN and attempts:
                self._counts.hit(self._limit, "address", address, cost=FAILED_COST - 1)
            await send(message)

        await self._app(scope, receive, watching)

    def _take(self, kind: str, whose: str) -> None:
        if not self._counts.hit(self._limit, kind, whose):
            until = self._counts.get_window_stats(self._limit, kind, whose).reset_time
            raise TooManyError(max(1, math.ceil(until - time.time())))


def site_of(address: str) -> str:
    """Return what is counted for an address: of IPv6 the network, as one customer has 2^64."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if parsed.version == 4:
        return address
    return str(ipaddress.ip_network((parsed, _IPV6_SITE), strict=False))
