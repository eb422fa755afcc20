"""``reverie-eval submit FILE --split SPLIT --server URL``: send a submission to be scored."""

import functools
import hashlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

from reverie_eval import ReverieEvalError, SubmissionError, validate
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.logs import is_run
from reverie_eval.schemas.service import Method
from reverie_eval.tasks import name_on_server
from reverie_eval.text import did_you_mean, printable
from reverie_eval_cli import options
from reverie_eval_cli.commands.submissions import validation_json
from reverie_eval_cli.output import rejection, show_table, transfer_bar
from reverie_eval_cli.servers import (
    ServerOptions,
    check_receipt_path,
    keep_receipts,
    print_banner,
    server_options,
)

if TYPE_CHECKING:
    from reverie_eval.client import Client
    from reverie_eval.schemas.service import Accepted, ScoredSubmission, SplitReport

_AGAIN = "send the same file again, which uses no submission,"

_TEXTS = {
    "name": ("--method", "NAME", "Name of the method.  [default: the file's name]"),
    "description": ("--description", "TEXT", "A description in a few sentences."),
    "paper": ("--paper", "URL", "Where the paper is."),
    "code": ("--code", "URL", "Where the code is."),
}
_LONGEST_NAME = 100


@dataclass(frozen=True)
class MethodOptions:
    """The fields of a :class:`~reverie_eval.schemas.service.Method` that were given."""

    given: Mapping[str, Any]

    def method(self, submission: str) -> Method:
        """Return the method; if it has no name, it gets the file's."""
        # Standard input has no name to take.
        stem = "" if submission == "-" else Path(submission).name.partition(".")[0]
        name = printable(stem)[:_LONGEST_NAME].strip() or "unnamed"
        return options.checked(Method, _option_of, **{"name": name, **self.given})

    def changes(self, before: Method, submission: str) -> Mapping[str, Any]:
        """Return the fields that were given and differ from what the server has."""
        given = self.method(submission).model_dump(include=set(self.given))
        # A field that is the same already is not asked for: sending the file again stays without
        # effect.
        return {field: value for field, value in given.items() if value != getattr(before, field)}


def _option_of(field: str) -> str:
    return _TEXTS[field][0] if field in _TEXTS else f"--{field.replace('_', '-')}"


def method_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option for each field of a method; the command gets them as ``method``."""
    fields = Method.model_fields

    @functools.wraps(command)
    def with_method(**values: Any) -> Any:
        # None is not declared; False is declared not to be so. The server keeps the difference.
        given = {field: value for field in fields if (value := values.pop(field)) is not None}
        return command(method=MethodOptions(given), **values)

    added = [_option(field, about.annotation, about.description) for field, about in fields.items()]
    return options.together(*added)(with_method)


def _option(field: str, kind: Any, meaning: str | None) -> Callable[[Any], Any]:
    """Return the option for a field, by the type and the meaning that the API gives it."""
    name = _option_of(field)
    if field in _TEXTS:
        _, metavar, meaning = _TEXTS[field]
        return click.option(name, field, metavar=metavar, help=meaning)
    declared, _ = get_args(kind)  # or None
    if declared is bool:
        switch = f"{name}/--no-{name.removeprefix('--')}"
        return click.option(switch, field, default=None, help=meaning)
    if get_origin(declared) is Literal:
        return click.option(name, field, type=options.Choice(get_args(declared)), help=meaning)
    is_whole = get_args(declared)[0] is int
    number = options.Number(min=1) if is_whole else options.Decimal(min=0)
    return click.option(name, field, metavar="N" if is_whole else "X", type=number, help=meaning)


def with_card(method: MethodOptions, submission: str) -> MethodOptions:
    """Return what options say of a method and, for a run's folder, what its card says besides."""
    from reverie_eval.runner import read_card

    card = read_card(Path(submission)) if is_run(submission) else None
    if card is None or card.totals is None:
        return method
    totals, read = card.totals, set(card.totals.read)
    n_run = totals.ended + totals.cut_off
    # What the agent read decides, not what it was offered. With objects of annotators, it had
    # perfect perception, whatever else it saw.
    classes = {"solution": "other", "names": "objects", "boxes": "objects", "pictures": "views"}
    found = [each for part, each in classes.items() if part in read]
    used = {
        "actions_per_episode": totals.steps,
        "seconds_per_episode": totals.seconds,
        "input_tokens_per_episode": totals.input_tokens,
        "output_tokens_per_episode": totals.output_tokens,
        "money_per_episode": totals.money,
    }
    n_tried = n_run + totals.failed
    of_card = {
        "name": printable(card.identity.agent)[:_LONGEST_NAME],
        "input_class": (found or ["geometry"])[0],
        "sample_size": (n_run or None) if totals.filled else None,
        **{name: value / n_tried for name, value in used.items() if value is not None and n_tried},
    }
    return MethodOptions({**of_card, **method.given})


