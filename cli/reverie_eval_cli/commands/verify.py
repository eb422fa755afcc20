"""``reverie-eval verify RECEIPT``: whether a result is what a server signed.

Exit status: 0 genuine, 1 not, 2 it could not be tried.
"""

import argparse
import hashlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from reverie_eval import ReverieEvalError
from reverie_eval_cli.servers import add_server, connect

if TYPE_CHECKING:
    from reverie_eval.schemas.service import Receipt

SUMMARY = "check a receipt against the key of the server that signed it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument("receipt", type=Path, help="as `reverie-eval submit` wrote it")
    named = add_server(parser)
    named.add_argument(
        "--key", metavar="FILE", type=Path, help="the server's public key, in PEM form"
    )
    parser.add_argument(
        "--submission", metavar="FILE", help="also check that this is the file that was scored"
    )


def run(arguments: argparse.Namespace) -> int:
    """Say whether the receipt is genuine, and what it proves."""
    from reverie_eval.receipts import NotGenuineError, verify
    from reverie_eval.reporting._service import receipt_lines
    from reverie_eval_cli.receipts import read_receipt

    receipt = read_receipt(arguments.receipt)
    key, owner = _key(arguments)
    try:
        verify(receipt, key)
    except NotGenuineError as error:
        print(f"{arguments.receipt}: not genuine by the key of {owner}: {error}", file=sys.stderr)
        return 1
    if arguments.submission and not _is_of(receipt, arguments.submission):
        print(f"{arguments.submission}: not the file that the receipt is for", file=sys.stderr)
        return 1
    print(f"{arguments.receipt}: genuine, signed with the key of {owner} ({receipt.key_id})")
    print(*receipt_lines(receipt), sep="\n")
    if arguments.submission:
        print(f"{arguments.submission}: the file that was scored")
    return 0


def _key(arguments: argparse.Namespace) -> tuple[str, str]:
    """Return the public key, and whose it is."""
    if arguments.key is None:
        with connect(arguments) as client:
            return client.key(), client.url
    try:
        return arguments.key.read_text(encoding="ascii"), str(arguments.key)
    except UnicodeDecodeError:
        raise ReverieEvalError(f"{arguments.key} is no public key in PEM form") from None


def _is_of(receipt: "Receipt", submission: str) -> bool:
    from reverie_eval.submissions import read_bytes

    return hashlib.sha256(read_bytes(submission)).hexdigest() == receipt.sha256
