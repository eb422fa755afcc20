"""What every request passes before it is routed: path, limits of rate, size and time, headers.

Bytes are counted as they arrive, whatever the headers say. A route that accepts more than a few
lines of JSON raises the limit once it knows who is sending: :func:`allow_body`.

Strict-Transport-Security is left to the proxy that terminates TLS: only it knows whether the host
is served over TLS alone.
"""

import asyncio
import hashlib
import ipaddress
import math
import re
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from limits import RateLimitItem, RateLimitItemPerMinute
from limits.storage import Storage
from limits.strategies import FixedWindowRateLimiter
from python_multipart.multipart import parse_options_header
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from reverie_eval.server import errors
from reverie_eval.server.http.callers import COOKIE, address_of, exchange_of, session_of, token_of
from reverie_eval.server.scoring.contexts import SECONDS_TO_RETRY

SMALL = 256 << 10
"""Bytes; several times the longest JSON, other than a submission, that any route accepts."""

_SMALL_FORM = 64 << 10
"""Bytes of a form without a file, which the framework parses on the event loop."""

SECONDS_OF_GRACE = 10
"""Time before a body has to reach the lowest speed: connections begin slowly."""

_KEY = "reverie_eval.allowance"
_MULTIPART = b"multipart/form-data"
_FORMS = frozenset({_MULTIPART, b"application/x-www-form-urlencoded"})
_NAMES_OF_UTF_8 = frozenset({b"utf-8", b"utf8", b"us-ascii"})
"""ASCII is a subset of UTF-8."""

MOST_AT_ONCE = 64
"""Requests with a token, or of a browser session, that are answered at the same time."""
FAILED_COST = 10
"""One in this many requests may have a wrong token or invitation. Expired sessions are not counted:
browsers send them by themselves, and they cannot be guessed, because they are signed."""
EXEMPT = ("/healthz", "/readyz", "/static/")
"""Monitoring must never be refused, and its result is cached for some seconds; static files are
cached by browsers."""

_IPV6_SITE = 64
"""Prefix length of the network that a provider assigns to one customer."""
_OWN_COOKIE = re.compile(rb"%b=[\w.=-]*" % COOKIE.encode())

ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'none'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-store",
}
"""Default headers; a route may set its own."""


