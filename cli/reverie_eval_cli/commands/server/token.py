"""``reverie-eval server token add|list|revoke FOLDER``, and ``server invite``."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import (
    acting,
    after,
    checked,
    minute,
    now,
    print_list,
    reading,
    revoking,
)

if TYPE_CHECKING:
    from reverie_eval.schemas.organising import TokenReport


@click.group(cls=Group)
def token() -> None:
    """Make, list and revoke tokens."""


@token.command()
@options.server_folder
@click.argument("person")
@options.of_team
@options.expiry(None)
def add(*, folder: Path, person: str, team: str | None, expires_days: int | None) -> None:
    """Print a new token for a person.

    It cannot be shown again.
    """
    _create(folder, person, team, "access", expires_days)


@token.command("list")
@options.server_folder
def list_tokens(*, folder: Path) -> None:
    """List tokens and invitations by their first characters."""
    from reverie_eval.server.service import tokens
    from reverie_eval.server.service.paging import all_pages

    with reading(folder) as session:
        known = list(all_pages(partial(tokens.list_tokens, session)))
    rows = [
        (
            each.hint,
            each.kind,
            each.person,
            each.team,
            minute(each.created_at),
            minute(each.expires_at) or "never",
            _state(each),
        )
        for each in known
    ]
    print_list(("begins", "kind", "person", "team", "made (UTC)", "expires (UTC)", "state"), rows)


def _state(each: "TokenReport") -> str:
    if each.revoked_at is not None:
        return "used" if each.kind == "invite" else "revoked"
    return "expired" if each.expires_at is not None and each.expires_at <= now() else "valid"


@token.command("revoke")
@options.server_folder
@click.argument("begins")
def revoke_token(*, folder: Path, begins: str) -> None:
    """Revoke a token.

    BEGINS is its first 11 characters, which `server token list` shows.
    """
    from reverie_eval.server.service import tokens

    with revoking(folder) as transaction:
        revoked = tokens.revoke_token(transaction, begins)
    print(f"token {revoked.hint} of {revoked.person} revoked")


@click.command()
@options.server_folder
@click.argument("person")
@options.of_team
@options.expiry(14)
def invite(*, folder: Path, person: str, team: str | None, expires_days: int | None) -> None:
    """Print an invitation for a person.

    `reverie-eval login` exchanges it, once, for a token.
    """
    _create(folder, person, team, "invite", expires_days)


def _create(
    folder: Path,
    name: str,
    team: str | None,
    kind: Literal["access", "invite"],
    expires_days: int | None,
) -> None:
    """Print a token alone, for scripts; on standard error whose it is."""
    from reverie_eval.schemas.organising import NewToken
    from reverie_eval.server.service.tokens import TOKEN_NAMES, create_token

    ends = after(expires_days)
    new = checked(NewToken, person=name, team=team, kind=kind, expires_at=ends)
    with acting(folder) as transaction:
        created = create_token(transaction, new)
    print(created.token)
    until = f", until {minute(ends)} UTC" if ends else ""
    print(f"{TOKEN_NAMES[kind]} of {name}{until}; it is not shown again", file=sys.stderr)
