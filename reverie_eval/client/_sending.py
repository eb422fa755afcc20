"""Sending a request until there is a reply: the very same bytes, again and again if need be."""

import ssl
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from ipaddress import ip_address
from socket import gaierror
from time import monotonic, sleep

import httpx
from pydantic import ValidationError

from reverie_eval.client._errors import (
    NotAServerError,
    QuotaSpentError,
    RefusedError,
    ServiceError,
    UnreachableError,
)
from reverie_eval.errors import Problem, ReverieEvalError, SubmissionError
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.text import printable
from reverie_eval.version import __version__

Progress = Callable[[int, int], None]
"""Told how many bytes of how many have been sent."""
Notice = Callable[[str], None]
"""Told, in a line, why something takes longer."""

PAUSES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Seconds before each further attempt, unless the server says how long."""
LONGEST_PAUSE = 60
"""Seconds; a server that wants more is not waited for."""

PATIENCE = 180
"""Seconds after which nothing is tried again."""

_TIMEOUT = httpx.Timeout(30, connect=10, read=90)
_PIECE = 64 << 10
_UNAVAILABLE = (502, 503, 504)
_NOT_REACHED = (httpx.ConnectError, httpx.ConnectTimeout, httpx.ProxyError)


@dataclass(frozen=True)
class Call:
    """A request, as often as it is sent."""

    method: str
    path: str
    """Below the API's."""
    query: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)
    progress: Progress | None = None
    is_repeatable: bool = True
    """Whether sending it twice comes to the same as sending it once."""

    def pieces(self) -> Iterator[bytes]:
        """Return the body piece by piece, telling how much of it is on its way."""
        for begin in range(0, len(self.body), _PIECE):
            end = min(begin + _PIECE, len(self.body))
            yield self.body[begin:end]
            if self.progress:
                self.progress(end, len(self.body))


class _InterruptionError(Exception):
    """What another attempt may get over; ``error`` is what it is called if none does."""

    def __init__(self, error: Exception, wait: float | None = None) -> None:
        self.error = error
        self.wait = wait
        """Seconds, if the server said how many."""
        super().__init__(error)


class Sender:
    """Sends calls to one server."""

    def __init__(self, server: str, token: str | None, notice: Notice | None) -> None:
        self.server = server
        self._notice = notice
        self._was_reached = False
        headers = {"User-Agent": f"reverie-eval/{__version__}"}
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        # No proxy leads to this machine, whatever the environment says.
        elsewhere = not is_here(httpx.URL(server).host)
        try:
            self._http = httpx.Client(headers=headers, timeout=_TIMEOUT, trust_env=elsewhere)
        except (ImportError, OSError, ValueError) as error:
            raise ServiceError(
                f"the environment names a proxy or certificates that cannot be used ({error}); "
                "look at HTTPS_PROXY, HTTP_PROXY, ALL_PROXY, SSL_CERT_FILE and SSL_CERT_DIR"
            ) from None

    def close(self) -> None:
        """Let go of the connection."""
        self._http.close()

    def send(self, call: Call) -> httpx.Response:
        """Return the reply, which is a success.

        Dropped connections, gateways without a server behind them and too many requests are
        waited out. A server that was never reached is not waited for: its URL may be wrong.

        Raises
        ------
        UnreachableError
            If nothing answers.
        NotAServerError, RefusedError, SubmissionError
            If the reply is no success.
        """
        pauses = iter(PAUSES if call.is_repeatable else ())
        began = monotonic()
        while True:
            try:
                return self._reply(call)
            except _InterruptionError as interruption:
                pause = next(pauses, None)
                if pause is None or monotonic() - began > PATIENCE:
                    raise interruption.error from interruption
                self._wait(interruption, pause)

    def _wait(self, interruption: _InterruptionError, pause: float) -> None:
        seconds = pause if interruption.wait is None else interruption.wait
        if self._notice:
            self._notice(f"{interruption.error}; trying again in {seconds:g} s")
        sleep(seconds)

    def _reply(self, call: Call) -> httpx.Response:
        try:
            response = self._http.request(
                call.method,
                self.server + API + call.path,
                params=call.query,
                content=call.pieces() if call.body else None,
                headers={**call.headers, "Content-Length": str(len(call.body))},
            )
        except httpx.RequestError as error:
            unreachable = UnreachableError(f"{self.server}: {_in_words(error)}")
            if isinstance(error, _NOT_REACHED) and not self._was_reached:
                raise unreachable from error
            raise _InterruptionError(unreachable) from error
        self._was_reached = True
        if response.is_success:
            return response
        refusal = failure(response, self.server)
        if _will_pass(response):
            raise _InterruptionError(refusal, _retry_after(response))
        raise refusal


