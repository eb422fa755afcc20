"""Which server is meant, and who one is there: options, variables, the login file."""

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from reverie_eval import ReverieEvalError
from reverie_eval.client._logins import SERVER_VARIABLE, TOKEN_VARIABLE

if TYPE_CHECKING:
    from reverie_eval.client import Client
    from reverie_eval.client._sending import Notice


def add_server(parser: argparse.ArgumentParser) -> argparse._MutuallyExclusiveGroup:
    """Add the server; what is returned takes options that stand in its place."""
    named = parser.add_mutually_exclusive_group()
    named.add_argument(
        "--server",
        metavar="URL",
        help=f"the evaluation server (default: ${SERVER_VARIABLE}, then the latest `login`)",
    )
    parser.add_argument(
        "--plain-http",
        action="store_true",
        help="let http:// lead to another machine, in a network that you trust",
    )
    return named


def server_of(arguments: argparse.Namespace) -> str:
    """Return the URL of the server that is meant.

    Raises
    ------
    ReverieEvalError
        If none is named anywhere.
    """
    from reverie_eval.client._logins import Logins
    from reverie_eval.client._sending import server_url

    named = arguments.server or os.environ.get(SERVER_VARIABLE) or Logins.load().latest
    if not named:
        raise ReverieEvalError(f"which server? Name it with --server URL or {SERVER_VARIABLE}")
    return server_url(named)


def connect(
    arguments: argparse.Namespace, token: str | None = None, notice: "Notice | None" = None
) -> "Client":
    """Return a client of the server that is meant."""
    from reverie_eval.client import Client

    return Client(server_of(arguments), token, notice, plain_http=arguments.plain_http)


def tell_banner(client: "Client") -> None:
    """Pass on what the organiser has to say to everybody."""
    from reverie_eval.text import printable

    if banner := client.server().banner:
        print(f"{client.url}: {printable(banner)}", file=sys.stderr)


def token_for(server: str) -> str:
    """Return the token to show to a server.

    Raises
    ------
    ReverieEvalError
        If there is none.
    """
    from reverie_eval.client._logins import Logins

    token = os.environ.get(TOKEN_VARIABLE) or Logins.load().tokens.get(server)
    if not token:
        raise ReverieEvalError(
            f"you are not signed in to {server}; run `reverie-eval login --server {server}`, or "
            f"put your token into {TOKEN_VARIABLE}"
        )
    return token


@contextmanager
def showing_token(server: str) -> Iterator[None]:
    """Say of a token that is refused where it came from, and how to show another.

    Raises
    ------
    ReverieEvalError
        In place of the refusal.
    """
    from reverie_eval.client import RefusedError

    try:
        yield
    except RefusedError as error:
        if error.document.code != "not-signed-in":
            raise
        remedy = f"run `reverie-eval login --server {server}` to be asked for another"
        if os.environ.get(TOKEN_VARIABLE):
            remedy = f"it came from {TOKEN_VARIABLE}: correct that, or unset it to use the login's"
        raise ReverieEvalError(f"{error}; {remedy}") from None
