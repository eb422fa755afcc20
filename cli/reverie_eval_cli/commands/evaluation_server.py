"""``reverie-eval login``, ``leaderboard`` and ``verify``: use an evaluation server.

A token comes from the keyboard, unseen, or from standard input; never as an argument, which
everybody on a machine can read.
"""

import hashlib
import os
import sys
from getpass import getpass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval import ReverieEvalError
from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.wire import TOKEN_VARIABLE
from reverie_eval.tasks import name_on_server
from reverie_eval.text import printable
from reverie_eval_cli import options
from reverie_eval_cli.output import note, show_printout
from reverie_eval_cli.servers import ServerOptions, print_banner, server_options

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from reverie_eval.client import RefusedError
    from reverie_eval.receipts import Reading
    from reverie_eval.schemas.service import Envelope, KeyReport


@click.command()
@server_options
def login(*, server: ServerOptions) -> None:
    """Sign in to a server with a token or an invitation.

    The token, or an invitation to exchange for one, is read from the keyboard or from standard
    input.
    """
    from reverie_eval.client.logins import Logins

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


_RANKED = [key for key, metric in CATALOGUE.items() if metric.better != "neither"]


@click.command()
@server_options
@click.option("--split", help="Whose leaderboard.  [default: the server's first split]")
@options.server_task
@click.option(
    "--board", default="", metavar="NAME", help="A leaderboard of the split besides the main one."
)
@click.option(
    "--metric",
    type=options.Choice(_RANKED),
    metavar="KEY",
    help=f"Rank by this metric: {', '.join(_RANKED)}.  [default: the leaderboard's primary one]",
)
@options.layout("table", "json", "csv")
@options.output("the leaderboard")
def leaderboard(
    *,
    server: ServerOptions,
    split: str | None,
    task: str,
    board: str,
    metric: str | None,
    layout: str,
    output: str | None,
) -> None:
    """Show a server's leaderboard."""
    from reverie_eval.reporting.service import leaderboard_parts
    from reverie_eval.reporting.tables import Printout

    with server.connect() as client:
        print_banner(client)
        if not split:
            splits = client.splits()
            # A new server, or one between two challenges.
            if not splits:
                raise ReverieEvalError(f"{client.url} has no split that accepts submissions")
            name = splits[0].name
        else:
            name = name_on_server(task, split)
        shown = Printout(
            lambda: leaderboard_parts(client.leaderboard(name, metric, board=board)),
            json=lambda: client.leaderboard(name, metric, board=board).model_dump_json(
                indent=2, ensure_ascii=True
            ),
            csv=lambda: "\n".join(
                map(printable, client.leaderboard_csv(name, metric, board=board).splitlines())
            ),
        )
        show_printout(shown, layout, output)


@click.command()
@click.argument("receipt", type=options.PATH)
@server_options
@click.option(
    "--key",
    metavar="FILE",
    type=options.PATH,
    help="The server's keys, as saved from /api/v1/keys, or one of them in PEM form.",
)
@click.option(
    "--submission", metavar="FILE", help="Also check that this is the file that was scored."
)
def verify(
    *, receipt: Path, server: ServerOptions, key: Path | None, submission: str | None
) -> int:
    """Check that a receipt, or a snapshot of a leaderboard, was signed by a server.

    RECEIPT is what `reverie-eval submit` wrote, or a snapshot's JSON. What a newer version signed
    is checked too, and shown as far as this version can read it.

    Exit status: 0 genuine, 1 not genuine, 2 usage or system error.
    """
    from reverie_eval.receipts import SNAPSHOT_TYPE, NotGenuineError, read
    from reverie_eval.submissions import read_bytes
    from reverie_eval_cli.servers import read_signed

    if key is not None and server.named:
        raise click.UsageError("give --key or --server, not both")
    envelope = read_signed(receipt)
    if submission and envelope.payload_type == SNAPSHOT_TYPE:
        raise click.UsageError("--submission is for receipts; a snapshot has many submissions")
    keys, owner = _keys(server, key)
    try:
        used = _verified(envelope, keys)
    except NotGenuineError as error:
        print(f"{receipt}: not genuine by the keys of {owner}: {error}", file=sys.stderr)
        return 1
    reading = read(envelope)
    if submission:
        scored = reading.fields.get("sha256")
        if scored is None:
            raise ReverieEvalError(
                f"{receipt} is genuine, but this version cannot read which file it is for; update "
                "reverie-eval"
            )
        # Unpacked, as the server hashed it: a file and its gzip are the same submission.
        if hashlib.sha256(read_bytes(submission)).hexdigest() != scored:
            print(f"{submission}: not the file that the receipt is for", file=sys.stderr)
            return 1
    print(f"{receipt}: genuine, signed with the key of {owner} ({used})")
    print(*_lines(reading), sep="\n")
    if submission:
        print(f"{submission}: the file that was scored")
    return 0


def _keys(server: ServerOptions, file: Path | None) -> "tuple[Sequence[KeyReport] | str, str]":
    """Return the server's keys, or the only one as PEM, and whose they are."""
    from pydantic import TypeAdapter, ValidationError

    from reverie_eval.schemas.service import KeyReport

    if file is None:
        with server.connect() as client:
            return client.keys(), client.url
    content = file.read_bytes()
    # A file of keys is what the API lists, as JSON, or one key as PEM.
    if not content.lstrip().startswith(b"["):
        return content.decode(errors="replace"), str(file)
    try:
        # A newer server may say more about its keys.
        return TypeAdapter(list[KeyReport]).validate_json(content, extra="ignore"), str(file)
    except ValidationError:
        raise ReverieEvalError(f"{file} is not a list of keys from /api/v1/keys") from None


def _verified(envelope: "Envelope", keys: "Sequence[KeyReport] | str") -> str:
    """Verify a receipt or a snapshot; return its key, and when that was in use, if known."""
    from reverie_eval.receipts import verify, verify_by_history

    # A single key has no history, so when it was in use is not known.
    if isinstance(keys, str):
        return verify(envelope, keys)
    key = verify_by_history(envelope, keys)
    used = f"{key.key_id}, in use from {key.valid_from:%Y-%m-%d}"
    return used if key.valid_until is None else f"{used} to {key.valid_until:%Y-%m-%d}"


def _lines(reading: "Reading") -> "Iterator[str]":
    """Yield what a receipt or a snapshot proves, as far as this version can read it."""
    from reverie_eval.reporting.service import receipt_lines, snapshot_lines
    from reverie_eval.schemas.service import Receipt, Snapshot

    if not reading.is_complete:
        yield "made by a newer version of reverie-eval; update to read all of it"
    match reading.content:
        case Receipt() as receipt:
            yield from receipt_lines(receipt)
        case Snapshot() as snapshot:
            yield from snapshot_lines(snapshot)
        case None:
            for name, value in reading.fields.items():
                if isinstance(value, str | int):
                    yield printable(f"  {name}: {value}")
