"""``reverie-eval server person add|list|revoke FOLDER``."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import acting, checked, minute, print_list, reading

if TYPE_CHECKING:
    from reverie_eval.schemas.service import Role


@click.group(cls=Group)
def person() -> None:
    """Add and list people, and revoke their tokens."""


@person.command()
@options.server_folder
@click.argument("name")
@click.option("--team", required=True, help="Their team; add it first with `server team add`.")
@click.option(
    "--role",
    type=options.Choice(["participant", "organiser"]),
    default="participant",
    show_default=True,
    help="Organisers see the submissions of all teams.",
)
def add(*, folder: Path, name: str, team: str, role: "Role") -> None:
    """Add a person to a team.

    The team and the organisers see the NAME.
    """
    from reverie_eval.schemas.organising import NewPerson
    from reverie_eval.server.service.people import add_person

    new = checked(NewPerson, team=team, name=name, role=role)
    with acting(folder) as transaction:
        added = add_person(transaction, new)
    print(f"{added.role} {added.name} added to {team}")


@person.command("list")
@options.server_folder
def list_people(*, folder: Path) -> None:
    """List all people with team and role."""
    from reverie_eval.server.service import people
    from reverie_eval.server.service.paging import all_pages

    with reading(folder) as session:
        everybody = list(all_pages(partial(people.list_people, session)))
    rows = [(each.name, each.team, each.role, minute(each.created_at)) for each in everybody]
    print_list(("person", "team", "role", "since (UTC)"), rows)


@person.command()
@options.server_folder
@click.argument("name")
def revoke(*, folder: Path, name: str) -> None:
    """Revoke all tokens and invitations of a person.

    Their results stay.
    """
    from reverie_eval.server.service.tokens import revoke_tokens_of_person

    with acting(folder) as transaction:
        revoked = revoke_tokens_of_person(transaction, name)
    print(f"{name}: {count_text(len(revoked), 'token')} revoked")
