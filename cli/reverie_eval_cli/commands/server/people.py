"""``reverie-eval server team|person|request COMMAND``, and ``server grant``: who takes part."""

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import click

from reverie_eval.schemas.organising import (
    MOST_EXTRA,
    NewGrant,
    NewMerge,
    NewPerson,
    NewTeam,
    PersonChange,
)
from reverie_eval.schemas.people import NewPeopleImport, Rejection
from reverie_eval.schemas.service import Role
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import (
    Folder,
    after,
    confirm,
    lasting,
    minute,
    of_team,
    print_list,
    read_text,
    server_folder,
    without_asking,
)
from reverie_eval_cli.output import note, say


@click.group(cls=Group)
def team() -> None:
    """Add, rename, merge and list teams, and revoke their tokens."""


@team.command("add")
@server_folder
@click.argument("name")
def add_team(*, folder: Folder, name: str) -> None:
    """Add a team.

    Its people share a quota; the leaderboard shows its NAME.
    """
    from reverie_eval.server.accounts import people

    new = options.checked(NewTeam, name=name)
    with folder.acting() as transaction:
        added = people.add_team(transaction, new)
    print(f"team {added.name} added")


@team.command()
@server_folder
@click.argument("name")
@click.argument("new_name")
def rename(*, folder: Folder, name: str, new_name: str) -> None:
    """Rename a team.

    Its receipts keep the NAME under which they were signed.
    """
    from reverie_eval.server.accounts.people import rename_team

    new = options.checked(NewTeam, name=new_name)
    with folder.acting() as transaction:
        renamed = rename_team(transaction, name, new)
    print(f"team {name} renamed to {renamed.name}")


@team.command()
@server_folder
@click.argument("name")
@click.argument("into")
@without_asking
def merge(*, folder: Folder, name: str, into: str, yes: bool) -> None:
    """Give a team's people, submissions and grants to another.

    Quotas count the submissions of both, of the same file only the earlier. What is published stays
    published. Receipts keep the NAME under which they were signed. This cannot be undone, except
    from a backup.
    """
    from reverie_eval.server.accounts.people import merge_teams

    new = options.checked(NewMerge, team=name, into=into)
    if not yes:
        confirm(f"Merge {name} into {into}?")
    with folder.acting() as transaction:
        report = merge_teams(transaction, new)
    people = count_text(report.people, "person", "people")
    submissions = count_text(report.submissions, "submission")
    print(f"{people} and {submissions} of {name} moved to {into}")
    # Such a file is one submission from now on, so both numbers together would be too high.
    if report.repeats:
        print(f"{count_text(report.repeats, 'file')} had been submitted by both")


@team.command("list")
@server_folder
def list_teams(*, folder: Folder) -> None:
    """List the teams."""
    from reverie_eval.server.accounts import people

    teams = folder.all_of(people.list_teams)
    rows = [
        (each.name, str(each.id), minute(each.created_at), ", ".join(each.people)) for each in teams
    ]
    print_list(("team", "number", "since (UTC)", "people"), rows)


@team.command("revoke")
@server_folder
@click.argument("name")
def revoke_team(*, folder: Folder, name: str) -> None:
    """Revoke all tokens and invitations of a team.

    Its people and results stay.
    """
    from reverie_eval.server.accounts.tokens import revoke_tokens_of_team

    # A stolen token may be the last organiser's: ending it is not refused here, but warned about.
    with folder.revoking() as transaction:
        revoked = revoke_tokens_of_team(transaction, name)
    print(f"{name}: {count_text(len(revoked), 'token')} revoked")


