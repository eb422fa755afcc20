"""``reverie-eval login --server URL``: keep a token for an evaluation server.

The token comes from the keyboard, unseen, or from standard input; never as an argument, which
everybody on a machine can read.
"""

import os
import sys
from getpass import getpass
from typing import TYPE_CHECKING

import click

from reverie_eval import ReverieEvalError
from reverie_eval.schemas.wire import TOKEN_VARIABLE
from reverie_eval_cli.output import note
from reverie_eval_cli.servers import ServerOptions, print_banner, server_options

if TYPE_CHECKING:
    from reverie_eval.client import RefusedError


@click.command()
@server_options
def login(*, server: ServerOptions) -> None:
    """Sign in to a server with a token or an invitation.

    The token, or an invitation to exchange for one, is read from the keyboard or from standard
    input.
    """
    from reverie_eval.client.logins import Logins
    from reverie_eval.text import printable

    logins = Logins.load()
    logins.save()  # an invitation works once: see first that its token can be kept
    server.connect().close()  # and that it can be sent safely
    token = _exchange(server, _ask())
    file = logins.with_token(server.url, token).save()
    with server.connect(token) as client:
        print_banner(client)
        me = client.me()
    who = printable(f"{me.person} of {me.team} ({me.role})")
    print(f"signed in to {client.url} as {who}; token kept in {file}")
    if TOKEN_VARIABLE in os.environ:
        note(f"{TOKEN_VARIABLE} is set, and takes precedence over the login")


def _ask() -> str:
    try:
        # Not echoed on a terminal, where it would stay to be read.
        if sys.stdin is not None and sys.stdin.isatty():
            text = getpass("token or invitation: ")
        else:
            text = sys.stdin.readline() if sys.stdin is not None else ""
    except EOFError:
        text = ""
    if not text.strip():
        raise ReverieEvalError("no token given")
    return text.strip()


def _exchange(server: ServerOptions, secret: str) -> str:
    """Return a token as it is, and an invitation's token."""
    from reverie_eval.client import RefusedError

    # As a token first, which uses nothing up: an invitation works once.
    with server.connect(secret) as client:
        try:
            client.me()
        except RefusedError as error:
            as_token = _reason_if_unknown(error)
        else:
            return secret
    with server.connect() as client:
        try:
            return client.accept(secret).token
        except RefusedError as error:
            as_invitation = _reason_if_unknown(error)
            raise ReverieEvalError(
                f"{client.url} refuses this, as a token ({as_token}) and as an invitation "
                f"({as_invitation})"
            ) from None


def _reason_if_unknown(error: "RefusedError") -> str:
    """Return why a token or an invitation is not known; any other refusal is raised."""
    if error.document.code != "not-signed-in":
        raise error
    return str(error)
