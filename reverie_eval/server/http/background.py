"""Work that a running server repeats, each kind in a thread of its own."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread

MINUTE, DAY = 60, 24 * 60 * 60
"""In seconds."""
_LOGGER = logging.getLogger("reverie_eval.server")


@contextmanager
def repeatedly(
    work: Callable[[], object],
    seconds: float,
    failure: str = "repeated work failed",
    patience: float | None = None,
) -> Iterator[None]:
    """Do some work now and at intervals until the context ends; log failures and try again.

    At the end, work that has begun is waited for, at most for ``patience`` seconds.
    """
    is_over = Event()

    def repeat() -> None:
        while True:
            try:
                work()
            except Exception:
                _LOGGER.exception(failure)
            if is_over.wait(seconds):
                return

    thread = Thread(target=repeat, name="repeated", daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join(patience)
