"""``reverie-eval verify RECEIPT``: check that a result is what a server signed."""

import hashlib
import sys
from pathlib import Path

import click

from reverie_eval import ReverieEvalError
from reverie_eval_cli import options
from reverie_eval_cli.servers import ServerOptions, server_options


@click.command()
@click.argument("receipt", type=options.PATH)
@server_options
@click.option(
    "--key", metavar="FILE", type=options.PATH, help="The server's public key, in PEM form."
)
@click.option(
    "--submission", metavar="FILE", help="Also check that this is the file that was scored."
)
def verify(
    *, receipt: Path, server: ServerOptions, key: Path | None, submission: str | None
) -> int:
    """Check that a receipt, or a snapshot of a leaderboard, was signed by a server.

    RECEIPT is what `reverie-eval submit` wrote, or a snapshot's JSON.

    Exit status: 0 genuine, 1 not genuine, 2 usage or system error.
    """
    from reverie_eval.receipts import NotGenuineError
    from reverie_eval.receipts import verify as verify_signature
    from reverie_eval.reporting._submission import receipt_lines, snapshot_lines
    from reverie_eval.schemas.service import Snapshot
    from reverie_eval.submissions import read_bytes
    from reverie_eval_cli.receipts import read_signed

    if key is not None and server.named:
        raise click.UsageError("give --key or --server, not both")
    signed = read_signed(receipt)
    if submission and isinstance(signed, Snapshot):
        raise click.UsageError("--submission is for receipts; a snapshot has many submissions")
    public_key, owner = _public_key(server, key)
    try:
        verify_signature(signed, public_key)
    except NotGenuineError as error:
        print(f"{receipt}: not genuine by the key of {owner}: {error}", file=sys.stderr)
        return 1
    genuine = f"{receipt}: genuine, signed with the key of {owner} ({signed.key_id})"
    if isinstance(signed, Snapshot):
        print(genuine, *snapshot_lines(signed), sep="\n")
        return 0
    if submission and hashlib.sha256(read_bytes(submission)).hexdigest() != signed.sha256:
        print(f"{submission}: not the file that the receipt is for", file=sys.stderr)
        return 1
    print(genuine, *receipt_lines(signed), sep="\n")
    if submission:
        print(f"{submission}: the file that was scored")
    return 0


def _public_key(server: ServerOptions, key: Path | None) -> tuple[str, str]:
    """Return the public key, and whose it is."""
    if key is None:
        with server.connect() as client:
            return client.key(), client.url
    try:
        return key.read_text(encoding="ascii"), str(key)
    except UnicodeDecodeError:
        raise ReverieEvalError(f"{key} is not a public key in PEM form") from None
