"""``reverie-eval server restore FILE FOLDER``: make a server from a backup.

Exit status: 0 it can serve, 1 the backup was rejected or something is to be mended before.
"""

import argparse
from pathlib import Path

from reverie_eval.text import count_text
from reverie_eval_cli.organising import show_findings

SUMMARY = "make a server from a backup, in an empty folder and an empty database"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.add_argument("backup", metavar="file", type=Path, help="what `server backup` wrote")
    parser.add_argument("folder", type=Path, help="a new or an empty folder")


def run(arguments: argparse.Namespace) -> int:
    """Restore the backup and check whether the server could start."""
    from reverie_eval.server.checks import check_folder
    from reverie_eval.server.restore import restore_backup

    rows = restore_backup(arguments.backup, arguments.folder).rows
    counts = [count_text(rows.get(table, 0), table) for table in ("submission", "team", "person")]
    print(f"{arguments.folder}: restored, {', '.join(counts)}")
    return show_findings(check_folder(arguments.folder))
