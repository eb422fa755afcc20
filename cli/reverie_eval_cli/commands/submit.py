"""``reverie-eval submit FILE --split SPLIT --server URL``: send a submission to be scored.

Exit status: 0 scored, and all done that was asked for; 1 the submission was rejected; 2 something
could not be done: what was scored nevertheless is shown.
"""

import argparse
import hashlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from reverie_eval import GroundTruth, ReverieEvalError, SubmissionError, validate
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval_cli.arguments import add_split, add_submission
from reverie_eval_cli.commands.validate import problems_as_json
from reverie_eval_cli.methods import add_method, amendments, method_of
from reverie_eval_cli.progress import transfer_bar
from reverie_eval_cli.receipts import check_place, keep
from reverie_eval_cli.servers import (
    add_server,
    connect,
    server_of,
    showing_token,
    tell_banner,
    token_for,
)
from reverie_eval_cli.submissions import rejection

if TYPE_CHECKING:
    from reverie_eval.client import Client
    from reverie_eval.schemas.service import Accepted, SplitReport, SubmissionChange

SUMMARY = "send a submission to an evaluation server, once, and keep its receipt"

_AGAIN = "send the same file again, which spends nothing,"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_submission(parser)
    add_split(parser)
    add_server(parser)
    add_method(parser)
    parser.add_argument(
        "--publish", action="store_true", help="put the result on the leaderboard at once"
    )
    parser.add_argument(
        "--receipt",
        metavar="FILE",
        help="where to write the receipt (default: SUBMISSION.receipt.json)",
    )
    parser.add_argument(
        "--format",
        choices=("text", "json"),
        default="text",
        help="json is the server's reply, or every problem that was found",
    )


def run(arguments: argparse.Namespace) -> int:
    """Check the submission, send it, and show what it scored."""
    server = server_of(arguments)
    token = token_for(server)
    method_of(arguments)  # whatever is wrong with the options is said before anything is read
    try:
        content = _content(arguments.submission)
        check_place(arguments.receipt, hashlib.sha256(content).hexdigest(), arguments.split)
        with showing_token(server), connect(arguments, token, _tell) as client:
            tell_banner(client)
            _check(client, _split(client, arguments.split), content)
            accepted = _sent(client, content, arguments)
            kept = _keep(accepted, arguments)
            changed = _changed(client, accepted, arguments)
    except SubmissionError as error:
        if arguments.format == "text":
            _tell(f"{rejection(arguments.submission, error)}\nnothing was scored or spent")
        else:
            print(problems_as_json(arguments.split, error))
        return 1
    if arguments.format == "json":
        print((changed or accepted).model_dump_json(indent=2, ensure_ascii=True))
    else:
        _show(changed or accepted, server, kept)
    return 0 if kept and changed else 2


def _tell(line: str) -> None:
    print(line, file=sys.stderr)


def _content(submission: str) -> bytes:
    from reverie_eval.submissions import read_bytes

    return read_bytes(submission)


def _split(client: "Client", name: str) -> "SplitReport":
    from reverie_eval.text import printable

    splits = {split.name: split for split in client.splits()}
    if name not in splits:
        known = printable(", ".join(splits))
        raise ReverieEvalError(f"{client.url} has no split {name!r}; it has {known}")
    return splits[name]


def _check(client: "Client", split: "SplitReport", content: bytes) -> None:
    """Find what is wrong here, or, where no ground truth fits, have the server find it."""
    truth = _fitting_truth(split)
    if truth is not None:
        validate(content, split=split.name, ground_truth=truth)
    else:
        _tell(f"no ground truth here is the server's for {split.name}; the server checks the file")
        client.validate(split.name, content)


def _fitting_truth(split: "SplitReport") -> GroundTruth | None:
    try:
        truth = find_ground_truth(None, split.name)
    except (ReverieEvalError, OSError):
        return None
    fits = truth.fingerprint in (split.fingerprint, split.public_fingerprint)
    return truth if fits else None


def _sent(client: "Client", content: bytes, arguments: argparse.Namespace) -> "Accepted":
    try:
        with transfer_bar(f"sending to {client.url}") as progress:
            return client.submit(arguments.split, content, method_of(arguments), progress)
    except KeyboardInterrupt:
        raise ReverieEvalError(
            f"interrupted; it may have been scored: {_AGAIN} to see its result"
        ) from None


def _keep(accepted: "Accepted", arguments: argparse.Namespace) -> Path | None:
    """Write the receipt; whether or not that succeeds, the result that is there is shown."""
    try:
        return keep(accepted.submission.receipt, arguments.receipt, arguments.submission)
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}"
        _tell(f"scored, but the receipt could not be written ({reason}); {_AGAIN} with --receipt")
        return None


def _changed(
    client: "Client", accepted: "Accepted", arguments: argparse.Namespace
) -> "Accepted | None":
    """Publish the result, or amend what was said of it before; the result is shown in any case."""
    from reverie_eval.client import ServiceError

    change = _change(accepted, arguments)
    if not change.model_fields_set:
        return accepted
    try:
        submission = client.change(accepted.submission.id, change)
    except ServiceError as error:
        undone = "published" if arguments.publish else "changed"
        _tell(f"scored, but not {undone}: {error}; {_AGAIN} with the same options")
        return None
    return accepted.model_copy(update={"submission": submission})


def _change(accepted: "Accepted", arguments: argparse.Namespace) -> "SubmissionChange":
    """Return what is asked for and is not so yet."""
    from reverie_eval.schemas.service import SubmissionChange

    submission = accepted.submission
    asked: dict[str, object] = {}
    if amended := amendments(submission.method, arguments):
        asked["method"] = amended
    if arguments.publish and submission.status != "published":
        asked["published"] = True
    return SubmissionChange.model_validate(asked)


def _show(accepted: "Accepted", server: str, kept: Path | None) -> None:
    from reverie_eval.reporting._service import quota_lines, submission_lines, table_of_submission
    from reverie_eval.reporting._tables import laid_out

    submission = accepted.submission
    table = table_of_submission(submission.report, server)
    if sys.stdout.isatty():
        from rich.console import Console

        from reverie_eval.reporting._terminal import show_table

        show_table(table, Console())
    else:
        print(laid_out(table))
    print(
        "",
        *submission_lines(submission, is_repeat=accepted.is_repeat),
        *([f"receipt: {kept}"] if kept else []),
        *quota_lines(accepted.quota, submission.split),
        sep="\n",
    )
