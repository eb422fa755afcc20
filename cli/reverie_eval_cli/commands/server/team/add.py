"""``reverie-eval server team add FOLDER NAME``: add a team."""

import argparse

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import actor, now, writing

SUMMARY = "add a team, which shares a quota"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument("name", help="as the leaderboard shows it")


def run(arguments: argparse.Namespace) -> int:
    """Add the team."""
    from reverie_eval.server.service.people import add_team

    with writing(arguments.folder) as session:
        team = add_team(session, arguments.name, now=now(), actor=actor())
    print(f"team {team.name} added")
    return 0
