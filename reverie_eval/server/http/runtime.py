"""The state of one running application: admission of uploads, requests to join, metrics, health.

Admission limits how many uploads are held in memory, and how many are scored, at once; several
worker processes divide both among them.

Waiting uploads are not read yet: their bytes are still with the sender. So five hundred uploads at
once need no more memory than the first few. The people of a team may together hold only a share of
the slots, and of the queue, so a team that sends many slow uploads delays only its own.
"""

import asyncio
import hashlib
import hmac
import math
import os
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Annotated, Self
from weakref import WeakValueDictionary

from fastapi import Depends, Request
from limits import RateLimitItemPerDay
from limits.storage import Storage
from limits.strategies import FixedWindowRateLimiter
from starlette.types import Scope

from reverie_eval.server.errors import BusyError, TooManyError
from reverie_eval.server.http.exchange import address_of
from reverie_eval.server.http.health import Health
from reverie_eval.server.http.middleware import site_of
from reverie_eval.server.http.telemetry import Metrics
from reverie_eval.server.http.workers import ALONE, Workers
from reverie_eval.server.jobs.runner import Jobs
from reverie_eval.server.state import ServerState

SECONDS_TO_RETRY = 10
MOST_JOINING = 5
"""Requests to join that an address may send in 24 hours."""

_SHARE = 4
"""A team may hold one in this many slots and places in the queue, and at least one."""
_SCORED_AT_ONCE = os.cpu_count() or 1
"""More would not be faster, but take more memory."""


class Admission:
    """Admits uploads, first come, first served, up to each team's share.

    Parameters
    ----------
    at_once : int
        Uploads in memory, at most.
    waiting : int
        Uploads waiting to be read, at most.
    seconds : float
        The longest that an upload waits.
    workers : Workers
        The processes among which all of this is divided.
    show : callable
        Called with the number of waiting uploads whenever it changes.
    """

    def __init__(
        self,
        at_once: int,
        waiting: int,
        seconds: float,
        workers: Workers = ALONE,
        show: Callable[[int], None] = lambda _: None,
    ) -> None:
        at_once, waiting = workers.share(at_once), workers.share(waiting)
        self._memory = asyncio.Semaphore(at_once)
        self._slots_of_team = max(1, at_once // _SHARE)
        self._teams: WeakValueDictionary[int, _Team] = WeakValueDictionary()
        self._scoring = asyncio.Semaphore(min(at_once, workers.share(_SCORED_AT_ONCE)))
        self._longest_queue = waiting
        self._queue_of_team = min(waiting, max(1, waiting // _SHARE))
        self._seconds = seconds
        self._show = show
        self.waiting = 0

    @asynccontextmanager
    async def hold(self, team_id: int) -> AsyncIterator[None]:
        """Wait for a slot for a team's upload, and hold it.

        Raises BusyError if too many uploads are waiting, or no slot became free in time.
        """
        team = self._teams.setdefault(team_id, _Team(self._slots_of_team))
        has_to_wait = team.slots.locked() or self._memory.locked()
        is_full = self.waiting >= self._longest_queue or team.waiting >= self._queue_of_team
        if has_to_wait and is_full:
            raise BusyError(SECONDS_TO_RETRY)
        async with AsyncExitStack() as places:
            await self._wait(places, team)
            yield

    async def _wait(self, places: AsyncExitStack, team: "_Team") -> None:
        self._queue(team, 1)
        try:
            async with asyncio.timeout(self._seconds):
                # The team's own limit comes first, or its uploads would fill the queue.
                await places.enter_async_context(team.slots)
                await places.enter_async_context(self._memory)
        except TimeoutError:
            raise BusyError(SECONDS_TO_RETRY) from None
        finally:
            self._queue(team, -1)

    def _queue(self, team: "_Team", change: int) -> None:
        team.waiting += change
        self.waiting += change
        self._show(self.waiting)

    def score(self) -> asyncio.Semaphore:
        """Return the semaphore to hold while scoring."""
        return self._scoring


class _Team:
    """What a team holds, for as long as it holds or waits for anything."""

    def __init__(self, slots: int) -> None:
        self.slots = asyncio.Semaphore(slots)
        self.waiting = 0


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

    admission: Admission
    counts: Storage
    joining: JoinLimit
    metrics: Metrics
    health: Health

    @classmethod
    def of(cls, server: ServerState, jobs: Jobs, workers: Workers) -> Self:
        """Create the state of one of the worker processes of a server."""
        limits, metrics = server.settings.limits, Metrics(server.boards, jobs)
        admission = Admission(
            limits.uploads_at_once,
            limits.uploads_waiting,
            limits.seconds_for_body,
            workers,
            metrics.uploads_waiting.set,
        )
        counts = workers.counts()
        joining = JoinLimit(counts, server.signer.secret_for("requests to join"))
        return cls(admission, counts, joining, metrics, Health(server, jobs))


async def runtime_of(request: Request) -> RuntimeState:
    """Return the state of the application that answers a request."""
    runtime: RuntimeState = request.app.state.runtime
    return runtime


Runtime = Annotated[RuntimeState, Depends(runtime_of)]
