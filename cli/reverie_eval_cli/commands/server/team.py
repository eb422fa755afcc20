"""``reverie-eval server team add|rename|merge|list|revoke FOLDER``."""

from functools import partial
from pathlib import Path

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import acting, checked, minute, print_list, reading, revoking


@click.group(cls=Group)
def team() -> None:
    """Add, rename, merge and list teams, and revoke their tokens."""


@team.command()
@options.server_folder
@click.argument("name")
def add(*, folder: Path, name: str) -> None:
    """Add a team.

    Its people share a quota; the leaderboard shows its NAME.
    """
    from reverie_eval.schemas.organising import NewTeam
    from reverie_eval.server.service.people import add_team

    new = checked(NewTeam, name=name)
    with acting(folder) as transaction:
        added = add_team(transaction, new)
    print(f"team {added.name} added")


@team.command()
@options.server_folder
@click.argument("name")
@click.argument("new_name")
def rename(*, folder: Path, name: str, new_name: str) -> None:
    """Rename a team.

    Its receipts keep the NAME under which they were signed.
    """
    from reverie_eval.schemas.organising import NewTeam
    from reverie_eval.server.service.people import rename_team

    new = checked(NewTeam, name=new_name)
    with acting(folder) as transaction:
        renamed = rename_team(transaction, name, new)
    print(f"team {name} renamed to {renamed.name}")


@team.command()
@options.server_folder
@click.argument("name")
@click.argument("into")
def merge(*, folder: Path, name: str, into: str) -> None:
    """Give a team's people, submissions and grants to another.

    Quotas count the submissions of both, as if the team INTO had always been one. This cannot be
    undone, except from a backup. Receipts keep the NAME under which they were signed.
    """
    from reverie_eval.schemas.organising import NewMerge
    from reverie_eval.server.service.merging import merge_teams

    new = checked(NewMerge, team=name, into=into)
    with acting(folder) as transaction:
        report = merge_teams(transaction, new)
    people = count_text(report.people, "person", "people")
    submissions = count_text(report.submissions, "submission")
    print(f"{people} and {submissions} of {name} moved to {into}")
    if report.repeats:
        print(f"{count_text(report.repeats, 'file')} had been submitted by both")


@team.command("list")
@options.server_folder
def list_teams(*, folder: Path) -> None:
    """List the teams."""
    from reverie_eval.server.service import people
    from reverie_eval.server.service.paging import all_pages

    with reading(folder) as session:
        teams = list(all_pages(partial(people.list_teams, session)))
    rows = [(each.name, minute(each.created_at), ", ".join(each.people)) for each in teams]
    print_list(("team", "since (UTC)", "people"), rows)


@team.command()
@options.server_folder
@click.argument("name")
def revoke(*, folder: Path, name: str) -> None:
    """Revoke all tokens and invitations of a team.

    Its people and results stay.
    """
    from reverie_eval.server.service.tokens import revoke_tokens_of_team

    with revoking(folder) as transaction:
        revoked = revoke_tokens_of_team(transaction, name)
    print(f"{name}: {count_text(len(revoked), 'token')} revoked")
