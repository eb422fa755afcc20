"""Listening at an address."""

import socket

from reverie_eval.errors import ReverieEvalError

_WAITING = 2048
"""Connections that may wait to be accepted."""


def listen(host: str, port: int) -> socket.socket:
    """Listen at an address; port 0 means any free port.

    Raises
    ------
    ReverieEvalError
        If the address is in use or not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host, port), family=family, backlog=_WAITING)
        # Accepted connections inherit it. Without it, a reply's body waits 40 ms until the client
        # acknowledges the headers.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0].lower()
        raise ReverieEvalError(
            f"cannot listen at {host}, port {port}: {reason}; choose another address with --host "
            "or --port (0 for any free port)"
        ) from None
    return listening


def url_of(listening: socket.socket) -> str:
    """Return the address as a URL."""
    host, port = listening.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
