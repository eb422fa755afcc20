"""``reverie-eval server grant FOLDER TEAM SPLIT N --reason TEXT``."""

from datetime import timedelta
from pathlib import Path

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.organising import actor, minute, now, writing


@click.command()
@options.server_folder
@click.argument("team")
@click.argument("split")
@click.argument("number", type=click.IntRange(min=1))
@click.option("--reason", required=True, metavar="TEXT", help="The reason, for the audit log.")
@options.days
def grant(*, folder: Path, team: str, split: str, number: int, reason: str, days: int) -> None:
    """Grant a team extra submissions.

    Each of the team's limits on a split is raised by NUMBER.
    """
    from reverie_eval.server.service.grants import grant as grant_submissions
    from reverie_eval.server.settings import load_settings

    begins = now()
    ends = begins + timedelta(days=days)
    splits = load_settings(folder).splits
    with writing(folder) as session:
        grant_submissions(
            session,
            team,
            split,
            number,
            splits=splits,
            reason=reason,
            now=begins,
            expires_at=ends,
            actor=actor(),
        )
    extra = count_text(number, "extra submission")
    print(f"{team}: {extra} to {split} until {minute(ends)} UTC")
