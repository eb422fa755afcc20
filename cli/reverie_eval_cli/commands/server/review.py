"""``reverie-eval server submissions FOLDER`` and ``review add|list|lift FOLDER``."""

from typing import TYPE_CHECKING, get_args

import click

from reverie_eval.schemas.organising import NewReview
from reverie_eval.schemas.service import Verdict
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, minute, print_list, server_folder

if TYPE_CHECKING:
    from reverie_eval.server.store.tables import Submission


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
