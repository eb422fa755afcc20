"""Work that a running server does once a day, in a thread of its own."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread

_DAY = 24 * 60 * 60
_LOGGER = logging.getLogger("reverie_eval.server")


@contextmanager
def daily(work: Callable[[], object], seconds: float = _DAY) -> Iterator[None]:
    """Do some work now and once a day until the end; if it fails, log that and try again later."""
    is_over = Event()

    def repeat() -> None:
        while True:
            try:
                work()
            except Exception:
                _LOGGER.exception("the daily work failed")
            if is_over.wait(seconds):
                return

    thread = Thread(target=repeat, name="daily", daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
