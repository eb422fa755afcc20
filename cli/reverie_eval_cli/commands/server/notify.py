"""``reverie-eval server notify FOLDER``: send a test message."""

from pathlib import Path

import click

from reverie_eval import ReverieEvalError
from reverie_eval_cli import options


@click.command()
@options.server_folder
def notify(*, folder: Path) -> int:
    """Send a test message by mail and to the webhook, at once.

    Exit status: 0 sent, 1 not sent, 2 usage or system error.
    """
    from reverie_eval.server.operations.delivery import send_test
    from reverie_eval.server.settings import SETTINGS_FILE, load_settings

    outcomes = list(send_test(load_settings(folder)))
    if not outcomes:
        file = folder / SETTINGS_FILE
        raise ReverieEvalError(f"the settings have no [mail] and no [webhook]; add one to {file}")
    for channel, error in outcomes:
        print(f"{channel}: {error or 'sent'}")
    return 1 if any(error for _, error in outcomes) else 0
