"""``reverie-eval server doctor FOLDER``: check everything that a server has kept.

Exit status: 0 all is well, 1 something is to be mended.
"""

import argparse

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import show_findings
from reverie_eval_cli.progress import with_progress

SUMMARY = "check all that a server has kept: uploads, reports, receipts, audit log, disk"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)


def run(arguments: argparse.Namespace) -> int:
    """Look at everything and say how to mend what is wrong."""
    from reverie_eval.server.doctor import examine

    return show_findings(list(examine(arguments.folder, with_progress)))
