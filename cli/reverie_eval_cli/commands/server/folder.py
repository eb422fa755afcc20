"""``reverie-eval server init|upgrade|doctor|audit|notify|backup|restore FOLDER``."""

import json
import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval import ReverieEvalError
from reverie_eval.tasks import DEFAULT_TASK
from reverie_eval.text import count_text, first_few, printable
from reverie_eval_cli import options
from reverie_eval_cli.organising import (
    Folder,
    actor,
    minute,
    now,
    print_list,
    server_folder,
    show_findings,
)
from reverie_eval_cli.output import note, with_progress

if TYPE_CHECKING:
    from reverie_eval.server.operations.backup import Manifest


@click.command()
@server_folder
@options.with_default(
    "--task",
    "tasks",
    multiple=True,
    default=[DEFAULT_TASK],
    metavar="NAME",
    shell_complete=options.complete_task,
    help="The benchmark of its leaderboards, such as r2r; can be repeated.",
)
def init(*, folder: Folder, tasks: Sequence[str]) -> None:
    """Make a server's folder.

    It gets settings, a signing key, a database and, until you add your own, the demo world as its
    ground truth.
    """
    from reverie_eval.server.opening import database_errors
    from reverie_eval.server.operations.folder import make_server

    with database_errors():
        token = make_server(folder.path, now=now(), actor=actor(), tasks=tasks)
    # To be copied into a shell, whatever the folder is called.
    quoted = shlex.quote(str(folder))
    print(f"{folder}: a server, for now with the demo world as its ground truth")
    print(f"organiser's token, not shown again: {token}")
    print(f"next: edit {folder.path / 'reverie-eval.toml'}, then")
    print(f"  reverie-eval server doctor --quick {quoted}")
    print(f"  reverie-eval serve {quoted}")


@click.command()
@server_folder
@click.option("--quick", is_flag=True, help="Only check that the server can start.")
def doctor(*, folder: Folder, quick: bool) -> int:
    """Check that the server can start, and all stored data.

    To start, it needs settings, ground truth, a signing key, its database and uploads. Of the
    stored data, uploads, receipts, the audit log and the disk are checked, and faults are
    also sent to the mail recipients and the webhook in the settings.

    Exit status: 0 no faults, 1 faults to fix, 2 usage or system error.
    """
    from reverie_eval.server.operations.checks import check_folder
    from reverie_eval.server.operations.doctor import examine, tell_of_faults

    # Before a start, somebody reads the findings here, and nobody is told by mail.
    if quick:
        return show_findings(check_folder(folder.path))

    # All findings, before anyone is told: one message, not one for each.
    findings = list(examine(folder.path, with_progress))
    tell_of_faults(folder.path, findings, actor())
    return show_findings(findings)


@click.command()
@server_folder
def upgrade(*, folder: Folder) -> None:
    """Upgrade the database to this version.

    Back it up first.
    """
    from reverie_eval.server.opening import database_errors
    from reverie_eval.server.operations.folder import upgrade_folder

    # What a database says of a broken upgrade is for its developers: it is named in our words.
    with database_errors():
        upgrade_folder(folder.path)
    print(f"{folder}: the database is up to date with this version")


@click.command()
@server_folder
@options.layout("text", "json", explained=" json includes the digests.")
def audit(*, folder: Folder, layout: str) -> None:
    """Show who did what, oldest first.

    `server doctor` checks that nothing in it was changed.
    """
    from reverie_eval.server.audit.log import audit_reports, details_in_words, entries

    with folder.reading() as session:
        found = audit_reports(session, entries(session))
    # For programs, which check the chain of digests.
    if layout == "json":
        print(json.dumps([entry.model_dump(mode="json") for entry in found], indent=2))
        return
    rows = [
        (
            minute(entry.at),
            entry.actor,
            entry.action,
            entry.subject,
            # A method's description may have several lines.
            printable(", ".join(map(": ".join, details_in_words(entry.details).items()))),
        )
        for entry in found
    ]
    print_list(("at (UTC)", "who", "did", "to", "details"), rows)


@click.command()
@server_folder
def notify(*, folder: Folder) -> int:
    """Send a test message by mail and to the webhook, at once.

    Exit status: 0 sent, 1 not sent, 2 usage or system error.
    """
    from reverie_eval.server.messages.delivery import send_test
    from reverie_eval.server.settings import SETTINGS_FILE

    # All channels are tried: one that fails does not hide another.
    outcomes = list(send_test(folder.settings))
    # Not a success: the organiser expects to hear of faults, and would not.
    if not outcomes:
        file = folder.path / SETTINGS_FILE
        raise ReverieEvalError(f"the settings have no [mail] and no [webhook]; add one to {file}")
    for channel, error in outcomes:
        print(f"{channel}: {error or 'sent'}")
    return 1 if any(error for _, error in outcomes) else 0


@click.command()
@server_folder
@options.new_path("FILE", "The .tar.gz to write.")
@click.option("--verify", is_flag=True, help="Restore it to a temporary folder, and compare.")
def backup(*, folder: Folder, output: Path, verify: bool) -> int:
    """Write a backup, also while the server runs.

    One .tar.gz file has everything that a server needs. With --verify, a backup that does not
    restore is not kept; the former FILE is.

    Exit status: 0 complete, 1 an upload was missing or damaged or the backup does not restore,
    2 usage or system error.
    """
    from reverie_eval.server.operations.backup import write_backup
    from reverie_eval.server.operations.restore import BackupError, verify_backup
    from reverie_eval.server.settings import variables_set

    try:
        report = write_backup(folder.path, output, verify_backup if verify else None)
    except BackupError:
        examine = f"reverie-eval server doctor {shlex.quote(str(folder))}"
        note(f"{output} was not written: the backup does not restore; `{examine}` may say why")
        raise
    print(f"{output}: {_counts(report.manifest)}, {report.size / 1e6:,.1f} MB")
    if verify:
        print("verified: it was restored, all rows and files are the same, and the server opens")
    print("it contains solutions and the signing key: keep it where nobody else can read it")
    for setting, name in report.moved.items():
        note(f"{setting} is outside of the folder; a restore puts it at {name} in the folder")
    # A restore without them opens another database than this one.
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

    The folder must be empty. The database and the uploads are in it, unless REVERIE_EVAL_DATABASE
    names an empty database, or REVERIE_EVAL_UPLOADS a store; what the settings in the backup name
    outside the folder is not used.

    Exit status: 0 the server can start, 1 backup rejected or faults to fix, 2 usage or system
    error.
    """
    from reverie_eval.server.operations.checks import check_folder
    from reverie_eval.server.operations.restore import restore_backup

    report = restore_backup(file, folder)
    print(f"{folder}: restored, {_counts(report.manifest)}")
    for change in report.changed:
        note(f"{change.setting} was {change.before}, outside the folder; it is now {change.after}")
        if change.variable and change.variable not in os.environ:
            note(f"to restore elsewhere, set {change.variable}, and restore again")
    return show_findings(check_folder(folder))


def _counts(manifest: "Manifest") -> str:
    tables = {"submission": "submissions", "team": "teams", "person": "people"}
    rows, gone = manifest.rows, manifest.gone
    return ", ".join(
        count_text(rows.get(name, 0) - gone.get(name, 0), name, plural)
        for name, plural in tables.items()
    )
