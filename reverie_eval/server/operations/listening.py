"""Taking an address to listen at, before anything is said of it."""

import socket

from reverie_eval.errors import ReverieEvalError

_WAITING = 2048
"""Connections that may wait to be taken."""


def listen(host: str, port: int) -> socket.socket:
    """Listen at an address; port 0 takes any that is free.

    Raises
    ------
    ReverieEvalError
        If the address is taken or not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host, port), family=family, backlog=_WAITING)
        # Connections inherit it; without it a reply's body waits 40 ms for its head's receipt.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0].lower()
        raise ReverieEvalError(
            f"cannot listen at {host}, port {port}: {reason}; choose another with --host and "
            "--port, 0 for any port that is free"
        ) from None
    return listening


def url_of(listening: socket.socket) -> str:
    """Return the address as a URL."""
    host, port = listening.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