class Middleware(ABC):
    """Answers HTTP requests; everything else that reaches the application passes unchanged."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request; pass other messages on."""
        answer = self.answer if scope["type"] == "http" else self.app
        await answer(scope, receive, send)

    @abstractmethod
    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, with the help of the application inside."""


class SecurityHeaders(Middleware):
    """Adds security headers to every reply."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with the headers added."""

        async def adding(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in ALWAYS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self.app(scope, receive, adding)


class HeadRequests(Middleware):
    """Answers HEAD like GET, without the body: many monitors send HEAD."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request; the log and the metrics, which are further out, still see HEAD."""
        if scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return

        async def without_body(message: Message) -> None:
            scope["method"] = "HEAD"  # what sends it counts the bytes of any other reply
            is_body = message["type"] == "http.response.body"
            await send({**message, "body": b""} if is_body else message)

        scope["method"] = "GET"
        try:
            await self.app(scope, receive, without_body)
        finally:
            scope["method"] = "HEAD"


class RateLimits(Middleware):
    """Refuses requests over the limit, and further ones of senders with many unanswered ones.

    The latter need no database: a crowd of slow connections with one token costs nothing else.

    Wrong tokens count only against those who guess: against that token, and against further wrong
    ones from the same address. Valid tokens from the address, and its requests without a token, are
    counted as usual.
    """

    def __init__(self, app: ASGIApp, per_minute: int, counts: Storage) -> None:
        super().__init__(app)
        self._limit = RateLimitItemPerMinute(per_minute)
        self._failed_limit = RateLimitItemPerMinute(max(1, per_minute // FAILED_COST))
        self._counts = FixedWindowRateLimiter(counts)
        self._answering: Counter[str] = Counter()
        """Requests being answered, by token or session."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that is within the limits.

        Raises
        ------
        TooManyError
            If it exceeds a limit.
        BusyError
            If too many of the sender's requests are being answered.
        """
        if scope["path"].startswith(EXEMPT):
            await self.app(scope, receive, send)
            return
        address, token = site_of(address_of(scope)), _digest(token_of(scope))
        if token and not self._counts.test(self._failed_limit, "wrong token", token):
            raise self._error(self._failed_limit, "wrong token", token)
        whose = {"token": token, "session": _digest(session_of(scope)), "address": address}
        for kind, shown in whose.items():
            if shown and not self._counts.hit(self._limit, kind, shown):
                raise self._error(self._limit, kind, shown)
        with self._at_once(token or whose["session"]):
            await self._watch(scope, receive, send, address, token)

    @contextmanager
    def _at_once(self, sender: str) -> Iterator[None]:
        """Count a request as being answered; those without token and session are not counted."""
        if sender and self._answering[sender] >= MOST_AT_ONCE:
            why = f"the server is answering {MOST_AT_ONCE} other requests of yours"
            raise errors.BusyError(SECONDS_TO_RETRY, why)
        self._answering[sender] += 1
        try:
            yield
        finally:
            self._answering[sender] -= 1
            if not self._answering[sender]:
                del self._answering[sender]

    async def _watch(
        self, scope: Scope, receive: Receive, send: Send, address: str, token: str
    ) -> None:
        """Answer a request, and count it again if its token is wrong."""
        attempts = bool(token) or scope["method"] == "POST"
        is_throttled = False

        async def watching(message: Message) -> None:
            nonlocal is_throttled
            if message.get("status") == errors.NotSignedInError.status and attempts:
                self._counts.hit(self._failed_limit, "wrong token", token)
                is_throttled = not self._counts.hit(self._failed_limit, "failed", address)
            if not is_throttled:
                await send(message)

        await self.app(scope, receive, watching)
        if is_throttled:
            raise self._error(self._failed_limit, "failed", address)

    def _error(self, limit: RateLimitItem, kind: str, whose: str) -> errors.TooManyError:
        until = self._counts.get_window_stats(limit, kind, whose).reset_time
        return errors.TooManyError(max(1, math.ceil(until - time.time())))


def _digest(shown: str) -> str:
    """Return the key for counting requests with a token or session; empty without one."""
    return hashlib.sha256(shown.encode()).hexdigest() if shown else ""


class OwnCookies(Middleware):
    """Passes on the server's own cookies only, and only if they are not quoted, as they never are.

    Python 3.11 needs a time that grows with the square of its length to read a quoted value:
    seconds on the event loop for the 64 KiB that a request's headers may have (CVE-2024-7592,
    https://nvd.nist.gov/vuln/detail/CVE-2024-7592).
    """

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        scope["headers"] = [
            (name, _own_cookies(value) if name == b"cookie" else value)
            for name, value in scope["headers"]
        ]
        await self.app(scope, receive, send)


def _own_cookies(header: bytes) -> bytes:
    cookies = (cookie.strip() for cookie in header.split(b";"))
    return b"; ".join(cookie for cookie in cookies if _OWN_COOKIE.fullmatch(cookie))


class PathPrefix(Middleware):
    """Serves the application below a path of its host; the application itself does not know it.

    A request may come with the prefix or, from a monitor on the same machine, without. The
    ``root_path`` of ASGI is no substitute: Starlette matches routes by it, but leaves the prefix in
    ``request.url.path`` and does not put it into redirects.
    """

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        super().__init__(app)
        self._prefix = prefix

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request without the prefix, and put it back into redirects."""

        async def prefixing(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                if headers.get("location", "").startswith("/"):
                    headers["location"] = self._prefix + headers["location"]
            await send(message)

        path: str = scope["path"]
        if f"{path}/".startswith(f"{self._prefix}/"):
            scope = {**scope, "path": path.removeprefix(self._prefix) or "/"}
        await self.app(scope, receive, prefixing)


def site_of(address: str) -> str:
    """Return the key to count an address by; for IPv6 the network, because a customer has 2^64."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if parsed.version == 4:
        return address
    return str(ipaddress.ip_network((parsed, _IPV6_SITE), strict=False))


@dataclass(slots=True)
class Allowance:
    """The limits of a request's body."""

    size: int
    """Bytes."""
    seconds: float
    kibibytes_per_second: float
    """The lowest average speed at which it may be sent, after the first seconds."""
    began: float = field(default_factory=time.monotonic)
    """When the server began to wait for it, on the monotonic clock."""

    @property
    def until(self) -> float:
        """The deadline of the whole body."""
        return self.began + self.seconds

    def next_until(self, received: int) -> float:
        """Return the deadline of the next bytes."""
        needed = received / (self.kibibytes_per_second * 1024)
        return min(self.until, self.began + SECONDS_OF_GRACE + needed)


class BodyLimits(Middleware):
    """Enforces the size, the deadline and the speed of each request's body.

    Forms must be UTF-8, as browsers always send them: the framework decodes fields on the event
    loop with whatever codec the content type names. Some of Python's codecs take a second for the
    largest form, and some do not decode text at all.
    """

    def __init__(self, app: ASGIApp, seconds: float, kibibytes_per_second: float) -> None:
        super().__init__(app)
        self._seconds = seconds
        self._kibibytes_per_second = kibibytes_per_second

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request while counting its body.

        Raises
        ------
        MalformedError
            If it is a form whose content type names a charset other than UTF-8.
        TooLargeError, TooSlowError
            From ``receive``, as soon as a limit is exceeded.
        """
        exchange = exchange_of(scope)
        media_type, options = _content_type(Headers(scope=scope))
        is_form = media_type in _FORMS
        if is_form and options.get(b"charset", b"utf-8").lower() not in _NAMES_OF_UTF_8:
            raise errors.MalformedError(
                "the form's content type names a charset other than UTF-8; send the fields as "
                "UTF-8 and leave `charset` out"
            )
        size = _SMALL_FORM if is_form else SMALL
        allowance = Allowance(size, self._seconds, self._kibibytes_per_second)
        scope[_KEY] = allowance
        is_whole = False

        async def counting() -> Message:
            nonlocal is_whole
            if is_whole or exchange.status is not None:  # the body is no longer read
                return await receive()
            message = await _in_time(receive, allowance, exchange.received)
            exchange.received += len(message.get("body", b""))
            if exchange.received > allowance.size:
                raise errors.TooLargeError(allowance.size)
            is_whole = not message.get("more_body", False)
            return message

        await self.app(scope, counting, send)


def allow_body(scope: Scope, size: int) -> None:
    """Set a request's size limit and restart its deadlines."""
    allowance: Allowance = scope[_KEY]
    allowance.size = size
    allowance.began = time.monotonic()


def is_multipart(headers: Headers) -> bool:
    """Whether a request is a form that can contain files."""
    return _content_type(headers)[0] == _MULTIPART


async def _in_time(receive: Receive, allowance: Allowance, received: int) -> Message:
    until = allowance.next_until(received)
    try:
        async with asyncio.timeout(until - time.monotonic()):
            return await receive()
    except TimeoutError:
        is_slow = until < allowance.until
        raise errors.TooSlowError(
            _too_slow(allowance, received) if is_slow else _too_late(allowance)
        ) from None


def _too_late(allowance: Allowance) -> str:
    return (
        f"the upload did not arrive within {allowance.seconds:g} seconds; gzip it, or try again. "
        "No submission was used"
    )


def _too_slow(allowance: Allowance, received: int) -> str:
    seconds = time.monotonic() - allowance.began
    return (
        f"the upload is sent too slowly: {received:,} bytes in {seconds:.0f} seconds, but at least "
        f"{allowance.kibibytes_per_second:g} KiB a second are required; gzip it, or use a faster "
        "connection. No submission was used"
    )


def _content_type(headers: Headers) -> tuple[bytes, dict[bytes, bytes]]:
    """Return media type and parameters, parsed as the framework does: parsers differ."""
    return parse_options_header(headers.get("content-type"))