@click.command()
@options.submission
@options.split
@options.server_task
@server_options
@method_options
@click.option("--publish", is_flag=True, help="Put the result on the leaderboard at once.")
@click.option(
    "--show-episodes",
    is_flag=True,
    help="Let everyone replay the walks of an open split while the result is published.",
)
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
    task: str,
    server: ServerOptions,
    method: MethodOptions,
    publish: bool,
    show_episodes: bool,
    receipt: str | None,
    layout: str,
) -> int:
    """Send a submission to be scored, and keep the receipt.

    SUBMISSION is a result file, or the folder of a run: then what its `run.json` says of the agent,
    what it read, and what an episode cost is declared, too.

    The file is checked here first if a bundle of the split is at hand. Sending the same file again
    uses no submission and returns the same result. Properties of the method that no option names
    are not declared, which is not a no.

    Exit status: 0 scored and everything done, 1 submission rejected, 2 something could not be
    done; a result is shown in any case.
    """
    from reverie_eval.submissions import read_bytes

    # Everything that can be wrong on this side is looked at before anything is sent.
    token, name = server.token(), name_on_server(task, split)
    method = with_card(method, submission)
    described = method.method(submission)  # wrong options are reported before anything is sent
    try:
        content = read_bytes(submission)
        check_receipt_path(receipt, hashlib.sha256(content).hexdigest(), name)
        with server.explaining_refused_token(), server.connect(token, _warn) as client:
            print_banner(client)
            _check(client, _split(client, name), split, content)
            try:
                with transfer_bar(f"sending to {client.url}") as progress:
                    accepted = client.submit(name, content, described, progress)
            except KeyboardInterrupt:
                raise ReverieEvalError(
                    f"interrupted; it may have been scored: {_AGAIN} to see its result"
                ) from None
            kept = _keep(accepted, receipt, submission)
            asked = _asked(
                accepted.submission, method, submission, publish=publish, show=show_episodes
            )
            changed = _change(client, accepted, asked)
    except SubmissionError as error:
        if layout == "text":
            _warn(f"{rejection(submission, error)}\nnothing was scored, and no submission used")
        else:
            print(validation_json(split, error.problems))
        return 1
    final = changed or accepted
    # As the server replied, for scripts; receipts are on disk in either case.
    if layout == "json":
        print(final.model_dump_json(indent=2, ensure_ascii=True))
    else:
        _show(final, server.url, kept)
    # The result is there in any case; only the exit status says that something beside it failed.
    return 0 if kept and changed else 2


def _warn(line: str) -> None:
    print(line, file=sys.stderr)


def _split(client: "Client", name: str) -> "SplitReport":
    splits = {split.name: split for split in client.splits()}
    # Before the file is sent: a wrong name should not cost an upload.
    if name not in splits:
        known = printable(did_you_mean(name, splits))
        raise ReverieEvalError(f"{client.url} has no split {name!r}{known}")
    return splits[name]


def _check(client: "Client", split: "SplitReport", own_name: str, content: bytes) -> None:
    """Find all problems here or, without the server's ground truth, let the server find them.

    ``own_name`` is the split's name among those of its task.
    """
    try:
        truth = find_ground_truth(None, own_name, split.task)
    except (ReverieEvalError, OSError):
        # Whatever is wrong with a bundle here, the server has its own.
        truth = None
    # The fingerprint tells whether the bundle here is the server's: another version would find
    # other problems.
    if truth and truth.fingerprint in (split.fingerprint, split.public_fingerprint):
        validate(content, split=own_name, ground_truth=truth, track=split.track)
    else:
        _warn(f"no bundle here matches the server's {split.name}; the server checks the file")
        client.validate(split.name, content)


def _keep(accepted: "Accepted", receipt: str | None, submission: str) -> Sequence[Path]:
    """Write the receipts; the result is shown whether or not that succeeds."""
    try:
        return keep_receipts(accepted.submission, receipt, submission)
    except OSError as error:
        # The result is there already; a full disk must not hide it.
        reason = f"{error.filename}: {error.strerror}"
        _warn(f"scored, but the receipt could not be written ({reason}); {_AGAIN} with --receipt")
        return ()


def _asked(
    before: "ScoredSubmission", method: MethodOptions, submission: str, *, publish: bool, show: bool
) -> Mapping[str, Any]:
    """Return the changes that the options ask for and the server does not have yet."""
    asked: dict[str, Any] = {}
    if changes := method.changes(before.method, submission):
        asked["method"] = changes
    # Sent again, a file that is published already changes nothing.
    if publish and before.status != "published":
        asked["published"] = True
    if show and not before.shows_episodes:
        asked["shows_episodes"] = True
    return asked


def _change(client: "Client", accepted: "Accepted", asked: Mapping[str, Any]) -> "Accepted | None":
    """Publish the result and change its description; it is shown in any case."""
    from reverie_eval.client import ServiceError
    from reverie_eval.schemas.service import SubmissionChange

    if not asked:
        return accepted
    try:
        submission = client.change(accepted.submission.id, SubmissionChange.model_validate(asked))
    except ServiceError as error:
        undone = "published" if "published" in asked else "changed"
        _warn(f"scored, but not {undone}: {error}; {_AGAIN} with the same options")
        return None
    # What the upload ignored because the file was known is no longer ignored once it is changed.
    ignored = [name for name in accepted.ignored if name not in asked.get("method", ())]
    return accepted.model_copy(update={"submission": submission, "ignored": ignored})


def _show(accepted: "Accepted", server: str, kept: Sequence[Path]) -> None:
    from reverie_eval.reporting.service import quota_lines, result_tables, submission_lines

    submission = accepted.submission
    for name, table in result_tables(submission, server).items():
        if name:
            print(f"\n{printable(name)}")
        show_table(replace(table, narrow=table.stacked()))
    print(
        "",
        *submission_lines(
            accepted,
            to_publish="submit it again with --publish, which does not use a submission",
            to_change="options such as --method change it, which uses no submission",
        ),
        *map("receipt: {}".format, kept),
        *quota_lines(accepted.quota, submission.split),
        sep="\n",
    )
