"""``reverie-eval server init|check|doctor|upgrade FOLDER``: the folder that a server lives in."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval.tasks import DEFAULT_TASK
from reverie_eval_cli import options
from reverie_eval_cli.organising import actor, now, show_findings
from reverie_eval_cli.output import with_progress

if TYPE_CHECKING:
    from collections.abc import Sequence


@click.command()
@options.server_folder
@click.option(
    "--task",
    "tasks",
    multiple=True,
    default=[DEFAULT_TASK],
    show_default=True,
    metavar="NAME",
    shell_complete=options.complete_task,
    help="The benchmark of its leaderboards, such as r2r; can be repeated.",
)
def init(*, folder: Path, tasks: "Sequence[str]") -> None:
    """Make a server's folder.

    It gets settings, a signing key, a database and, until you add your own, the demo world as its
    ground truth.
    """
    from reverie_eval.server.operations.checks import database_errors
    from reverie_eval.server.operations.folder import make_server

    with database_errors():
        token = make_server(folder, now=now(), actor=actor(), tasks=tasks)
    quoted = shlex.quote(str(folder))
    print(f"{folder}: a server, for now with the demo world as its ground truth")
    print(f"organiser's token, not shown again: {token}")
    print(f"next: edit {folder / 'reverie-eval.toml'}, then")
    print(f"  reverie-eval server check {quoted}")
    print(f"  reverie-eval serve {quoted}")


@click.command()
@options.server_folder
def check(*, folder: Path) -> int:
    """Check that a server can start.

    Settings, ground truth, signing key, database and uploads are checked.

    Exit status: 0 the server can start, 1 it cannot, 2 usage or system error.
    """
    from reverie_eval.server.operations.checks import check_folder

    return show_findings(check_folder(folder))


@click.command()
@options.server_folder
def doctor(*, folder: Path) -> int:
    """Check all stored data.

    Uploads, reports, receipts, the audit log and the disk are checked. Faults are also sent to the
    mail recipients and the webhook in the settings.

    Exit status: 0 no faults, 1 faults to fix, 2 usage or system error.
    """
    from reverie_eval.server.operations.doctor import examine, tell_of_faults

    findings = list(examine(folder, with_progress))
    tell_of_faults(folder, findings, actor())
    return show_findings(findings)


@click.command()
@options.server_folder
def upgrade(*, folder: Path) -> None:
    """Upgrade the database to this version.

    Back it up first.
    """
    from reverie_eval.server.operations.checks import database_errors
    from reverie_eval.server.operations.folder import upgrade_folder

    with database_errors():
        upgrade_folder(folder)
    print(f"{folder}: the database is up to date with this version")
