"""The state of the running application: turns, requests to join, metrics.

Uploads take turns twice: for a place in memory, and for a process that scores. Waiting uploads are
not read yet: their bytes are still with the sender. So five hundred uploads at once need no more
memory than the first few. A team holds only a share of the places, and one process less than there
are: a file that takes as long as any file may leaves one to all others. Processes score the next
upload while the last one is being stored, so there are more turns than processes.
"""

import asyncio
import hashlib
import hmac
import math
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Hashable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Annotated, NamedTuple, Self

from fastapi import Depends, Request
from limits import RateLimitItemPerDay
from limits.storage import MemoryStorage, Storage
from limits.strategies import FixedWindowRateLimiter
from starlette.types import Scope

from reverie_eval.server.errors import BusyError, TooManyError
from reverie_eval.server.http.callers import address_of, session_of, token_of
from reverie_eval.server.http.middleware import site_of
from reverie_eval.server.http.telemetry import Metrics
from reverie_eval.server.jobs import Jobs
from reverie_eval.server.scoring.contexts import SECONDS_TO_RETRY
from reverie_eval.server.state import ServerState

MOST_JOINING = 5
"""Requests to join that an address may send in 24 hours."""

_SHARE = 4
"""A team may hold one in this many places in memory and in the queue, and at least one."""


class Turns:
    """Places that several people want: who holds fewest is next, then who came first.

    Nobody holds more than a share of the places, or of the queue, so one who asks for many delays
    only themselves.

    Parameters
    ----------
    places : int
        Held at once, at most.
    share : int
        Held at once by the same people, at most.
    waiting : int
        Waiting for a place, at most.
    seconds : float
        The longest that one waits.
    show : callable
        Called with the number of those who wait whenever it changes.
    """

    def __init__(
        self,
        places: int,
        share: int,
        waiting: int,
        seconds: float,
        show: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._free = places
        self._share = share
        self._most_waiting = waiting
        self._most_waiting_of_one = min(waiting, max(1, waiting // _SHARE))
        self._seconds = seconds
        self._show = show
        self._held: Counter[Hashable] = Counter()
        self._queue: list[_Waiting] = []

    @property
    def waiting(self) -> int:
        """How many wait for a place."""
        return len(self._queue)

    @asynccontextmanager
    async def hold(self, whose: Hashable) -> AsyncIterator[None]:
        """Wait for a place and hold it.

        Raises BusyError if too many are waiting, or no place became free in time.
        """
        await self._take(whose)
        try:
            yield
        finally:
            self._held[whose] -= 1
            self._held += Counter()  # forgets those who hold none
            self._free += 1
            self._hand_out()

    async def _take(self, whose: Hashable) -> None:
        waiting = _Waiting(whose, asyncio.get_running_loop().create_future())
        self._queue.append(waiting)
        self._hand_out()
        if waiting.place.done():
            return
        own = sum(each.whose == whose for each in self._queue)
        if self.waiting > self._most_waiting or own > self._most_waiting_of_one:
            self._leave(waiting)
            raise BusyError(SECONDS_TO_RETRY)
        try:
            async with asyncio.timeout(self._seconds):
                await waiting.place
        except TimeoutError:
            self._leave(waiting)
            raise BusyError(SECONDS_TO_RETRY) from None
        except asyncio.CancelledError:
            self._leave(waiting)
            raise

    def _leave(self, waiting: "_Waiting") -> None:
        """Give up waiting, and the place if it was handed out in the same moment."""
        if waiting in self._queue:
            self._queue.remove(waiting)
        else:
            self._held[waiting.whose] -= 1
            self._free += 1
        self._hand_out()

    def _hand_out(self) -> None:
        while self._free and (
            entitled := [
                each
                for each in self._queue
                if self._held[each.whose] < self._share and not each.place.cancelled()
            ]
        ):
            following = min(entitled, key=lambda each: self._held[each.whose])
            self._queue.remove(following)
            self._held[following.whose] += 1
            self._free -= 1
            following.place.set_result(None)
        self._show(self.waiting)


class _Waiting(NamedTuple):
    """One who waits for a place."""

    whose: Hashable
    place: asyncio.Future[None]


class JoinLimit:
    """Counts requests to join by address, so that one sender cannot fill the list of open ones.

    An address is kept as a keyed digest, for 24 hours from its first request.
    """

    def __init__(self, counts: Storage, key: bytes) -> None:
        self._limit = RateLimitItemPerDay(MOST_JOINING)
        self._counts = FixedWindowRateLimiter(counts)
        self._key = key

    def count(self, scope: Scope) -> None:
        """Count a request to join.

        Raises TooManyError if the address has sent as many as it may.
        """
        address = site_of(address_of(scope)).encode()
        sender = hmac.digest(self._key, address, hashlib.sha256).hex()
        if self._counts.hit(self._limit, "join", sender):
            return
        until = self._counts.get_window_stats(self._limit, "join", sender).reset_time
        raise TooManyError(
            max(1, math.ceil(until - time.time())),
            f"{MOST_JOINING} requests to join came from your address in the last 24 hours; try "
            "again tomorrow, or write to the organiser",
        )


@dataclass(frozen=True)
class RuntimeState:
    """What an application knows of its requests: who waits, who asked how often, how it went."""

    uploads: Turns
    """Uploads in memory."""
    scoring: Turns
    """Requests that score, or store what they scored."""
    counts: Storage
    joining: JoinLimit
    metrics: Metrics

    @classmethod
    def of(cls, server: ServerState, jobs: Jobs) -> Self:
        """Create the state of the application of a server."""
        limits, metrics = server.settings.limits, Metrics(server.boards, jobs)
        queue = limits.uploads_waiting, limits.seconds_for_body
        at_once = limits.uploads_at_once
        share = max(1, at_once // _SHARE)
        uploads = Turns(at_once, share, *queue, metrics.uploads_waiting.set)
        share = max(1, server.scoring.number - 1)
        scoring = Turns(server.scoring.turns, share, *queue, metrics.scoring_waiting.set)
        counts = MemoryStorage()
        joining = JoinLimit(counts, server.signer.secret_for("requests to join"))
        return cls(uploads, scoring, counts, joining, metrics)


async def runtime_of(request: Request) -> RuntimeState:
    """Return the state of the application that answers a request."""
    runtime: RuntimeState = request.app.state.runtime
    return runtime


Runtime = Annotated[RuntimeState, Depends(runtime_of)]


async def scoring_turn(request: Request, runtime: Runtime) -> AsyncIterator[None]:
    """Wait for a turn to score, without occupying a thread."""
    scope = request.scope
    async with runtime.scoring.hold(token_of(scope) or session_of(scope) or address_of(scope)):
        yield


ScoringTurn = Annotated[None, Depends(scoring_turn, scope="function")]
"""For routes that may score a stored submission again."""
