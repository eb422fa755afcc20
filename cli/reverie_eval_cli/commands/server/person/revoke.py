"""``reverie-eval server person revoke FOLDER NAME``: make all tokens of a person worthless."""

import argparse

from reverie_eval.text import count_text
from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import actor, now, writing

SUMMARY = "make all tokens and invitations of a person worthless from now on"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument("name", help="whose; `server person list` shows all")


def run(arguments: argparse.Namespace) -> int:
    """Revoke the tokens; results and people stay."""
    from reverie_eval.server.service.people import person_named, revoke_all

    with writing(arguments.folder) as session:
        people = [person_named(session, arguments.name)]
        revoked = revoke_all(session, people, now=now(), actor=actor())
    print(f"{arguments.name}: {count_text(len(revoked), 'token')} revoked")
    return 0
