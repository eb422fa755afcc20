"""``reverie-eval server person add FOLDER NAME --team TEAM``: add a person to a team."""

import argparse

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import actor, now, writing

SUMMARY = "add a person to a team"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument("name", help="seen by the team and the organiser")
    parser.add_argument("--team", required=True, help="which team; `server team add` first")
    parser.add_argument(
        "--role",
        choices=("participant", "organiser"),
        default="participant",
        help="organisers see every team's submissions (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Add the person."""
    from reverie_eval.server.service.people import add_person

    with writing(arguments.folder) as session:
        person = add_person(
            session, arguments.team, arguments.name, arguments.role, now=now(), actor=actor()
        )
    print(f"{person.role} {person.name} added to {arguments.team}")
    return 0
