"""How many uploads are held in memory, and how many are scored, at a time.

Those that wait have not been read: their bytes are still with their senders. So what five hundred
uploads at once cost is what the first few of them do. Nobody holds more than a share of the places,
so that whoever sends many slowly keeps but themselves waiting.
"""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from weakref import WeakValueDictionary

from reverie_eval.server.errors import BusyError

SECONDS_TO_RETRY = 10

_SHARE = 4
"""One in so many places is what a person may hold, and one at least."""
_SCORED_AT_ONCE = os.cpu_count() or 1
"""More would not be faster, and take more memory."""


class Admission:
    """Lets uploads in one after the other, first come, first served, to each their share."""

    def __init__(self, at_once: int, waiting: int, seconds: float) -> None:
        self._memory = asyncio.Semaphore(at_once)
        self._share = max(1, at_once // _SHARE)
        self._shares: WeakValueDictionary[int, asyncio.Semaphore] = WeakValueDictionary()
        self._scoring = asyncio.Semaphore(min(at_once, _SCORED_AT_ONCE))
        self._longest_queue = waiting
        self._seconds = seconds
        self.waiting = 0

    @asynccontextmanager
    async def hold(self, person: int) -> AsyncIterator[None]:
        """Hold an upload of somebody's in memory, as soon as there is room.

        Raises
        ------
        BusyError
            If too many wait already, or none of them could be let in for too long.
        """
        own = self._shares.setdefault(person, asyncio.Semaphore(self._share))
        has_to_wait = own.locked() or self._memory.locked()
        if has_to_wait and self.waiting >= self._longest_queue:
            raise BusyError(SECONDS_TO_RETRY)
        async with AsyncExitStack() as places:
            await self._wait(places, own)
            yield

    async def _wait(self, places: AsyncExitStack, own: asyncio.Semaphore) -> None:
        self.waiting += 1
        try:
            async with asyncio.timeout(self._seconds):
                await places.enter_async_context(own)  # who has their share stands in no queue
                await places.enter_async_context(self._memory)
        except TimeoutError:
            raise BusyError(SECONDS_TO_RETRY) from None
        finally:
            self.waiting -= 1

    def score(self) -> asyncio.Semaphore:
        """Return what is entered to score."""
        return self._scoring
