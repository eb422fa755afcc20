"""Free ports, for servers that have to be told their port in advance."""

import socket
from contextlib import suppress
from random import SystemRandom


def free_port() -> int:
    """Return a port at which nobody listens.

    It stays free: systems give other ports, from 32,768 on, to whatever asks for any port.
    """
    while True:
        with socket.socket() as tried, suppress(OSError):
            tried.bind(("127.0.0.1", SystemRandom().randrange(20_000, 30_000)))
            port: int = tried.getsockname()[1]
            return port
