"""The installed command on a terminal: what it shows, and what is typed when it asks."""

import io
import os
import pty
import re
import termios
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path

from tests.support.forking import Forked, Surroundings, command

ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def on_terminal(
    columns: int,
    *given: str,
    answers: Mapping[str, str] | None = None,
    variables: Mapping[str, str] | None = None,
) -> str:
    """Run the installed command on a terminal of this width and return what it shows.

    Parameters
    ----------
    columns : int
        How wide the terminal is.
    given : str
        The command's words.
    answers : mapping, optional
        What is typed when the terminal shows a question, in this order.
    variables : mapping, optional
        Of the environment, in addition.
    """
    leader, follower = pty.openpty()
    termios.tcsetwinsize(follower, (24, columns))
    environment = os.environ | {"TERM": "xterm-256color", **(variables or {})}
    for name in ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR"):
        environment.pop(name, None)
    terminal = Connection(follower)
    surroundings = Surroundings(Path.cwd(), environment, terminal, terminal, is_on_terminal=True)
    with Forked(command, surroundings, *given):
        terminal.close()
        with os.fdopen(leader, "r+b", buffering=0) as screen:
            shown = b""
            for question, answer in (answers or {}).items():
                shown += _until(screen, question.encode())
                screen.write(f"{answer}\n".encode())
            shown += _until(screen, None)
    return shown.decode().replace("\r\n", "\n")


def _until(screen: io.FileIO, text: bytes | None) -> bytes:
    """Read until a text is shown or the other side has closed, which Linux calls an error."""
    shown = b""
    try:
        while (text is None or text not in shown) and (piece := screen.read(4096)):
            shown += piece
    except OSError:
        pass
    return shown
