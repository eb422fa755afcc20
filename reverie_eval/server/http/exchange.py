"""A request and its reply, as far as the log, the metrics and a problem document speak of them."""

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from starlette.types import Scope

from reverie_eval.schemas.service import QuotaReport

OK = "ok"
"""The outcome of a request that came to no problem."""

_KEY = "reverie_eval.exchange"


@dataclass(slots=True)
class Exchange:
    """What is noted of a request while it is answered."""

    id: str = field(default_factory=lambda: secrets.token_hex(8))
    """Tells the participant and the organiser that they speak of the same request."""
    began: float = field(default_factory=time.perf_counter)
    received: int = 0
    """Bytes of the request's body."""
    sent: int = 0
    """Bytes of the reply's body."""
    status: int | None = None
    """None until the reply has begun."""
    outcome: str = OK
    """The code of the problem document, if it came to that."""
    uploaded_to: str | None = None
    """Of an upload to be scored, the split as its sender names it: empty until that is known."""
    is_repeat: bool = False
    """Whether the upload was scored before."""
    quota: Callable[[], QuotaReport] | None = None
    """Tells what the caller has left, where a problem document is to say so."""
    asks_database: bool = True
    """Whether a problem's reply may; not outside the routes, nor where the server has failed."""

    @property
    def seconds(self) -> float:
        """How long it has taken until now."""
        return time.perf_counter() - self.began


def begin(scope: Scope) -> Exchange:
    """Begin to note what becomes of a request."""
    exchange = Exchange()
    scope[_KEY] = exchange
    return exchange


def exchange_of(scope: Scope) -> Exchange:
    """Return what is noted of a request."""
    exchange: Exchange = scope[_KEY]
    return exchange
