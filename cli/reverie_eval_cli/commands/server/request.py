"""``reverie-eval server request list|accept|reject FOLDER``."""

import sys
from collections.abc import Sequence

import click

from reverie_eval.schemas.joining import Rejection
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, minute, print_list, server_folder


@click.group(cls=Group)
def request() -> None:
    """List, accept and reject requests to join."""


@request.command("list")
@server_folder
def list_requests(*, folder: Folder) -> None:
    """List the open requests, the earliest first."""
    from reverie_eval.server.service.joining import list_requests

    known = folder.all_of(list_requests)
    rows = [
        (
            str(each.id),
            each.team,
            "exists" if each.team_exists else "new",
            ", ".join(f"{person.name} <{person.email}>" for person in each.people),
            each.institution,
            each.purpose or "-",
            minute(each.created_at),
        )
        for each in known
    ]
    headings = ("number", "team", "team is", "people", "institution", "what for", "sent (UTC)")
    print_list(headings, rows)


@request.command()
@server_folder
@click.argument("numbers", metavar="NUMBER...", type=options.Number(1), nargs=-1, required=True)
def accept(*, folder: Folder, numbers: Sequence[int]) -> None:
    """Add the people of requests to their teams.

    Prints an invitation for each person, as CSV. They cannot be shown again.
    """
    from reverie_eval.server.service.joining import accept_requests
    from reverie_eval.server.service.people_files import invitations_csv

    with folder.acting() as transaction:
        accepted = accept_requests(transaction, numbers)
    invitations = [each for one in accepted for each in one.invitations]
    print(invitations_csv(invitations), end="")
    added = count_text(len(invitations), "person", "people")
    print(f"{added} added to {', '.join(one.team for one in accepted)}", file=sys.stderr)


@request.command()
@server_folder
@click.argument("numbers", metavar="NUMBER...", type=options.Number(1), nargs=-1, required=True)
@click.option("--reason", default="", metavar="TEXT", help="The reason, for the audit log.")
def reject(*, folder: Folder, numbers: Sequence[int], reason: str) -> None:
    """Reject requests to join.

    The personal data in them is deleted.
    """
    from reverie_eval.server.service.joining import reject_requests

    rejection = options.checked(Rejection, reason=reason)
    with folder.acting() as transaction:
        reject_requests(transaction, numbers, rejection)
    print(f"{count_text(len(set(numbers)), 'request')} rejected")
