"""``reverie-eval server grant FOLDER TEAM SPLIT N --reason TEXT``."""

from datetime import timedelta
from pathlib import Path

import click

from reverie_eval.schemas.organising import MOST_EXTRA, NewGrant
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.organising import acting, checked, minute, now


@click.command()
@options.server_folder
@click.argument("team")
@click.argument("split")
@click.argument("number", type=options.Number(1, MOST_EXTRA))
@click.option("--reason", required=True, metavar="TEXT", help="The reason, for the audit log.")
@options.days
def grant(*, folder: Path, team: str, split: str, number: int, reason: str, days: int) -> None:
    """Grant a team extra submissions.

    Each of the team's limits on a split is raised by NUMBER.
    """
    from reverie_eval.server.service import quotas
    from reverie_eval.server.settings import load_settings

    splits = load_settings(folder).splits
    ends = now() + timedelta(days=days)
    new = checked(NewGrant, team=team, split=split, extra=number, reason=reason, expires_at=ends)
    with acting(folder) as transaction:
        quotas.grant(transaction, new, splits)
    extra = count_text(number, "extra submission")
    print(f"{team}: {extra} to {split} until {minute(ends)} UTC")
