"""The evaluation server a command talks to: by option, environment variable or the latest login."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import click

from reverie_eval import ReverieEvalError
from reverie_eval.schemas.wire import SERVER_VARIABLE, TOKEN_VARIABLE
from reverie_eval_cli.options import grouped

if TYPE_CHECKING:
    from reverie_eval.client import Client
    from reverie_eval.client.sending import Notice


@dataclass
class ServerOptions:
    """What ``--server`` and ``--plain-http`` say."""

    named: str | None
    plain_http: bool

    @cached_property
    def url(self) -> str:
        """The server's URL; without a server that is named anywhere, an error asks for one."""
        from reverie_eval.client.logins import Logins
        from reverie_eval.client.sending import server_url

        # An option is meant for this command, a variable for this shell, a login for this machine.
        named = self.named or os.environ.get(SERVER_VARIABLE) or Logins.load().latest
        if not named:
            raise ReverieEvalError(f"which server? Name it with --server URL or {SERVER_VARIABLE}")
        return server_url(named)

    def connect(self, token: str | None = None, notice: "Notice | None" = None) -> "Client":
        """Return a client of the server."""
        from reverie_eval.client import Client

        return Client(self.url, token, notice, plain_http=self.plain_http)

    def token(self) -> str:
        """Return the token for the server; without one, an error says how to sign in."""
        from reverie_eval.client.logins import Logins

        # The variable first: scripts and CI have no login, and must not fall back on a person's.
        token = os.environ.get(TOKEN_VARIABLE) or Logins.load().tokens.get(self.url)
        if not token:
            raise ReverieEvalError(
                f"you are not signed in to {self.url}; run `reverie-eval login --server "
                f"{self.url}`, or set {TOKEN_VARIABLE} to your token"
            )
        return token

    @contextmanager
    def explaining_refused_token(self) -> Iterator[None]:
        """Add to a refusal where the refused token came from, and how to replace it."""
        from reverie_eval.client import RefusedError

        try:
            yield
        except RefusedError as error:
            if error.document.code != "not-signed-in":
                raise
            if os.environ.get(TOKEN_VARIABLE):
                reason, _, _ = str(error).partition("; ")
                raise ReverieEvalError(
                    f"{TOKEN_VARIABLE} is not a valid token ({reason}); correct it, or unset it to "
                    "use your login"
                ) from None
            remedy = f"run `reverie-eval login --server {self.url}` to enter another"
            raise ReverieEvalError(f"{error}; {remedy}") from None


server_options = grouped(
    "server",
    ServerOptions,
    click.option(
        "--server",
        "named",
        metavar="URL",
        help=f"The evaluation server.  [default: ${SERVER_VARIABLE}, or else the latest login]",
    ),
    click.option(
        "--plain-http",
        is_flag=True,
        help="Allow http:// to another machine, in a network that you trust.",
    ),
)


def print_banner(client: "Client") -> None:
    """Print the organiser's message to all participants, if there is one."""
    from reverie_eval.text import printable

    if banner := client.server().banner:
        print(f"{client.url}: {printable(banner)}", file=sys.stderr)
