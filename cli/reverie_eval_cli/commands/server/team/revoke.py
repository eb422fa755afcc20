"""``reverie-eval server team revoke FOLDER NAME``: make all tokens of a team worthless."""

import argparse

from reverie_eval.text import count_text
from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import actor, now, writing

SUMMARY = "make all tokens and invitations of a team worthless from now on"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument("name", help="whose; `server team list` shows all")


def run(arguments: argparse.Namespace) -> int:
    """Revoke the tokens; results and people stay."""
    from reverie_eval.server.service.people import revoke_all, team_named

    with writing(arguments.folder) as session:
        people = team_named(session, arguments.name).people
        revoked = revoke_all(session, people, now=now(), actor=actor())
    print(f"{arguments.name}: {count_text(len(revoked), 'token')} revoked")
    return 0
