"""``reverie-eval server tidy FOLDER``: delete old files of submissions that are not published."""

from pathlib import Path

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.organising import actor


@click.command()
@options.server_folder
@click.option("--dry-run", is_flag=True, help="Only show whose files would be deleted.")
def tidy(*, folder: Path, dry_run: bool) -> None:
    """Delete old files of submissions that are not published.

    The setting keep_uploads_days says how old; a running server does this once a day. Rows, scores
    and receipts stay.
    """
    from reverie_eval.server.operations.checks import opened_server
    from reverie_eval.server.settings import load_settings

    settings = load_settings(folder)
    if settings.keep_uploads_days is None:
        print("keep_uploads_days is not set: all files are kept")
        return
    with opened_server(settings) as state:
        tidied = state.retention.tidy(actor(), dry_run=dry_run)
    if dry_run:
        for name in tidied.submissions:
            print(name)
    done = "would be deleted" if dry_run else "deleted"
    of = count_text(len(tidied.submissions), "submission")
    print(f"{count_text(tidied.files, 'file')} of {of} {done}")
