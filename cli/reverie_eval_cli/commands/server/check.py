"""``reverie-eval server check FOLDER``: say whether a server can start, and what to mend.

Exit status: 0 it can, 1 it cannot.
"""

import argparse

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import show_findings

SUMMARY = "check settings, ground truth, signing key, database and uploads"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)


def run(arguments: argparse.Namespace) -> int:
    """Check what a server needs to start."""
    from reverie_eval.server.checks import check_folder

    return show_findings(check_folder(arguments.folder))
