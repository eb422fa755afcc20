"""``reverie-eval server snapshot FOLDER SPLIT --title TEXT``."""

from pathlib import Path

import click

from reverie_eval_cli import options
from reverie_eval_cli.organising import actor, checked, minute


@click.command()
@options.server_folder
@click.argument("split")
@click.option("--title", required=True, metavar="TEXT", help="Shown on the leaderboard.")
def snapshot(*, folder: Path, split: str, title: str) -> None:
    """Take a signed snapshot of a leaderboard.

    It is public at once and never changes. When a phase has ended, the server takes one by itself.
    """
    from reverie_eval.schemas.organising import NewSnapshot
    from reverie_eval.server.operations.checks import opened_server
    from reverie_eval.server.settings import load_settings

    new = checked(NewSnapshot, split=split, title=title)
    with (
        opened_server(load_settings(folder)) as state,
        state.transactions.begin(actor()) as transaction,
    ):
        taken = state.snapshots.take(transaction, new)
    print(f"{split}: snapshot {taken.number}, {taken.title}, as of {minute(taken.as_of)} UTC")
    print(f"it stays at /boards/{split}/snapshots/{taken.number}")
