"""Sending a request until a reply arrives: the address, the attempts, and the ways to fail.

Every attempt sends the same bytes.

ServiceError
    UnreachableError      no server replies, or the connection was dropped on every attempt
    NotAServerError       not an evaluation server, or one of an incompatible version
    RefusedError          the server refused the request and says why
        QuotaSpentError   no submissions are left; says when the quota resets

A submission that the server rejects is a SubmissionError, as it is without a server.
"""

import ssl
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from ipaddress import ip_address
from socket import gaierror
from time import sleep, time
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import httpx
from pydantic import ValidationError

from reverie_eval.errors import Problem, ReverieEvalError, SubmissionError
from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.text import earliest_time_text, printable
from reverie_eval.version import __version__

if TYPE_CHECKING:
    from tenacity import Retrying
    from tenacity.stop import stop_base


class ServiceError(ReverieEvalError):
    """The request to a server failed."""


class UnreachableError(ServiceError):
    """No server replies, or the connection was dropped on every attempt."""


class NotAServerError(ServiceError):
    """Not an evaluation server, or one of an incompatible version."""


class RefusedError(ServiceError):
    """The server refused the request; ``document`` is its reply."""

    def __init__(self, document: ProblemDocument, detail: str | None = None) -> None:
        self.document = document
        listed = [f"{problem.where}: {problem.message}" for problem in document.problems]
        request = [f"request {document.request_id}"] if document.request_id else []
        super().__init__(printable("; ".join([detail or document.detail, *listed, *request])))


class QuotaSpentError(RefusedError):
    """No submissions are left."""

    def __init__(self, document: ProblemDocument) -> None:
        instant = document.quota.next_at if document.quota else None
        when = f"next possible at {earliest_time_text(instant)}" if instant else "ask the organiser"
        super().__init__(document, f"no submissions left; {when}. Nothing was scored")


# Requests.


TransferProgress = Callable[[int, int], None]
"""Called with the number of bytes sent so far and in total."""
Notice = Callable[[str], None]
"""Called with a line of text that says why something takes longer."""

ATTEMPTS = 6
FIRST_PAUSE = 0.5
"""Seconds before the second attempt, doubled before each further one, unless the server says how
long to wait."""
LONGEST_RETRY_AFTER = 60
"""Seconds; a server that asks for a longer pause is not tried again."""
PATIENCE = 180
"""Seconds after which no further attempt is made."""

USER_AGENT: Mapping[str, str] = MappingProxyType({"User-Agent": f"reverie-eval/{__version__}"})
"""The header that says what sends a request."""

_TIMEOUT = httpx.Timeout(30, connect=10, read=90)
_CHUNK_SIZE = 64 << 10
_UNAVAILABLE = (502, 503, 504)
_NOT_CONNECTED = (httpx.ConnectError, httpx.ConnectTimeout, httpx.ProxyError)


@dataclass(frozen=True)
class Call:
    """A request that may be sent several times."""

    method: str
    route: str
    """Relative to the API's root."""
    query: Mapping[str, str] = field(default_factory=dict)
    body: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)
    progress: TransferProgress | None = None
    is_repeatable: bool = True
    """Whether sending it twice has the same effect as sending it once."""

    def chunks(self) -> Iterator[bytes]:
        """Yield the body in chunks and report progress after each."""
        for begin in range(0, len(self.body), _CHUNK_SIZE):
            end = min(begin + _CHUNK_SIZE, len(self.body))
            yield self.body[begin:end]
            if self.progress:
                self.progress(end, len(self.body))


class _TemporaryError(Exception):
    """A failure that another attempt may overcome."""

    def __init__(self, error: Exception, retry_after: float | None = None) -> None:
        self.error = error
        """What to raise if no attempt succeeds."""
        self.retry_after = retry_after
        """Seconds, if the server asks for a pause."""
        super().__init__(error)


