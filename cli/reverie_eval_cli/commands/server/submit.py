"""``reverie-eval server submit FOLDER FILE``: score files that people sent to the organiser."""

from datetime import datetime
from pathlib import Path

import click

from reverie_eval.schemas.organising import EmailedFile
from reverie_eval.submissions import find_files
from reverie_eval_cli import options
from reverie_eval_cli.commands.submit import MethodOptions, method_options
from reverie_eval_cli.organising import Folder, actor, server_folder
from reverie_eval_cli.output import note
from reverie_eval_cli.receipts import keep_receipts


@click.command()
@server_folder
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
    folder: Folder,
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
    from reverie_eval.server.errors import RequestError

    file = options.checked(
        EmailedFile, split=split, team=team, person=person, received_at=received, publish=publish
    )
    chosen = list(map(Path, find_files([str(files)])))
    # All are described before the first is scored, so that a wrong option leaves nothing half done.
    described = [method.method(str(path)) for path in chosen]
    failed = False
    with folder.open() as state:
        for number, (path, each) in enumerate(zip(chosen, described, strict=True)):
            try:
                report = state.emailed_files.submit(
                    actor(), file, path.name, path.read_bytes(), each
                )
            except RequestError as refusal:
                # Without a text for the sender, the refusal is about the command, not about the
                # file.
                if refusal.reply is None:
                    raise
                failed, reply = True, refusal.reply
            else:
                reply = report.reply
                for receipt in keep_receipts(report.submission, None, str(path)):
                    note(f"attach {receipt}")
            print(*(["", "-" * 72, ""] if number else []), reply, sep="\n")
    return 1 if failed else 0
