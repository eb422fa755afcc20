"""Waiting for what is bound to come, on a machine of any speed."""

import time
from collections.abc import Callable
from threading import Event, Lock
from typing import Self

PATIENCE = 300
"""Seconds after which a test takes it that nothing will come any more."""
SELDOM = 1
"""A pause in seconds after a look that costs much, as loading a page does: a busy machine would do
little else, and what is waited for come later."""


def wait_until(condition: Callable[[], object], pause: float = 0.02) -> None:
    """Wait for a condition that nothing but the machine delays, and look again after each pause."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it does not come true"
        time.sleep(pause)


class WatchedLock:
    """A lock that tells when a thread has to wait for it.

    So the thread that holds it need not guess how long others take to come. If the lock is not
    taken, nobody waits for it: a thread that comes through has to set the event too.
    """

    def __init__(self, awaited: Event) -> None:
        self._awaited = awaited
        self._lock = Lock()

    def __enter__(self) -> Self:
        """Take the lock; set the event if another thread has it."""
        if not self._lock.acquire(blocking=False):
            self._awaited.set()
            self._lock.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        """Give the lock back."""
        self._lock.release()
