"""``reverie-eval server upgrade FOLDER``: bring a server's database to this version."""

import argparse

from reverie_eval_cli.arguments import add_server_folder

SUMMARY = "bring a server's database to this version; back it up before"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)


def run(arguments: argparse.Namespace) -> int:
    """Upgrade the database."""
    from reverie_eval.server.checks import database_errors
    from reverie_eval.server.folder import upgrade_folder

    with database_errors():
        upgrade_folder(arguments.folder)
    print(f"{arguments.folder}: the database is of this version")
    return 0
