"""What the log, the metrics and problem documents need to know about a request and its reply."""

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from starlette.types import Scope

from reverie_eval.schemas.service import QuotaReport

OK = "ok"
"""The outcome of a request without a problem."""

_KEY = "reverie_eval.exchange"


@dataclass(slots=True)
class Exchange:
    """Notes about a request, taken while it is answered."""

    id: str = field(default_factory=lambda: secrets.token_hex(8))
    """Lets a participant report a request that the organiser can find in the log."""
    began: float = field(default_factory=time.perf_counter)
    received: int = 0
    """Bytes of the request's body."""
    sent: int = 0
    """Bytes of the reply's body."""
    status: int | None = None
    """None until the reply has begun."""
    outcome: str = OK
    """Or the code of the problem document."""
    uploaded_to: str | None = None
    """For an upload to be scored, the requested split; empty until it is known."""
    is_repeat: bool = False
    """Whether the same upload was scored before."""
    quota: Callable[[], QuotaReport] | None = None
    """Returns the caller's submissions left, if a problem document should include them."""
    asks_database: bool = True
    """Whether the reply to a problem may query the database: not outside the routes, nor after a
    fault of the server."""

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
