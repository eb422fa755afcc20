"""``reverie-eval server backup FOLDER -o FILE``: back a server up, while it serves.

Exit status: 0 everything is in the backup, 1 an upload was missing or damaged.
"""

import argparse
import sys
from pathlib import Path

from reverie_eval.text import count_text, first_few
from reverie_eval_cli.arguments import add_server_folder

SUMMARY = "write everything that a server is to one .tar.gz, also while it serves"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument(
        "-o", "--output", required=True, metavar="FILE", type=Path, help="the .tar.gz to write"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the backup and say what is in it, and what is not."""
    from reverie_eval.server.backup import write_backup
    from reverie_eval.server.settings import variables_set

    report = write_backup(arguments.folder, arguments.output)
    rows = report.manifest.rows
    counts = [count_text(rows.get(table, 0), table) for table in ("submission", "team", "person")]
    print(f"{arguments.output}: {', '.join(counts)}, {report.size / 1e6:,.1f} MB")
    print("it holds answers and the signing key: keep it where nobody else can read it")
    for setting, name in report.moved.items():
        _note(f"{setting} is outside of the folder; a restore puts it at {name} in the folder")
    variables = variables_set()
    if variables:
        _note(f"variables are not in a backup; set here: {', '.join(variables)}")
    lacking = report.manifest.lacking
    if lacking:
        reason = "missing or damaged, and not in the backup"
        _note(f"{count_text(len(lacking), 'upload')} {reason}: {first_few(lacking)}")
    return 1 if lacking else 0


def _note(text: str) -> None:
    print(f"note: {text}", file=sys.stderr)
