"""``reverie-eval server key|token``: signing keys, and what lets people in."""

from datetime import datetime

import click

from reverie_eval.schemas.organising import KeyRevocation, KeyRotation, NewToken, TokenKind
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import (
    Folder,
    actor,
    after,
    expiry,
    minute,
    now,
    of_team,
    print_list,
    server_folder,
)
from reverie_eval_cli.output import say


@click.group(cls=Group)
def key() -> None:
    """List, rotate and revoke the signing keys."""


@key.command("list")
@server_folder
def list_keys(*, folder: Folder) -> None:
    """List the keys that sign receipts, the earliest first."""
    from reverie_eval.server.audit import signing

    with folder.reading() as session:
        known = signing.list_keys(session)
    rows = [
        (each.key_id, minute(each.valid_from), minute(each.valid_until) or "in use", each.reason)
        for each in known
    ]
    print_list(("key", "from (UTC)", "until (UTC)", "reason"), rows)


@key.command()
@server_folder
@click.option("--reason", metavar="TEXT", help="Why; published with the key that ends.")
@click.option("--lost", is_flag=True, help="The file of the key in use is lost.")
def rotate(*, folder: Folder, reason: str | None, lost: bool) -> None:
    """Replace the signing key with a new one.

    Restart the server afterwards: until then, it accepts no changes. Earlier receipts stay genuine.
    """
    from reverie_eval.server.operations.keys import replace_lost_key, rotate_key

    # Without a reason, the model's own applies.
    asked = options.checked(KeyRotation, **({"reason": reason} if reason else {}))
    # Rotating reads the key in use, which is what is lost.
    change = replace_lost_key if lost else rotate_key
    new = change(folder.settings, actor(), asked.reason)
    print(f"the signing key is now {new.key_id}")
    print("next: restart the server, then make a backup, which contains the new key")


@key.command()
@server_folder
@click.argument("key_id")
@click.option(
    "--since",
    required=True,
    type=options.Time(),
    help="When others may first have had it, with the time zone: 2027-06-01T12:00:00Z.",
)
@click.option("--reason", required=True, metavar="TEXT", help="Why; published with the key.")
def revoke(*, folder: Folder, key_id: str, since: datetime, reason: str) -> None:
    """Revoke a key that others may have.

    Its signatures of submissions that came after TIME do not count. Those submissions get receipts
    signed with the key in use.
    """
    from reverie_eval.server.operations.keys import revoke_key

    asked = options.checked(KeyRevocation, since=since, reason=reason)
    with folder.acting() as transaction:
        signed = revoke_key(transaction, key_id, asked)
    print(f"{key_id}: valid until {minute(asked.since)} UTC")
    print(f"{count_text(signed, 'signature')} renewed with the key in use")


@click.group(cls=Group)
def token() -> None:
    """Make, list and revoke tokens and invitations."""


@token.command()
@server_folder
@click.argument("person")
@of_team
@expiry(None)
def add(*, folder: Folder, person: str, team: str | None, expires_days: int | None) -> None:
    """Print a new token for a person.

    It cannot be shown again.
    """
    _create(folder, person, team, "access", expires_days)


@token.command()
@server_folder
@click.argument("person")
@of_team
@expiry(14)
def invite(*, folder: Folder, person: str, team: str | None, expires_days: int | None) -> None:
    """Print an invitation for a person.

    `reverie-eval login` exchanges it, once, for a token.
    """
    _create(folder, person, team, "invite", expires_days)


@token.command("list")
@server_folder
def list_tokens(*, folder: Folder) -> None:
    """List tokens and invitations by their first characters."""
    from reverie_eval.server.accounts import tokens
    from reverie_eval.server.identity import token_state

    # One time for all rows, or a token could be valid in one and expired in the next.
    known, at = folder.all_of(tokens.list_tokens), now()
    rows = [
        (
            each.hint,
            each.kind,
            each.person,
            each.team,
            minute(each.created_at),
            minute(each.expires_at) or "never",
            token_state(each, at),
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
    from reverie_eval.server.accounts import tokens

    # The last token may be the stolen one: warned about, not refused.
    with folder.revoking() as transaction:
        revoked = tokens.revoke_token(transaction, begins)
    print(f"token {revoked.hint} of {revoked.person} revoked")


def _create(
    folder: Folder,
    name: str,
    team: str | None,
    kind: TokenKind,
    expires_days: int | None,
) -> None:
    """Print a token alone, for scripts; on standard error whose it is."""
    from reverie_eval.server.accounts.tokens import create_token
    from reverie_eval.server.identity import TOKEN_NAMES

    ends = after(expires_days)
    new = options.checked(NewToken, person=name, team=team, kind=kind, expires_at=ends)
    with folder.acting() as transaction:
        created = create_token(transaction, new)
    # Alone on standard output, to be assigned: TOKEN=$(reverie-eval server token add ...).
    print(created.token)
    until = f", until {minute(ends)} UTC" if ends else ""
    say(f"{TOKEN_NAMES[kind]} of {name}{until}; it is not shown again")
