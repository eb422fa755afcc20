"""``reverie-eval verify RECEIPT``: check that a result is what a server signed."""

import hashlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval import ReverieEvalError
from reverie_eval_cli import options
from reverie_eval_cli.servers import ServerOptions, server_options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from reverie_eval.receipts import Signed
    from reverie_eval.schemas.service import KeyReport


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

    RECEIPT is what `reverie-eval submit` wrote, a receipt as an in-toto statement, or a snapshot's
    JSON.

    Exit status: 0 genuine, 1 not genuine, 2 usage or system error.
    """
    from reverie_eval.receipts import NotGenuineError, key_named_by, receipt_in
    from reverie_eval.reporting._submission import receipt_lines, snapshot_lines
    from reverie_eval.schemas.service import Envelope, Snapshot
    from reverie_eval.submissions import read_bytes
    from reverie_eval_cli.receipts import read_signed

    if key is not None and server.named:
        raise click.UsageError("give --key or --server, not both")
    signed = read_signed(receipt)
    if submission and isinstance(signed, Snapshot):
        raise click.UsageError("--submission is for receipts; a snapshot has many submissions")
    keys, owner = _keys(server, key)
    try:
        in_use = _verified(signed, keys)
    except NotGenuineError as error:
        print(f"{receipt}: not genuine by the keys of {owner}: {error}", file=sys.stderr)
        return 1
    genuine = f"{receipt}: genuine, signed with the key of {owner} ({key_named_by(signed)}{in_use})"
    if isinstance(signed, Snapshot):
        print(genuine, *snapshot_lines(signed), sep="\n")
        return 0
    if isinstance(signed, Envelope):
        signed = receipt_in(signed)
    if submission and hashlib.sha256(read_bytes(submission)).hexdigest() != signed.sha256:
        print(f"{submission}: not the file that the receipt is for", file=sys.stderr)
        return 1
    print(genuine, *receipt_lines(signed), sep="\n")
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
    if not content.lstrip().startswith(b"["):
        return content.decode(errors="replace"), str(file)
    try:
        return TypeAdapter(list[KeyReport]).validate_json(content, extra="ignore"), str(file)
    except ValidationError:
        raise ReverieEvalError(f"{file} is not a list of keys from /api/v1/keys") from None


def _verified(signed: "Signed", keys: "Sequence[KeyReport] | str") -> str:
    """Verify a receipt or a snapshot, and return when its key was in use, if that is known."""
    from reverie_eval.receipts import verify, verify_by_history

    if isinstance(keys, str):
        verify(signed, keys)
        return ""
    key = verify_by_history(signed, keys)
    since = f", in use from {key.valid_from:%Y-%m-%d}"
    return since if key.valid_until is None else f"{since} to {key.valid_until:%Y-%m-%d}"
