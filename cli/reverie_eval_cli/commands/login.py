"""``reverie-eval login --server URL``: tell this machine who one is on a server.

The token comes from the keyboard, unseen, or from standard input; never as an argument, which
everybody on a machine can read.
"""

import argparse
import os
import sys
from getpass import getpass
from typing import TYPE_CHECKING

from reverie_eval import ReverieEvalError
from reverie_eval.client._logins import TOKEN_VARIABLE
from reverie_eval_cli.servers import add_server, connect, server_of, tell_banner

if TYPE_CHECKING:
    from reverie_eval.client import RefusedError

SUMMARY = "keep your token for an evaluation server, or turn an invitation into one"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server(parser)


def run(arguments: argparse.Namespace) -> int:
    """Keep a token and say whose it is."""
    from reverie_eval.client._logins import Logins
    from reverie_eval.text import printable

    logins = Logins.load()
    logins.save()  # an invitation is used up by asking: see first that its token can be kept
    connect(arguments).close()  # and that its way there is private
    token = _token(arguments, _asked())
    place = logins.signed_in(server_of(arguments), token).save()
    with connect(arguments, token) as client:
        tell_banner(client)
        me = client.me()
    who = printable(f"{me.person} of {me.team} ({me.role})")
    print(f"signed in to {client.url} as {who}; kept in {place}")
    if TOKEN_VARIABLE in os.environ:
        print(f"note: {TOKEN_VARIABLE} is set, and goes before what was kept", file=sys.stderr)
    return 0


def _asked() -> str:
    try:
        if sys.stdin is not None and sys.stdin.isatty():
            text = getpass("token or invitation: ")
        else:
            text = sys.stdin.readline() if sys.stdin is not None else ""
    except EOFError:
        text = ""
    if not text.strip():
        raise ReverieEvalError("no token was given")
    return text.strip()


def _token(arguments: argparse.Namespace, secret: str) -> str:
    """Return the token itself, or what the invitation is exchanged for."""
    from reverie_eval.client import RefusedError

    with connect(arguments, secret) as client:
        try:
            client.me()
        except RefusedError as error:
            as_token = _if_unknown(error)
        else:
            return secret
    with connect(arguments) as client:
        try:
            return client.accept(secret).token
        except RefusedError as error:
            as_invitation = _if_unknown(error)
            raise ReverieEvalError(
                f"{client.url} refuses this, as a token ({as_token}) and as an invitation "
                f"({as_invitation})"
            ) from None


def _if_unknown(error: "RefusedError") -> str:
    """Return why somebody is not known; whatever else was refused is an error."""
    if error.document.code != "not-signed-in":
        raise error
    return str(error)
