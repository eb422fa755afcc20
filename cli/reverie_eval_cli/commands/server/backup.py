"""``reverie-eval server backup`` and ``restore``: hand over a server as one file."""

from collections.abc import Mapping
from pathlib import Path

import click

from reverie_eval.text import count_text, first_few
from reverie_eval_cli import options
from reverie_eval_cli.organising import Folder, server_folder, show_findings
from reverie_eval_cli.output import note


@click.command()
@server_folder
@options.new_path("FILE", "The .tar.gz to write.")
def backup(*, folder: Folder, output: Path) -> int:
    """Write a backup, also while the server runs.

    One .tar.gz file has everything that a server needs.

    Exit status: 0 complete, 1 an upload was missing or damaged, 2 usage or system error.
    """
    from reverie_eval.server.operations.backup import write_backup
    from reverie_eval.server.settings import variables_set

    report = write_backup(folder.path, output)
    print(f"{output}: {_counts(report.manifest.rows)}, {report.size / 1e6:,.1f} MB")
    print("it contains answers and the signing key: keep it where nobody else can read it")
    for setting, name in report.moved.items():
        note(f"{setting} is outside of the folder; a restore puts it at {name} in the folder")
    variables = variables_set()
    if variables:
        note(f"environment variables are not in a backup; set here: {', '.join(variables)}")
    lacking = report.manifest.lacking
    if lacking:
        reason = "missing or damaged, and not in the backup"
        note(f"{count_text(len(lacking), 'upload')} {reason}: {first_few(lacking)}")
    return 1 if lacking else 0


@click.command()
@click.argument("file", type=options.PATH)
@click.argument("folder", type=options.PATH)
def restore(*, file: Path, folder: Path) -> int:
    """Make a server from a backup.

    The folder and the database must be empty.

    Exit status: 0 the server can start, 1 backup rejected or faults to fix, 2 usage or system
    error.
    """
    from reverie_eval.server.operations.checks import check_folder
    from reverie_eval.server.operations.restore import restore_backup

    print(f"{folder}: restored, {_counts(restore_backup(file, folder).rows)}")
    return show_findings(check_folder(folder))


def _counts(rows: Mapping[str, int]) -> str:
    tables = {"submission": "submissions", "team": "teams", "person": "people"}
    return ", ".join(count_text(rows.get(name, 0), name, plural) for name, plural in tables.items())