class Sender:
    """Sends calls to one server."""

    def __init__(self, server: str, token: str | None, notice: Notice | None) -> None:
        self.server = server
        self._notice = notice
        self._has_replied = False
        headers = dict(USER_AGENT)
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        self._http = http_client(server, headers)

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def send(self, call: Call) -> httpx.Response:
        """Return the server's reply to a call that succeeded.

        The call is sent again after a dropped connection, when a gateway cannot reach the server
        and when there were too many requests. If the server never replied, a failure to connect is
        final: the URL may be wrong. A reply that is not a success is raised as :func:`failure`
        says.
        """
        from tenacity import stop_after_attempt, stop_after_delay

        most = ATTEMPTS if call.is_repeatable else 1
        stop = stop_after_attempt(most) | stop_after_delay(PATIENCE)
        attempts = retrying(_TemporaryError, stop, FIRST_PAUSE, self._announce)
        try:
            return attempts(self._reply, call)
        except _TemporaryError as temporary:
            raise temporary.error from temporary

    def _reply(self, call: Call) -> httpx.Response:
        try:
            response = self._http.request(
                call.method,
                self.server + API + call.route,
                params=call.query,
                content=call.chunks() if call.body else None,
                # Chunks have no length; with this one, a server can refuse before it has read them.
                headers={**call.headers, "Content-Length": str(len(call.body))},
            )
        except httpx.RequestError as error:
            unreachable = UnreachableError(f"{self.server}: {reason_of(error)}")
            # Waiting three minutes for a mistyped address helps nobody.
            if isinstance(error, _NOT_CONNECTED) and not self._has_replied:
                raise unreachable from error
            raise _TemporaryError(unreachable) from error
        self._has_replied = True
        if response.is_success:
            return response
        failed = failure(response, self.server)
        if _is_temporary(response):
            raise _TemporaryError(failed, retry_after_of(response))
        raise failed

    def _announce(self, reason: Exception, seconds: float) -> None:
        if self._notice:
            self._notice(f"{reason}; retrying in {seconds:g} s")


def http_client(server: str, headers: Mapping[str, str]) -> httpx.Client:
    """Return what sends requests to a server, by the environment's proxies and certificates."""
    # A proxy cannot reach a server on this machine, whatever the environment says.
    use_environment = not is_this_machine(httpx.URL(server).host)
    # Certificates take long to load, and are of no use without TLS and proxies.
    needs_certificates = use_environment or server.startswith("https:")
    try:
        # By SSL_CERT_FILE and SSL_CERT_DIR, also for a server on this machine.
        verify = httpx.create_ssl_context() if needs_certificates else False
        return httpx.Client(
            headers=headers, timeout=_TIMEOUT, trust_env=use_environment, verify=verify
        )
    except (ImportError, OSError, ValueError) as error:
        raise ServiceError(
            f"the environment sets a proxy or certificates that cannot be used ({error}); "
            "check HTTPS_PROXY, HTTP_PROXY, ALL_PROXY, SSL_CERT_FILE and SSL_CERT_DIR"
        ) from None


def retrying(
    failure: type[Exception],
    stop: "stop_base",
    first_pause: float,
    on_pause: Callable[[Exception, float], None],
) -> "Retrying":
    """Return what calls a function until it succeeds, and raises its last error if it does not.

    Parameters
    ----------
    failure : type
        The errors that another attempt may overcome. Their ``retry_after`` has the seconds to wait;
        None if the other side does not say.
    stop : stop_base
        When to give up, as tenacity takes it.
    first_pause : float
        Seconds before the second attempt, doubled before each further one.
    on_pause : callable
        Called before each pause with the error and the seconds.
    """
    from tenacity import RetryCallState, Retrying, retry_if_exception_type

    def seconds_after(attempt: RetryCallState) -> float:
        asked: float | None = _error_of(attempt).retry_after
        return first_pause * 2 ** (attempt.attempt_number - 1) if asked is None else asked

    return Retrying(
        retry=retry_if_exception_type(failure),
        stop=stop,
        wait=seconds_after,
        before_sleep=lambda attempt: on_pause(_error_of(attempt), attempt.upcoming_sleep),
        sleep=sleep,
        reraise=True,
    )


def _error_of(attempt: Any) -> Any:
    return attempt.outcome.exception()


def _is_temporary(response: httpx.Response) -> bool:
    """Whether the same request may succeed after a pause that is worth waiting for."""
    if (retry_after_of(response) or 0) > LONGEST_RETRY_AFTER:
        return False
    if response.status_code == httpx.codes.TOO_MANY_REQUESTS:
        problem = problem_of(response)  # a spent quota has the same status but lasts longer
        return problem is not None and problem.code == "too-many-requests"
    return response.status_code in _UNAVAILABLE


def retry_after_of(response: httpx.Response) -> float | None:
    """Return after how many seconds a server wants to be asked again; None if it does not say.

    The header has seconds, or a date (RFC 9110, section 10.2.3). Some servers send a fraction.
    """
    told = response.headers.get("retry-after", "")
    if told.replace(".", "", 1).isdecimal():
        return float(told)
    try:
        due = parsedate_to_datetime(told).timestamp()
    except (ValueError, OverflowError):  # the year or the time zone may have any number of digits
        return None
    return max(0.0, due - time())


