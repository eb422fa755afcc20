"""``reverie-eval server token revoke FOLDER BEGINS``: make a token worthless."""

import argparse

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import actor, now, writing

SUMMARY = "make a token worthless from now on"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument("begins", help="its first letters, as `server token list` shows them")


def run(arguments: argparse.Namespace) -> int:
    """Revoke the token."""
    from reverie_eval.server.service.people import revoke

    with writing(arguments.folder) as session:
        token = revoke(session, arguments.begins, now=now(), actor=actor())
    print(f"{token.hint}, of {token.person.name}, is revoked")
    return 0
