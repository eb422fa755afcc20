"""``reverie-eval server inspect FOLDER SUBMISSION_ID``: the values of a submission's episodes."""

from pathlib import Path

import click

from reverie_eval_cli import options
from reverie_eval_cli.organising import actor
from reverie_eval_cli.output import STANDARD_OUTPUT, note, open_output

_OWNER_ONLY = 0o600


@click.command()
@options.server_folder
@click.argument("submission_id")
@options.layout("table", "csv", "json", explained=" csv and json have all metrics, unrounded.")
@options.output("the values")
def inspect(*, folder: Path, submission_id: str, layout: str, output: str | None) -> None:
    """Show the values of every episode of a submission.

    They are computed again from the upload, and their means are the stored scores. This also shows
    what a private split keeps secret, so it works on the server's own machine only, and the audit
    log records it. A new FILE can be read by its owner alone.
    """
    from reverie_eval.reporting._scores import episode_table, episodes_json, write_episodes
    from reverie_eval.server.operations.inspection import inspect as inspected
    from reverie_eval.server.settings import load_settings

    submission, scores = inspected(load_settings(folder), submission_id, actor=actor())
    note(f"{submission.method.name} by {submission.team}, {scores.signature}")
    with open_output(output or STANDARD_OUTPUT, mode=_OWNER_ONLY) as file:
        match layout:
            case "csv":
                write_episodes(scores, file)
            case "json":
                file.write(f"{episodes_json(scores)}\n")
            case _:
                file.write(f"{episode_table(scores).to_text()}\n")
