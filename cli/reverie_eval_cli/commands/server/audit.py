"""``reverie-eval server audit FOLDER``: show who did what."""

import json
from pathlib import Path

import click

from reverie_eval_cli import options
from reverie_eval_cli.organising import minute, print_list, reading


@click.command()
@options.server_folder
@options.layout("text", "json", explained=" json includes the digests.")
def audit(*, folder: Path, layout: str) -> None:
    """Show who did what, oldest first.

    `server doctor` checks that nothing in it was changed.
    """
    from reverie_eval.server.service.audit import audit_reports, entries

    with reading(folder) as session:
        found = audit_reports(session, entries(session))
    if layout == "json":
        print(json.dumps([entry.model_dump(mode="json") for entry in found], indent=2))
        return
    rows = [
        (
            minute(entry.at),
            entry.actor,
            entry.action,
            entry.subject,
            ", ".join(f"{name}: {value}" for name, value in entry.details.items()),
        )
        for entry in found
    ]
    print_list(("at (UTC)", "who", "did", "to", "details"), rows)
