"""``reverie-eval login``, ``submit``, ``leaderboard``, ``verify``: use an evaluation server.

A token comes from the keyboard, unseen, or from standard input; never as an argument, which
everybody on a machine can read.
"""

import functools
import hashlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from getpass import getpass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

from reverie_eval import ReverieEvalError, SubmissionError, validate
from reverie_eval.ground_truth import find_ground_truth
from reverie_eval.logs import is_run
from reverie_eval.metrics import CATALOGUE
from reverie_eval.schemas.service import Method
from reverie_eval.schemas.wire import TOKEN_VARIABLE
from reverie_eval.tasks import name_on_server
from reverie_eval.text import did_you_mean, printable
from reverie_eval_cli import options
from reverie_eval_cli.commands.submissions import validation_json
from reverie_eval_cli.output import note, rejection, say, show_printout, show_table, transfer_bar
from reverie_eval_cli.servers import (
    ServerOptions,
    check_receipt_path,
    keep_receipts,
    print_banner,
    server_options,
)

if TYPE_CHECKING:
    from reverie_eval.client import Client, RefusedError
    from reverie_eval.receipts import Reading
    from reverie_eval.schemas.service import (
        Accepted,
        Envelope,
        KeyReport,
        ScoredSubmission,
        SplitReport,
    )


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
        raise ReverieEvalError(
            "no token given; enter the one that you were sent, or the invitation"
        )
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


# Sending a submission.

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
    say(line)


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


# Leaderboards and receipts.

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
        say(f"{receipt}: not genuine by the keys of {owner}: {error}")
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
            say(f"{submission}: not the file that the receipt is for")
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


def _lines(reading: "Reading") -> Iterator[str]:
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
