"""How many uploads are held in memory, and how many are scored, at a time.

Those that wait have not been read: their bytes are still with their senders. So what five hundred
uploads at once cost is what the first few of them do.
"""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from reverie_eval.server.errors import BusyError

SECONDS_TO_RETRY = 10

_SCORED_AT_ONCE = os.cpu_count() or 1
"""More would not be faster, and take more memory."""


class Admission:
    """Lets uploads in one after the other, first come, first served."""

    def __init__(self, at_once: int, waiting: int, seconds: float) -> None:
        self._memory = asyncio.Semaphore(at_once)
        self._scoring = asyncio.Semaphore(min(at_once, _SCORED_AT_ONCE))
        self._longest_queue = waiting
        self._seconds = seconds
        self.waiting = 0

    @asynccontextmanager
    async def hold(self) -> AsyncIterator[None]:
        """Hold an upload in memory, as soon as there is room.

        Raises
        ------
        BusyError
            If too many wait already, or none of them could be let in for too long.
        """
        if self._memory.locked() and self.waiting >= self._longest_queue:
            raise BusyError(SECONDS_TO_RETRY)
        await self._wait()
        try:
            yield
        finally:
            self._memory.release()

    async def _wait(self) -> None:
        self.waiting += 1
        try:
            async with asyncio.timeout(self._seconds):
                await self._memory.acquire()
        except TimeoutError:
            raise BusyError(SECONDS_TO_RETRY) from None
        finally:
            self.waiting -= 1

    def score(self) -> asyncio.Semaphore:
        """Return what is entered to score."""
        return self._scoring
