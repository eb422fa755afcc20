"""``reverie-eval server key list|rotate|revoke FOLDER``."""

from datetime import datetime

import click

from reverie_eval.schemas.organising import KeyRevocation, KeyRotation
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, actor, minute, print_list, server_folder


@click.group(cls=Group)
def key() -> None:
    """List the signing keys, rotate the one in use, and revoke earlier ones."""


@key.command("list")
@server_folder
def list_keys(*, folder: Folder) -> None:
    """List the keys that sign receipts, the earliest first."""
    from reverie_eval.server.service import keys

    with folder.reading() as session:
        known = keys.list_keys(session)
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

    asked = options.checked(KeyRotation, **({"reason": reason} if reason else {}))
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
    from reverie_eval.server.service.rotation import revoke_key

    asked = options.checked(KeyRevocation, since=since, reason=reason)
    with folder.acting() as transaction:
        signed = revoke_key(transaction, key_id, asked)
    print(f"{key_id}: valid until {minute(asked.since)} UTC")
    print(f"{count_text(signed, 'receipt')} signed again with the key in use")
