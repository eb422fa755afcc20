"""``reverie-eval server submit FOLDER FILE``: score files that people sent to the organiser."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval import ReverieEvalError, SubmissionError
from reverie_eval.submissions import find_files
from reverie_eval.text import printable, time_text
from reverie_eval_cli import options
from reverie_eval_cli.commands.submit import MethodOptions, method_options
from reverie_eval_cli.organising import actor
from reverie_eval_cli.receipts import keep_receipts

if TYPE_CHECKING:
    from reverie_eval.schemas.service import Accepted


@click.command()
@options.server_folder
@click.argument("files", metavar="FILE|FOLDER", type=click.Path(exists=True, path_type=Path))
@options.split
@click.option("--team", required=True, metavar="NAME", help="The team that sent it.")
@click.option("--person", required=True, metavar="NAME", help="The person who sent it.")
@click.option(
    "--received",
    required=True,
    type=options.Time(),
    help="When it came, with the time zone: 2027-06-01T12:00:00Z.",
)
@method_options
@click.option("--publish", is_flag=True, help="Put the result on the leaderboard at once.")
def submit(
    *,
    folder: Path,
    files: Path,
    split: str,
    team: str,
    person: str,
    received: datetime,
    method: MethodOptions,
    publish: bool,
) -> int:
    """Submit files that people sent to you, by e-mail for example.

    They are checked, scored and counted as if they had been uploaded when they were received, also
    while submissions are paused. The audit log names you. Prints a reply to each file, and writes
    its receipt beside it. Submitting a file again prints the same result, and uses no submission.

    Exit status: 0 all were scored, 1 some were refused, 2 usage or system error.
    """
    from reverie_eval.server.operations.behalf import delivery
    from reverie_eval.server.operations.checks import opened_server
    from reverie_eval.server.settings import load_settings

    chosen = list(map(Path, find_files([str(files)])))
    described = [method.method(str(path)) for path in chosen]
    failed = False
    with opened_server(load_settings(folder)) as state:
        sent = delivery(
            state, team=team, person=person, split=split, received=received, organiser=actor()
        )
        for number, (path, each) in enumerate(zip(chosen, described, strict=True)):
            opening = f"Your file {path.name}, received {time_text(received)}, was"
            try:
                accepted = sent.submit(path, each, publish=publish)
            except ReverieEvalError as error:
                failed = True
                lines = [f"{opening} not scored, and no submission was used.", "", _reason(error)]
            else:
                receipts = keep_receipts(accepted.submission, None, str(path))
                lines = [f"{opening} scored on {split}.", "", *_result(accepted, receipts)]
            print(*(["", "-" * 72, ""] if number else []), f"Dear {printable(team)},", "", sep="\n")
            print(*lines, sep="\n")
    return 1 if failed else 0


def _reason(error: ReverieEvalError) -> str:
    if isinstance(error, SubmissionError):
        return f"{error}\n\n`reverie-eval validate` finds the same problems before you send a file."
    return f"{error}"


def _result(accepted: "Accepted", receipts: Sequence[Path]) -> Iterator[str]:
    from reverie_eval.reporting._submission import quota_lines, result_tables, submission_lines

    submission = accepted.submission
    for further, table in result_tables(submission, submission.receipt.server).items():
        yield from [f"On the leaderboard {further}:"] if further else []
        yield table.to_text()
        yield ""
    yield from submission_lines(submission, is_repeat=accepted.is_repeat)
    yield from quota_lines(accepted.quota, submission.split)
    yield ""
    names = ", ".join(receipt.name for receipt in receipts)
    yield f"The signed {'receipt is' if len(receipts) == 1 else 'receipts are'} attached: {names}"
