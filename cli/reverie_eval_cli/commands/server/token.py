"""``reverie-eval server token add|list|revoke FOLDER``, and ``server invite``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import actor, after, minute, now, print_list, reading, writing

if TYPE_CHECKING:
    from reverie_eval.server.store.tables import Token


@click.group(cls=Group)
def token() -> None:
    """Make, list and revoke tokens."""


@token.command()
@options.server_folder
@click.argument("person")
@options.expiry(None)
def add(*, folder: Path, person: str, expires_days: int | None) -> None:
    """Print a new token for a person.

    It cannot be shown again.
    """
    _mint(folder, person, "access", expires_days)


@token.command("list")
@options.server_folder
def list_tokens(*, folder: Path) -> None:
    """List tokens and invitations by their first characters."""
    from reverie_eval.server.service.people import all_tokens

    with reading(folder) as session:
        rows = [
            (
                each.hint,
                each.kind,
                each.person.name,
                minute(each.created_at),
                minute(each.expires_at) or "never",
                _state(each),
            )
            for each in all_tokens(session)
        ]
    print_list(("begins", "kind", "person", "made (UTC)", "expires (UTC)", "state"), rows)


def _state(each: "Token") -> str:
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
    from reverie_eval.server.service.people import revoke

    with writing(folder) as session:
        revoked = revoke(session, begins, now=now(), actor=actor())
    print(f"token {revoked.hint} of {revoked.person.name} revoked")


@click.command()
@options.server_folder
@click.argument("person")
@options.expiry(14)
def invite(*, folder: Path, person: str, expires_days: int | None) -> None:
    """Print an invitation for a person.

    `reverie-eval login` exchanges it, once, for a token.
    """
    _mint(folder, person, "invite", expires_days)


def _mint(
    folder: Path, name: str, kind: Literal["access", "invite"], expires_days: int | None
) -> None:
    """Print a token alone, for scripts; on standard error whose it is."""
    from reverie_eval.server.service.people import mint, person_named

    ends = after(expires_days)
    with writing(folder) as session:
        person = person_named(session, name)
        minted = mint(session, person, kind, now=now(), actor=actor(), expires_at=ends)
    print(minted.text)
    word = "invitation" if kind == "invite" else "token"
    until = f", until {minute(ends)} UTC" if ends else ""
    owner = f"{minted.token.person.name}, {minted.token.person.team.name}"
    print(f"{word} of {owner}{until}; it is not shown again", file=sys.stderr)
