"""``reverie-eval server init FOLDER``: make a server's folder."""

import argparse
import shlex

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import actor, now

SUMMARY = "make a server: settings, signing key, database, and the demo world until yours is there"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)


def run(arguments: argparse.Namespace) -> int:
    """Make the folder and say what to do next."""
    from reverie_eval.server.checks import database_errors
    from reverie_eval.server.folder import make_server

    with database_errors():
        token = make_server(arguments.folder, now=now(), actor=actor())
    folder = shlex.quote(str(arguments.folder))
    print(f"{arguments.folder}: a server, for now with the demo world as its ground truth")
    print(f"organiser's token, not shown again: {token}")
    print(f"next: edit {arguments.folder / 'reverie-eval.toml'}, then")
    print(f"  reverie-eval server check {folder}")
    print(f"  reverie-eval serve {folder}")
    return 0
