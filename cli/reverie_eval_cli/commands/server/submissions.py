"""``reverie-eval server submit|submissions|review``: files by e-mail, results and their reviews."""

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import click

from reverie_eval.schemas.organising import EmailedFile, NewReview
from reverie_eval.schemas.service import Verdict
from reverie_eval.submissions import find_files
from reverie_eval_cli import options
from reverie_eval_cli.commands.submit import MethodOptions, method_options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, actor, minute, print_list, server_folder
from reverie_eval_cli.output import note
from reverie_eval_cli.receipts import keep_receipts

if TYPE_CHECKING:
    from reverie_eval.server.store.tables import Submission


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


@click.command()
@server_folder
@click.option("--split", metavar="NAME", help="Only those to this split.")
@click.option("--team", metavar="NAME", help="Only those of this team.")
def submissions(*, folder: Folder, split: str | None, team: str | None) -> None:
    """List the submissions of all teams, the latest first."""
    from reverie_eval.server.service.people import team_named
    from reverie_eval.server.service.schedules import Schedules
    from reverie_eval.server.service.submissions import all_submissions

    with folder.reading() as session:
        if team is not None:
            team_named(session, team)
        rows = [_cells(row) for row in all_submissions(session, split=split, team=team)]
        if split is not None and not rows:  # the settings may not have it any more
            Schedules(folder.settings.splits).of(session, split)
    headings = ("submission", "received (UTC)", "split", "team", "person", "method", "status")
    print_list(headings, rows)


def _cells(row: "Submission") -> tuple[str, ...]:
    names = row.team.name, row.person.name, str(row.method["name"])
    return row.id, minute(row.received_at), row.split, *names, row.status


@click.group(cls=Group)
def review() -> None:
    """Review submissions: public verdicts on them, each with a reason."""


@review.command()
@server_folder
@click.argument("submission")
@click.argument("verdict", type=options.Choice(get_args(Verdict)))
@click.option("--reason", required=True, metavar="TEXT", help="The reason, which is public.")
def add(*, folder: Folder, submission: str, verdict: str, reason: str) -> None:
    """Review a submission.

    A disqualified result is shown separately, without a rank.
    """
    from reverie_eval.server.service.reviews import review as add_review

    new = options.checked(NewReview, submission_id=submission, verdict=verdict, reason=reason)
    with folder.acting() as transaction:
        added = add_review(transaction, new)
    print(f"review {added.id}: {submission} is {verdict}")


@review.command("list")
@server_folder
def list_all(*, folder: Folder) -> None:
    """List all reviews with their numbers, the latest first."""
    from reverie_eval.server.service.reviews import list_reviews

    known = folder.all_of(list_reviews)
    rows = [
        (
            *(str(each.id), minute(each.created_at), each.submission_id),
            *(each.verdict, each.reason, minute(each.lifted_at)),
        )
        for each in known
    ]
    print_list(("number", "made (UTC)", "submission", "verdict", "reason", "lifted (UTC)"), rows)


@review.command()
@server_folder
@click.argument("number", type=options.Number(1))
def lift(*, folder: Folder, number: int) -> None:
    """Lift a review."""
    from reverie_eval.server.service.reviews import lift_review

    with folder.acting() as transaction:
        lift_review(transaction, number)
    print(f"review {number} lifted")
