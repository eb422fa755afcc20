"""The evaluation server a command talks to, and where its receipts are kept."""

import errno
import itertools
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from reverie_eval import ReverieEvalError
from reverie_eval.schemas.wire import SERVER_VARIABLE, TOKEN_VARIABLE
from reverie_eval.submissions import RECEIPT_ENDING
from reverie_eval_cli.options import grouped
from reverie_eval_cli.output import say

if TYPE_CHECKING:
    from reverie_eval.client import Client
    from reverie_eval.client.sending import Notice
    from reverie_eval.schemas.service import Envelope, ScoredSubmission


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
                # The server advises to sign in, which would not help while the variable is set.
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
        say(f"{client.url}: {printable(banner)}")


def check_receipt_path(given: str | None, sha256: str, split: str) -> None:
    """Make sure, before a submission is used, that its receipt can be written.

    The folder has to be there, and no other file of its name.
    """
    if given is None:
        return
    path = Path(given)
    if not path.parent.is_dir():
        raise ReverieEvalError(
            f"{path.parent} is not a folder; the receipt cannot be written there"
        )
    # Looked at before anything is sent: a submission may be used up only if its receipt can be
    # kept.
    if path.exists():
        there = _fields_in(path)
        # A receipt of this very file and split may be written again; anything else is somebody's
        # file.
        if (there.get("sha256"), there.get("split")) != (sha256, split):
            raise ReverieEvalError(f"{given} already exists; choose another file for the receipt")


def keep_receipts(report: "ScoredSubmission", given: str | None, submission: str) -> Sequence[Path]:
    """Write the receipts of a submission, unless they have been written before; return their paths.

    Those of other leaderboards are beside the first, with the leaderboard in their names.
    """
    base = submission if submission != "-" else f"submission-{_letters(report.id)}"
    own = _keep(report.receipt, [Path(given)] if given else _names(base))
    others = (
        _keep(result.receipt, _names(f"{given or base}.{_letters(name)}"))
        for name, result in report.boards.items()
    )
    return [own, *others]


def _keep(receipt: "Envelope", candidates: Iterable[Path]) -> Path:
    """Write a receipt to the first file name that has no other file."""
    path = Path()
    for path in candidates:
        try:
            # "x" fails if the file exists: two commands at once cannot take one name.
            with path.open("x", encoding="utf-8") as file:
                file.write(receipt.model_dump_json(indent=2) + "\n")
        except FileExistsError:
            # The same submission sent again: its receipt is there already.
            if _envelope_in(path) == receipt:
                return path
        else:
            return path
    raise FileExistsError(errno.EEXIST, "already exists", str(path))


def read_signed(path: Path) -> "Envelope":
    """Read a receipt, or a snapshot of a leaderboard."""
    from pydantic import ValidationError

    from reverie_eval.schemas.service import Envelope

    try:
        # A newer version may put more beside what is signed.
        return Envelope.model_validate_json(path.read_bytes(), extra="ignore")
    except ValidationError:
        raise ReverieEvalError(f"{path} is not a receipt or a snapshot of a server") from None


def _envelope_in(path: Path) -> "Envelope | None":
    try:
        return read_signed(path)
    except (ReverieEvalError, OSError):
        return None


def _fields_in(path: Path) -> Mapping[str, Any]:
    """Return the fields of the receipt in a file; empty if it has none."""
    from reverie_eval.receipts import read

    envelope = _envelope_in(path)
    return {} if envelope is None else read(envelope).fields


def _letters(name: str) -> str:
    """Return what is safe in the name of a file; the name comes from the server."""
    return "".join(letter for letter in name if letter.isalnum() or letter in "-_")


def _names(base: str) -> Iterator[Path]:
    """Return ``FILE.receipt.json``, then names with a number, for when it is taken."""
    yield Path(f"{base}{RECEIPT_ENDING}")
    for number in itertools.count(2):
        yield Path(f"{base}.{number}{RECEIPT_ENDING}")
