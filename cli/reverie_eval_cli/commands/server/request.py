"""``reverie-eval server request list|accept|reject FOLDER``."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import acting, checked, minute, print_list, reading

if TYPE_CHECKING:
    from collections.abc import Sequence


@click.group(cls=Group)
def request() -> None:
    """List, accept and reject requests to join."""


@request.command("list")
@options.server_folder
def list_requests(*, folder: Path) -> None:
    """List the open requests, the earliest first."""
    from reverie_eval.server.service.joining import list_requests
    from reverie_eval.server.service.paging import all_pages

    with reading(folder) as session:
        known = list(all_pages(partial(list_requests, session)))
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
@options.server_folder
@click.argument("numbers", metavar="NUMBER...", type=options.Number(1), nargs=-1, required=True)
def accept(*, folder: Path, numbers: "Sequence[int]") -> None:
    """Add the people of requests to their teams.

    Prints an invitation for each person, as CSV. They cannot be shown again.
    """
    from reverie_eval.server.service.joining import accept_requests
    from reverie_eval.server.service.people_files import invitations_csv

    with acting(folder) as transaction:
        accepted = accept_requests(transaction, numbers)
    invitations = [each for one in accepted for each in one.invitations]
    print(invitations_csv(invitations), end="")
    added = count_text(len(invitations), "person", "people")
    print(f"{added} added to {', '.join(one.team for one in accepted)}", file=sys.stderr)


@request.command()
@options.server_folder
@click.argument("numbers", metavar="NUMBER...", type=options.Number(1), nargs=-1, required=True)
@click.option("--reason", default="", metavar="TEXT", help="The reason, for the audit log.")
def reject(*, folder: Path, numbers: "Sequence[int]", reason: str) -> None:
    """Reject requests to join.

    The personal data in them is deleted.
    """
    from reverie_eval.schemas.joining import Rejection
    from reverie_eval.server.service.joining import reject_requests

    rejection = checked(Rejection, reason=reason)
    with acting(folder) as transaction:
        reject_requests(transaction, numbers, rejection)
    print(f"{count_text(len(set(numbers)), 'request')} rejected")
