"""``reverie-eval server team add|rename|merge|list|revoke FOLDER``, and ``server grant``."""

import click

from reverie_eval.schemas.organising import MOST_EXTRA, NewGrant, NewMerge, NewTeam
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, after, minute, print_list, server_folder


@click.group(cls=Group)
def team() -> None:
    """Add, rename, merge and list teams, and revoke their tokens."""


@team.command()
@server_folder
@click.argument("name")
def add(*, folder: Folder, name: str) -> None:
    """Add a team.

    Its people share a quota; the leaderboard shows its NAME.
    """
    from reverie_eval.server.service.people import add_team

    new = options.checked(NewTeam, name=name)
    with folder.acting() as transaction:
        added = add_team(transaction, new)
    print(f"team {added.name} added")


@team.command()
@server_folder
@click.argument("name")
@click.argument("new_name")
def rename(*, folder: Folder, name: str, new_name: str) -> None:
    """Rename a team.

    Its receipts keep the NAME under which they were signed.
    """
    from reverie_eval.server.service.people import rename_team

    new = options.checked(NewTeam, name=new_name)
    with folder.acting() as transaction:
        renamed = rename_team(transaction, name, new)
    print(f"team {name} renamed to {renamed.name}")


@team.command()
@server_folder
@click.argument("name")
@click.argument("into")
def merge(*, folder: Folder, name: str, into: str) -> None:
    """Give a team's people, submissions and grants to another.

    Quotas count the submissions of both, as if the team INTO had always been one. This cannot be
    undone, except from a backup. Receipts keep the NAME under which they were signed.
    """
    from reverie_eval.server.service.merging import merge_teams

    new = options.checked(NewMerge, team=name, into=into)
    with folder.acting() as transaction:
        report = merge_teams(transaction, new)
    people = count_text(report.people, "person", "people")
    submissions = count_text(report.submissions, "submission")
    print(f"{people} and {submissions} of {name} moved to {into}")
    if report.repeats:
        print(f"{count_text(report.repeats, 'file')} had been submitted by both")


@team.command("list")
@server_folder
def list_teams(*, folder: Folder) -> None:
    """List the teams."""
    from reverie_eval.server.service import people

    teams = folder.all_of(people.list_teams)
    rows = [
        (each.name, str(each.id), minute(each.created_at), ", ".join(each.people)) for each in teams
    ]
    print_list(("team", "number", "since (UTC)", "people"), rows)


@team.command()
@server_folder
@click.argument("name")
def revoke(*, folder: Folder, name: str) -> None:
    """Revoke all tokens and invitations of a team.

    Its people and results stay.
    """
    from reverie_eval.server.service.tokens import revoke_tokens_of_team

    with folder.revoking() as transaction:
        revoked = revoke_tokens_of_team(transaction, name)
    print(f"{name}: {count_text(len(revoked), 'token')} revoked")


@click.command()
@server_folder
@click.argument("team")
@click.argument("split")
@click.argument("number", type=options.Number(1, MOST_EXTRA))
@click.option("--reason", required=True, metavar="TEXT", help="The reason, for the audit log.")
@options.days
def grant(*, folder: Folder, team: str, split: str, number: int, reason: str, days: int) -> None:
    """Grant a team extra submissions.

    Each of the team's limits on a split is raised by NUMBER.
    """
    from reverie_eval.server.service import quotas

    splits = folder.settings.splits
    ends = after(days)
    new = options.checked(
        NewGrant, team=team, split=split, extra=number, reason=reason, expires_at=ends
    )
    with folder.acting() as transaction:
        quotas.grant(transaction, new, splits)
    extra = count_text(number, "extra submission")
    print(f"{team}: {extra} to {split} until {minute(ends)} UTC")
