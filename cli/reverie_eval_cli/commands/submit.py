"""``reverie-eval submit FILE --split SPLIT --server URL``: send a submission to be scored."""

import hashlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval import GroundTruth, ReverieEvalError, SubmissionError, validate
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.text import did_you_mean, printable
from reverie_eval_cli import options
from reverie_eval_cli.commands.submissions import problems_json
from reverie_eval_cli.methods import MethodOptions, method_options
from reverie_eval_cli.output import rejection, show, transfer_bar
from reverie_eval_cli.receipts import check_receipt_path, keep_receipt
from reverie_eval_cli.servers import ServerOptions, print_banner, server_options

if TYPE_CHECKING:
    from reverie_eval.client import Client
    from reverie_eval.schemas.service import Accepted, SplitReport, SubmissionChange

_AGAIN = "send the same file again, which uses no submission,"


@click.command()
@options.submission
@options.split
@server_options
@method_options
@click.option("--publish", is_flag=True, help="Put the result on the leaderboard at once.")
@click.option(
    "--receipt",
    metavar="FILE",
    help="Where to write the receipt.  [default: SUBMISSION.receipt.json]",
)
@options.layout("text", "json", explained=" json is the server's reply, or all problems found.")
def submit(
    *,
    submission: str,
    split: str,
    server: ServerOptions,
    method: MethodOptions,
    publish: bool,
    receipt: str | None,
    layout: str,
) -> int:
    """Send a submission to be scored, and keep the receipt.

    The file is checked here first if a bundle of the split is at hand. Sending the same file again
    uses no submission and returns the same result.

    Exit status: 0 scored and everything done, 1 submission rejected, 2 something could not be
    done; a result is shown in any case.
    """
    token = server.token()
    described = method.method(submission)  # wrong options are reported before anything is sent
    try:
        content = _content(submission)
        check_receipt_path(receipt, hashlib.sha256(content).hexdigest(), split)
        with server.explaining_refused_token(), server.connect(token, _warn) as client:
            print_banner(client)
            _check(client, _split(client, split), content)
            try:
                with transfer_bar(f"sending to {client.url}") as progress:
                    accepted = client.submit(split, content, described, progress)
            except KeyboardInterrupt:
                raise ReverieEvalError(
                    f"interrupted; it may have been scored: {_AGAIN} to see its result"
                ) from None
            kept = _keep(accepted, receipt, submission)
            changed = _change(client, accepted, _wanted(accepted, method, submission, publish))
    except SubmissionError as error:
        if layout == "text":
            _warn(f"{rejection(submission, error)}\nnothing was scored, and no submission used")
        else:
            print(problems_json(split, error))
        return 1
    final = changed or accepted
    if layout == "json":
        print(final.model_dump_json(indent=2, ensure_ascii=True))
    else:
        _show(final, server.url, kept)
    return 0 if kept and changed else 2


def _warn(line: str) -> None:
    print(line, file=sys.stderr)


def _content(submission: str) -> bytes:
    from reverie_eval.submissions import read_bytes

    return read_bytes(submission)


def _split(client: "Client", name: str) -> "SplitReport":
    splits = {split.name: split for split in client.splits()}
    if name not in splits:
        known = printable(did_you_mean(name, splits))
        raise ReverieEvalError(f"{client.url} has no split {name!r}{known}")
    return splits[name]


def _check(client: "Client", split: "SplitReport", content: bytes) -> None:
    """Find all problems here or, without the server's ground truth, let the server find them."""
    truth = _same_ground_truth(split)
    if truth is not None:
        validate(content, split=split.name, ground_truth=truth)
    else:
        _warn(f"no bundle here matches the server's {split.name}; the server checks the file")
        client.validate(split.name, content)


def _same_ground_truth(split: "SplitReport") -> GroundTruth | None:
    try:
        truth = find_ground_truth(None, split.name)
    except (ReverieEvalError, OSError):
        return None
    is_same = truth.fingerprint in (split.fingerprint, split.public_fingerprint)
    return truth if is_same else None


def _keep(accepted: "Accepted", receipt: str | None, submission: str) -> Path | None:
    """Write the receipt; the result is shown whether or not that succeeds."""
    try:
        return keep_receipt(accepted.submission.receipt, receipt, submission)
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}"
        _warn(f"scored, but the receipt could not be written ({reason}); {_AGAIN} with --receipt")
        return None


def _wanted(
    accepted: "Accepted",
    method: MethodOptions,
    submission: str,
    publish: bool,  # noqa: FBT001  # an option's value
) -> "SubmissionChange":
    """Return what was asked for and differs from what the server has."""
    from reverie_eval.schemas.service import SubmissionChange

    asked: dict[str, object] = {}
    if changes := method.changes(accepted.submission.method, submission):
        asked["method"] = changes
    if publish and accepted.submission.status != "published":
        asked["published"] = True
    return SubmissionChange.model_validate(asked)


def _change(
    client: "Client", accepted: "Accepted", change: "SubmissionChange"
) -> "Accepted | None":
    """Publish the result or change its description; the result is shown in any case."""
    from reverie_eval.client import ServiceError

    if not change.model_fields_set:
        return accepted
    try:
        submission = client.change(accepted.submission.id, change)
    except ServiceError as error:
        undone = "published" if change.published else "changed"
        _warn(f"scored, but not {undone}: {error}; {_AGAIN} with the same options")
        return None
    return accepted.model_copy(update={"submission": submission})


def _show(accepted: "Accepted", server: str, kept: Path | None) -> None:
    from reverie_eval.reporting._submission import quota_lines, submission_lines, submission_table
    from reverie_eval.reporting._table import print_table

    submission = accepted.submission
    table = submission_table(submission.report, server)
    show(table.to_text, None, lambda console: print_table(console, table, table.stacked()))
    print(
        "",
        *submission_lines(submission, is_repeat=accepted.is_repeat),
        *([f"receipt: {kept}"] if kept else []),
        *quota_lines(accepted.quota, submission.split),
        sep="\n",
    )