@click.command()
@server_folder
@click.argument("team")
@click.argument("split")
@click.argument("number", type=options.Number(1, MOST_EXTRA))
@click.option("--reason", required=True, metavar="TEXT", help="The reason, for the audit log.")
@lasting
def grant(*, folder: Folder, team: str, split: str, number: int, reason: str, days: int) -> None:
    """Grant a team extra submissions.

    Each of the team's limits on a split is raised by NUMBER.
    """
    from reverie_eval.server.intake import quotas

    splits = folder.settings.splits
    ends = after(days)
    new = options.checked(
        NewGrant, team=team, split=split, extra=number, reason=reason, expires_at=ends
    )
    with folder.acting() as transaction:
        quotas.grant(transaction, new, splits)
    extra = count_text(number, "extra submission")
    print(f"{team}: {extra} to {split} until {minute(ends)} UTC")


@click.group(cls=Group)
def person() -> None:
    """Add, edit, import, list, export and delete people."""


@person.command()
@server_folder
@click.argument("name")
@click.option("--team", required=True, help="Their team; add it first with `server team add`.")
@options.with_default(
    "--role",
    type=options.Choice(get_args(Role)),
    default="participant",
    help="Organisers see the submissions of all teams.",
)
@click.option("--email", metavar="ADDRESS", help="Only organisers and the person see it.")
def add(*, folder: Folder, name: str, team: str, role: Role, email: str | None) -> None:
    """Add a person to a team.

    The team and the organisers see the NAME.
    """
    from reverie_eval.server.accounts.people import add_person

    new = options.checked(NewPerson, team=team, name=name, role=role, email=email)
    with folder.acting() as transaction:
        added = add_person(transaction, new)
    print(f"{added.role} {added.name} added to {team}")


@person.command()
@server_folder
@click.argument("name")
@of_team
@click.option("--name", "new_name", metavar="NAME", help="Rename the person.")
@click.option("--email", metavar="ADDRESS", help="Set their address; '' removes it.")
@click.option("--move-to", metavar="TEAM", help="Move them; their submissions stay with the team.")
def edit(
    *,
    folder: Folder,
    name: str,
    team: str | None,
    new_name: str | None,
    email: str | None,
    move_to: str | None,
) -> None:
    """Rename a person, change their address, or move them.

    Options that you omit change nothing.
    """
    from reverie_eval.server.accounts import people

    given = {"name": new_name, "email": email, "team": move_to}
    wanted = {field: value for field, value in given.items() if value is not None}
    # Silence would look as if something had been changed.
    if not wanted:
        raise click.UsageError("nothing to change; give --name, --email or --move-to")
    # An empty address removes it; without the option, it stays.
    change = options.checked(PersonChange, **(wanted | ({"email": None} if email == "" else {})))
    with folder.acting() as transaction:
        known = people.person_named(transaction.session, name, team)
        changed = people.change_person(transaction, known.id, change)
    print(f"{changed.name}, {changed.team}, {changed.email or 'no e-mail address'}")


@person.command("import")
@server_folder
@click.argument("file", type=options.PATH)
@click.option("--invite", is_flag=True, help="Print an invitation for each added person, as CSV.")
@click.option("--dry-run", is_flag=True, help="Only show who would be added.")
def import_people(*, folder: Folder, file: Path, invite: bool, dry_run: bool) -> None:
    """Add the people of a file, and their teams.

    FILE is CSV with the columns team, person, email and role; the last two may be left out.
    Existing people are left unchanged.

    Exit status: 0 done, 1 file rejected and nobody added, 2 usage or system error.
    """
    from reverie_eval.server.accounts import people_files

    new = options.checked(NewPeopleImport, text=read_text(file), invite=invite, dry_run=dry_run)
    with folder.acting() as transaction:
        report = people_files.import_people(transaction, new)
    if dry_run:
        rows = [(each.team, each.name, each.email or "-", each.role) for each in report.added]
        print_list(("team", "person", "e-mail", "role"), rows)
    # Alone on standard output, for a script that sends them; the counts go elsewhere.
    if report.invitations:
        print(people_files.invitations_csv(report.invitations), end="")
    done = "would be added" if dry_run else "added"
    counts = f"{len(report.added):,} {done}, {report.known:,} already there"
    note(f"{count_text(report.rows, 'row')}: {counts}; {count_text(len(report.teams), 'new team')}")


