"""``reverie-eval server person list FOLDER``: list everybody."""

import argparse

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import minute, reading, show_list

SUMMARY = "list everybody, with team and role"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)


def run(arguments: argparse.Namespace) -> int:
    """List the persons."""
    from reverie_eval.server.service.people import all_people

    with reading(arguments.folder) as session:
        rows = [
            (person.name, person.team.name, person.role, minute(person.created_at))
            for person in all_people(session)
        ]
    show_list(("person", "team", "role", "since (UTC)"), rows)
    return 0
