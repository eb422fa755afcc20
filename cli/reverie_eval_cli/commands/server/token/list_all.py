"""``reverie-eval server token list FOLDER``: list the tokens by their first letters."""

import argparse
from typing import TYPE_CHECKING

from reverie_eval_cli.arguments import add_server_folder
from reverie_eval_cli.organising import minute, now, reading, show_list

if TYPE_CHECKING:
    from reverie_eval.server.store.tables import Token

SUMMARY = "list tokens and invitations by their first letters"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    add_server_folder(parser)


def run(arguments: argparse.Namespace) -> int:
    """List the tokens."""
    from reverie_eval.server.service.people import all_tokens

    with reading(arguments.folder) as session:
        rows = [
            (
                token.hint,
                token.kind,
                token.person.name,
                minute(token.created_at),
                minute(token.expires_at) or "never",
                _state(token),
            )
            for token in all_tokens(session)
        ]
    show_list(("begins", "kind", "person", "made (UTC)", "expires (UTC)", "state"), rows)
    return 0


def _state(token: "Token") -> str:
    if token.revoked_at is not None:
        return "used" if token.kind == "invite" else "revoked"
    return "expired" if token.expires_at is not None and token.expires_at <= now() else "valid"
