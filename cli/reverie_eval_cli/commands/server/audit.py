"""``reverie-eval server audit FOLDER``: show who did what."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval_cli import options
from reverie_eval_cli.organising import minute, print_list, reading

if TYPE_CHECKING:
    from collections.abc import Sequence

    from reverie_eval.server.store.tables import AuditEntry

_FIELDS = ("id", "at", "actor", "action", "row", "subject", "details", "previous", "digest")


@click.command()
@options.server_folder
@options.layout("text", "json", explained=" json includes the digests.")
def audit(*, folder: Path, layout: str) -> None:
    """Show who did what, oldest first.

    `server doctor` checks that nothing in it was changed.
    """
    from reverie_eval.server.service.audit import entries

    with reading(folder) as session:
        found = entries(session)
        if layout == "json":
            print(_as_json(found))
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


def _as_json(entries: "Sequence[AuditEntry]") -> str:
    rows = [{field: getattr(entry, field) for field in _FIELDS} for entry in entries]
    return json.dumps(rows, indent=2, default=lambda instant: instant.isoformat())
