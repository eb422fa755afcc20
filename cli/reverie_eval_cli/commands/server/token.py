"""``reverie-eval server token add|list|revoke FOLDER``, and ``server invite``."""

import sys

import click

from reverie_eval.schemas.organising import NewToken, TokenKind
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import (
    Folder,
    after,
    minute,
    now,
    print_list,
    server_folder,
)


@click.group(cls=Group)
def token() -> None:
    """Make, list and revoke tokens."""


@token.command()
@server_folder
@click.argument("person")
@options.of_team
@options.expiry(None)
def add(*, folder: Folder, person: str, team: str | None, expires_days: int | None) -> None:
    """Print a new token for a person.

    It cannot be shown again.
    """
    _create(folder, person, team, "access", expires_days)


@token.command("list")
@server_folder
def list_tokens(*, folder: Folder) -> None:
    """List tokens and invitations by their first characters."""
    from reverie_eval.server.service import tokens

    known, at = folder.all_of(tokens.list_tokens), now()
    rows = [
        (
            each.hint,
            each.kind,
            each.person,
            each.team,
            minute(each.created_at),
            minute(each.expires_at) or "never",
            tokens.token_state(each, at),
        )
        for each in known
    ]
    print_list(("begins", "kind", "person", "team", "made (UTC)", "expires (UTC)", "state"), rows)


@token.command("revoke")
@server_folder
@click.argument("begins")
def revoke_token(*, folder: Folder, begins: str) -> None:
    """Revoke a token.

    BEGINS is its first 11 characters, which `server token list` shows.
    """
    from reverie_eval.server.service import tokens

    with folder.revoking() as transaction:
        revoked = tokens.revoke_token(transaction, begins)
    print(f"token {revoked.hint} of {revoked.person} revoked")


@click.command()
@server_folder
@click.argument("person")
@options.of_team
@options.expiry(14)
def invite(*, folder: Folder, person: str, team: str | None, expires_days: int | None) -> None:
    """Print an invitation for a person.

    `reverie-eval login` exchanges it, once, for a token.
    """
    _create(folder, person, team, "invite", expires_days)


def _create(
    folder: Folder,
    name: str,
    team: str | None,
    kind: TokenKind,
    expires_days: int | None,
) -> None:
    """Print a token alone, for scripts; on standard error whose it is."""
    from reverie_eval.server.service.tokens import TOKEN_NAMES, create_token

    ends = after(expires_days)
    new = options.checked(NewToken, person=name, team=team, kind=kind, expires_at=ends)
    with folder.acting() as transaction:
        created = create_token(transaction, new)
    print(created.token)
    until = f", until {minute(ends)} UTC" if ends else ""
    print(f"{TOKEN_NAMES[kind]} of {name}{until}; it is not shown again", file=sys.stderr)
