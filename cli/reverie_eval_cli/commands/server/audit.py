"""``reverie-eval server audit FOLDER``: show who did what."""

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import minute, reading, show_list

if TYPE_CHECKING:
    from reverie_eval.server.store.tables import AuditEntry

SUMMARY = "show who did what; `server doctor` checks that nothing was changed"

_FIELDS = ("id", "at", "actor", "action", "subject", "details", "previous", "digest")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)
    parser.add_argument(
        "--format", choices=("text", "json"), default="text", help="json has the digests too"
    )


def run(arguments: argparse.Namespace) -> int:
    """Show the audit log, the oldest entry first."""
    from reverie_eval.server.service.audit import entries

    with reading(arguments.folder) as session:
        found = entries(session)
        if arguments.format == "json":
            print(_as_json(found))
        else:
            _show(found)
    return 0


def _as_json(entries: "Sequence[AuditEntry]") -> str:
    rows = [{field: getattr(entry, field) for field in _FIELDS} for entry in entries]
    return json.dumps(rows, indent=2, default=lambda instant: instant.isoformat())


def _show(entries: "Sequence[AuditEntry]") -> None:
    rows = [
        (minute(entry.at), entry.actor, entry.action, entry.subject, _words(entry.details))
        for entry in entries
    ]
    show_list(("at (UTC)", "who", "did", "to", "details"), rows)


def _words(details: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}: {value}" for name, value in details.items())