def reason_of(error: httpx.RequestError) -> str:
    """Return why no reply came, in words for people."""
    match _root_cause(error), error:
        case gaierror(), _:
            return "host name not found"
        case ConnectionRefusedError(), _:
            return "connection refused; no server is running there"
        case ssl.SSLCertVerificationError(verify_message=why), _:
            return (
                f"its TLS certificate is not trusted ({why}); if you trust its authority, name it: "
                "SSL_CERT_FILE=authority.pem"
            )
        case ssl.SSLError(reason=why), _:
            return f"the TLS handshake failed ({why}); is it an http:// address?"
        case _, httpx.TimeoutException():
            return "no reply in time"
        case _:
            return f"the connection was dropped ({printable(str(error)) or type(error).__name__})"


def _root_cause(error: BaseException) -> BaseException:
    """Return the operating system's error, which httpx keeps as a context, not as a cause."""
    inner = error.__cause__ or error.__context__
    return _root_cause(inner) if inner else error


# Paths that exist on every server with this version of the API.
_ALWAYS_PRESENT = ("/server", "/splits", "/me", "/key", "/tokens")


def problem_of(response: httpx.Response) -> ProblemDocument | None:
    """Return the error document of an evaluation server, or None for any other reply."""
    try:
        return ProblemDocument.model_validate_json(response.content, extra="ignore")
    except ValidationError:
        return None


def failure(response: httpx.Response, server: str) -> ReverieEvalError:
    """Return the error to raise for a reply that is not a success."""
    status = f"{response.status_code} {response.reason_phrase}".rstrip()
    location = response.headers.get("location")
    # Not followed: a redirect may lead to another host, which would get the token.
    if location is not None:
        target = printable(str(response.url.join(location)).partition(API)[0].rstrip("/"))
        return NotAServerError(f"{server} redirects to {target}; if that is right, use that URL")
    document = problem_of(response)
    if document is None and response.is_server_error:
        return UnreachableError(f"{server} is unavailable (it answered {printable(status)})")
    if document is None and response.status_code == httpx.codes.REQUEST_ENTITY_TOO_LARGE:
        return ServiceError(
            f"the file is larger than a proxy in front of {server} accepts (it answered "
            f"{printable(status)}); leave out fields other than instr_id, trajectory and the "
            "answer, or ask the organiser"
        )
    if document is None:
        return NotAServerError(
            f"{server} is not an evaluation server (it answered {printable(status)})"
        )
    is_missing = response.status_code == httpx.codes.NOT_FOUND
    if is_missing and response.url.path.endswith(tuple(API + route for route in _ALWAYS_PRESENT)):
        return incompatible_version(server)
    return _error_in(document)


def incompatible_version(server: str) -> NotAServerError:
    """Return the error for a server whose replies this version does not understand."""
    return NotAServerError(
        f"{server} is not compatible with reverie-eval {__version__} (API v1); install the version "
        "that its organiser recommends"
    )


def _error_in(document: ProblemDocument) -> ReverieEvalError:
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


# Addresses.


API = "/api/v1"
"""Where a server has its API."""


def server_url(text: str) -> str:
    """Return a server's URL in normal form, without the API's path; others are a ServiceError.

    >>> server_url(" https://Reverie.example.org/api/v1/ ")
    'https://reverie.example.org'
    """
    try:
        url = httpx.URL(text.strip())
    except httpx.InvalidURL:
        url = httpx.URL()
    if url.scheme not in ("http", "https") or not url.host or url.userinfo:
        raise ServiceError(f"{text!r} is not a server URL; write it as https://HOST")
    return str(url.copy_with(query=None, fragment=None)).rstrip("/").removesuffix(API)


def check_private(server: str) -> None:
    """Refuse a server that is reached without encryption, unless it is on this machine."""
    url = httpx.URL(server)
    if url.scheme == "http" and not is_this_machine(url.host):
        raise ServiceError(
            f"{server} is not encrypted: others on the network could read your token and change "
            "the data; use https://, or allow it with --plain-http on a network that you trust"
        )


def is_this_machine(host: str) -> bool:
    """Whether a host name or address means this machine.

    >>> [is_this_machine(host) for host in ("localhost", "127.0.0.2", "::1", "192.168.1.7")]
    [True, True, True, False]
    """
    try:
        address = ip_address(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
    return address.is_loopback or address.is_unspecified