@person.command("list")
@server_folder
def list_people(*, folder: Folder) -> None:
    """List all people with team and role."""
    from reverie_eval.server.accounts import people

    everybody = folder.all_of(people.list_people)
    rows = [
        (each.name, each.team, each.role, each.email or "-", minute(each.created_at))
        for each in everybody
    ]
    print_list(("person", "team", "role", "e-mail", "since (UTC)"), rows)


@person.command()
@server_folder
@click.argument("name")
@of_team
def revoke(*, folder: Folder, name: str, team: str | None) -> None:
    """Revoke all tokens and invitations of a person.

    Their results stay.
    """
    from reverie_eval.server.accounts.tokens import revoke_tokens_of_person

    with folder.revoking() as transaction:
        revoked = revoke_tokens_of_person(transaction, name, team)
    print(f"{name}: {count_text(len(revoked), 'token')} revoked")


@person.command()
@server_folder
@click.argument("name")
@of_team
def export(*, folder: Folder, name: str, team: str | None) -> None:
    """Print all that the server stores about a person, as JSON."""
    from reverie_eval.server.accounts.people import person_named
    from reverie_eval.server.accounts.personal_data import personal_data

    with folder.reading() as session:
        person_id = person_named(session, name, team).id
        data = personal_data(session, person_id, folder.settings.organiser)
    print(data.model_dump_json(indent=2))


@person.command()
@server_folder
@click.argument("name")
@of_team
@without_asking
def delete(*, folder: Folder, name: str, team: str | None, yes: bool) -> None:
    """Remove a person's name and address, and revoke their tokens.

    Results and the audit log stay, under a neutral name. This cannot be undone, except from a
    backup.
    """
    from reverie_eval.server.accounts.people import person_named
    from reverie_eval.server.accounts.personal_data import delete_person

    if not yes:
        confirm(f"Delete {name}?")
    # Their tokens end with them, and one of these may be the last organiser's.
    with folder.revoking() as transaction:
        person_id = person_named(transaction.session, name, team).id
        deleted = delete_person(transaction, person_id)
    print(f"{name} is now {deleted.name}")


@click.group(cls=Group)
def request() -> None:
    """List, accept and reject requests to join."""


@request.command("list")
@server_folder
def list_requests(*, folder: Folder) -> None:
    """List the open requests, the earliest first."""
    from reverie_eval.server.accounts.joining import list_requests

    known = folder.all_of(list_requests)
    # What an organiser has to judge: who asks, for which team, and what for.
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
    from reverie_eval.server.accounts.joining import accept_requests
    from reverie_eval.server.accounts.people_files import invitations_csv

    with folder.acting() as transaction:
        # In one transaction: if one request cannot be accepted, none is.
        accepted = accept_requests(transaction, numbers)
    invitations = [each for one in accepted for each in one.invitations]
    print(invitations_csv(invitations), end="")
    added = count_text(len(invitations), "person", "people")
    say(f"{added} added to {', '.join(one.team for one in accepted)}")


@request.command()
@server_folder
@click.argument("numbers", metavar="NUMBER...", type=options.Number(1), nargs=-1, required=True)
@click.option("--reason", default="", metavar="TEXT", help="The reason, for the audit log.")
def reject(*, folder: Folder, numbers: Sequence[int], reason: str) -> None:
    """Reject requests to join.

    The personal data in them is deleted.
    """
    from reverie_eval.server.accounts.joining import reject_requests

    rejection = options.checked(Rejection, reason=reason)
    with folder.acting() as transaction:
        reject_requests(transaction, numbers, rejection)
    # A number that is given twice is one request.
    print(f"{count_text(len(set(numbers)), 'request')} rejected")
