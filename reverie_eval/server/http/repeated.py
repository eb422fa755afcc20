"""Work that a running server repeats, each kind in a thread of its own."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread

MINUTE, DAY = 60, 24 * 60 * 60
"""In seconds."""
_LOGGER = logging.getLogger("reverie_eval.server")


@contextmanager
def repeatedly(work: Callable[[], object], seconds: float) -> Iterator[None]:
    """Do some work now and at intervals until the context ends; log failures and try again."""
    is_over = Event()

    def repeat() -> None:
        while True:
            try:
                work()
            except Exception:
                _LOGGER.exception("repeated work failed")
            if is_over.wait(seconds):
                return

    thread = Thread(target=repeat, name="repeated", daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
