"""Waiting for what is bound to come, on a machine of any speed."""

import time
from collections.abc import Callable

PATIENCE = 300
"""Seconds after which a test takes it that nothing will come any more."""


def wait_until(condition: Callable[[], object]) -> None:
    """Wait for a condition that nothing but the machine delays."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it does not come true"
        time.sleep(0.02)
