"""``reverie-eval server export-evalai|evalai-worker FOLDER``: a challenge on EvalAI."""

import gc
from functools import partial
from pathlib import Path

import click

from reverie_eval_cli import options
from reverie_eval_cli.output import note, write_text


@click.command("export-evalai")
@options.server_folder
@options.output("the configuration")
def export_evalai(*, folder: Path, output: str | None) -> None:
    """Write all splits as phases and leaderboards of a challenge on EvalAI.

    That is their part of EvalAI's challenge_config.yaml, without answers. Title, texts and dates of
    the challenge itself are yours to add.
    """
    from reverie_eval.server.operations.evalai import export_evalai
    from reverie_eval.server.settings import load_settings

    config = export_evalai(load_settings(folder))
    for sentence in config.left_out:
        note(f"not in the challenge: {sentence}")
    write_text(config.text, output)


@click.command("evalai-worker")
@options.server_folder
def evalai_worker(*, folder: Path) -> None:
    """Score the submissions to a challenge on EvalAI, until it is stopped.

    The section [evalai] of the settings names the challenge. Files are fetched from there and
    scored here, as on the server; EvalAI gets the scores that a leaderboard displays. If the worker
    is killed and started again, it finishes what it had begun, once.

    Exit status: 0 stopped, 1 settings or data are not sound, 2 usage or system error.
    """
    from reverie_eval.server.operations.checks import check_sound
    from reverie_eval.server.operations.evalai_worker import run_worker

    gc.enable()  # off in this command, which pays off in short lives only
    run_worker(check_sound(folder, note), partial(print, flush=True))
