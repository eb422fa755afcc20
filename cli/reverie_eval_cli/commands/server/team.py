"""``reverie-eval server team add|list|revoke FOLDER``."""

from pathlib import Path

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import actor, minute, now, print_list, reading, writing


@click.group(cls=Group)
def team() -> None:
    """Add and list teams, and revoke their tokens."""


@team.command()
@options.server_folder
@click.argument("name")
def add(*, folder: Path, name: str) -> None:
    """Add a team.

    Its people share a quota; the leaderboard shows its NAME.
    """
    from reverie_eval.server.service.people import add_team

    with writing(folder) as session:
        added = add_team(session, name, now=now(), actor=actor())
    print(f"team {added.name} added")


@team.command("list")
@options.server_folder
def list_teams(*, folder: Path) -> None:
    """List the teams."""
    from reverie_eval.server.service.people import all_teams

    with reading(folder) as session:
        rows = [
            (
                each.name,
                minute(each.created_at),
                ", ".join(sorted(person.name for person in each.people)),
            )
            for each in all_teams(session)
        ]
    print_list(("team", "since (UTC)", "people"), rows)


@team.command()
@options.server_folder
@click.argument("name")
def revoke(*, folder: Path, name: str) -> None:
    """Revoke all tokens and invitations of a team.

    Its people and results stay.
    """
    from reverie_eval.server.service.people import revoke_all, team_named

    with writing(folder) as session:
        people = team_named(session, name).people
        revoked = revoke_all(session, people, now=now(), actor=actor())
    print(f"{name}: {count_text(len(revoked), 'token')} revoked")
