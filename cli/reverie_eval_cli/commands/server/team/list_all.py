"""``reverie-eval server team list FOLDER``: list the teams."""

import argparse

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import minute, reading, show_list

SUMMARY = "list the teams"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)


def run(arguments: argparse.Namespace) -> int:
    """List the teams."""
    from reverie_eval.server.service.people import all_teams

    with reading(arguments.folder) as session:
        rows = [
            (
                team.name,
                minute(team.created_at),
                ", ".join(sorted(person.name for person in team.people)),
            )
            for team in all_teams(session)
        ]
    show_list(("team", "since (UTC)", "persons"), rows)
    return 0
