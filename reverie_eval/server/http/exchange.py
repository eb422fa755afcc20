"""What the log, the metrics and problem documents need to know about a request and its reply.

They contain few values that its sender chose: a route, a method, an address, a token's hint.
"""

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from fastapi.security.utils import get_authorization_scheme_param
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import Scope

from reverie_eval.schemas.service import Accepted, QuotaReport
from reverie_eval.server.http.callers import COOKIE
from reverie_eval.server.identity import name_in

API = "/api/v1"
OK = "ok"
"""The outcome of a request without a problem."""

_KEY = "reverie_eval.exchange"


@dataclass(slots=True)
class Exchange:
    """Notes about a request, taken while it is answered."""

    id: str = field(default_factory=lambda: secrets.token_hex(8))
    """By this, the organiser finds a request in the log when a participant reports it."""
    began: float = field(default_factory=time.perf_counter)
    received: int = 0
    """Bytes of the request's body."""
    sent: int = 0
    """Bytes of the reply's body."""
    status: int | None = None
    """None until the reply has begun."""
    outcome: str = OK
    """``ok``, or the code of the problem document."""
    uploaded_to: str | None = None
    """For an upload to be scored, the requested split; empty until it is known."""
    is_repeat: bool = False
    """Whether the same upload was scored before."""
    team: int | None = None
    """For an upload that was read, the number of the sender's team."""
    split: str = ""
    """For an upload that was read, the split that the sender wrote."""
    submission: str = ""
    """The id of the submission that an upload became or repeats."""
    quota: Callable[[], QuotaReport] | None = None
    """Returns the caller's submissions left, if a problem document should include them."""
    asks_database: bool = True
    """Whether the reply to a problem may query the database: not outside the routes, nor after a
    fault of the server."""

    def note(self, accepted: Accepted) -> None:
        """Note the outcome of an upload."""
        self.submission, self.is_repeat = accepted.submission.id, accepted.is_repeat

    @property
    def seconds(self) -> float:
        """The time since the request began."""
        return time.perf_counter() - self.began


def begin(scope: Scope) -> Exchange:
    """Attach new notes to a request."""
    exchange = Exchange()
    scope[_KEY] = exchange
    return exchange


def exchange_of(scope: Scope) -> Exchange:
    """Return the notes about a request."""
    exchange: Exchange = scope[_KEY]
    return exchange


def address_of(scope: Scope) -> str:
    """Return the sender's address, from the connection or a trusted proxy."""
    client = scope.get("client")
    return str(client[0]) if client else "unknown"


def token_of(scope: Scope) -> str:
    """Return the token of a request, parsed as the routes do; empty if it has none."""
    return get_authorization_scheme_param(Headers(scope=scope).get("authorization"))[1]


def session_of(scope: Scope) -> str:
    """Return the name of the browser session in the cookie; empty if there is none."""
    return name_in(HTTPConnection(scope).cookies.get(COOKIE, ""))