def _will_pass(response: httpx.Response) -> bool:
    """Whether the same request may succeed in a while that is worth waiting for."""
    if (_retry_after(response) or 0) > LONGEST_PAUSE:
        return False
    if response.status_code == httpx.codes.TOO_MANY_REQUESTS:
        problem = problem_of(response)  # a spent quota has the same status, and lasts
        return problem is not None and problem.code == "too-many-requests"
    return response.status_code in _UNAVAILABLE


def _retry_after(response: httpx.Response) -> float | None:
    seconds = response.headers.get("retry-after", "")
    return float(seconds) if seconds.isdecimal() else None


def _in_words(error: httpx.RequestError) -> str:
    match _root_of(error), error:
        case gaierror(), _:
            return "there is no host of that name"
        case ConnectionRefusedError(), _:
            return "nothing listens there (connection refused)"
        case ssl.SSLCertVerificationError(verify_message=why), _:
            return f"its TLS certificate is not trusted: {why}"
        case ssl.SSLError(reason=why), _:
            return f"it does not speak TLS as it should ({why}); is it an http:// address?"
        case _, httpx.TimeoutException():
            return "it does not answer in time"
        case _:
            return f"the connection was dropped ({printable(str(error)) or type(error).__name__})"


def _root_of(error: BaseException) -> BaseException:
    """Return what the system said; the HTTP library cuts causes off and leaves contexts."""
    inner = error.__cause__ or error.__context__
    return _root_of(inner) if inner else error


_FAULT = 500
_EVERYWHERE = ("/server", "/splits", "/me", "/key", "/tokens")
"""What every server of this version of the API has."""


def problem_of(response: httpx.Response) -> ProblemDocument | None:
    """Return what the server says is wrong, if it is one of ours that says so."""
    try:
        return ProblemDocument.model_validate_json(response.content, extra="ignore")
    except ValidationError:
        return None


def failure(response: httpx.Response, server: str) -> ReverieEvalError:
    """Return the error that a reply stands for that is no success."""
    status = f"{response.status_code} {response.reason_phrase}".rstrip()
    location = response.headers.get("location")
    if location is not None:
        elsewhere = printable(_server_in(str(response.url.join(location))))
        return NotAServerError(f"{server} leads to {elsewhere}; if that is right, give that URL")
    document = problem_of(response)
    if document is None and response.status_code >= _FAULT:
        return UnreachableError(f"{server} is not available, it answers {printable(status)}")
    if document is None:
        return NotAServerError(f"{server} is no evaluation server, it answers {printable(status)}")
    is_missing = response.status_code == HTTPStatus.NOT_FOUND
    if is_missing and response.url.path.endswith(tuple(API + path for path in _EVERYWHERE)):
        return another_version(server)
    return _said(document)


def another_version(server: str) -> NotAServerError:
    """Return the error for a server whose replies this version does not understand."""
    return NotAServerError(
        f"{server} does not speak as reverie-eval {__version__} does (API v1); install the version "
        "that its organiser names"
    )


def _said(document: ProblemDocument) -> ReverieEvalError:
    match document.code:
        case "submission-rejected":
            return SubmissionError(
                [
                    Problem(p.code, printable(p.where), printable(p.message))
                    for p in document.problems
                ]
            )
        case "quota-spent":
            return QuotaSpentError(document)
        case _:
            return RefusedError(document)


def _server_in(url: str) -> str:
    """Return the part of a URL that names the server."""
    return url.partition(API)[0].rstrip("/")


API = "/api/v1"


def server_url(text: str) -> str:
    """Return a server's URL in its one form, without the API's path.

    Raises
    ------
    ServiceError
        If it is none.

    Examples
    --------
    >>> server_url(" https://Reverie.example.org/api/v1/ ")
    'https://reverie.example.org'
    """
    try:
        url = httpx.URL(text.strip())
    except httpx.InvalidURL:
        url = httpx.URL()
    if url.scheme not in ("http", "https") or not url.host or url.userinfo:
        raise ServiceError(f"{text!r} is no URL of a server; write it as https://HOST")
    return str(url.copy_with(query=None, fragment=None)).rstrip("/").removesuffix(API)


def check_private(server: str) -> None:
    """Refuse a server that is reached without encryption, unless it is on this machine.

    Raises
    ------
    ServiceError
        Naming the remedies.
    """
    url = httpx.URL(server)
    if url.scheme == "http" and not is_here(url.host):
        raise ServiceError(
            f"{server} is not encrypted: others on the way could read your token and change what "
            "is said; use https://, or, in a network that you trust, allow it with --plain-http"
        )


def is_here(host: str) -> bool:
    """Whether a host is this machine.

    >>> is_here("localhost"), is_here("127.0.0.2"), is_here("::1"), is_here("192.168.1.7")
    (True, True, True, False)
    """
    try:
        address = ip_address(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
    return address.is_loopback or address.is_unspecified
