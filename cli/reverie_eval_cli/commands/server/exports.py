"""``reverie-eval server export|export-site|export-codabench|export-evalai|evalai-worker``.

A server's leaderboards as tables and as pages, and its splits on other platforms.
"""

import gc
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.organising import Folder, server_folder
from reverie_eval_cli.output import note, write_text

if TYPE_CHECKING:
    from reverie_eval.server.operations.export import Format


@click.command("export")
@server_folder
@options.new_path("DIR", "A new or empty folder.")
@options.layout("csv", "parquet", explained=" parquet needs reverie-eval[parquet].")
def export_tables(*, folder: Folder, output: Path, layout: "Format") -> None:
    """Write what the leaderboards show as tables.

    These are leaderboards, results, reviews and corrections, with datapackage.json, which describes
    their columns and units. Nothing is in them that the leaderboards do not show.
    """
    from reverie_eval.server.operations.export import export

    tables = export(folder.settings, output, layout)
    counts = ", ".join(f"{each.name} ({count_text(len(each.rows), 'row')})" for each in tables)
    print(f"{output}: {counts}")


@click.command("export-site")
@click.argument("source", metavar="FOLDER|BACKUP", type=click.Path(exists=True, path_type=Path))
@options.new_path("FOLDER", "The folder to write; an earlier copy in it is replaced.")
@click.option(
    "--date",
    type=options.Time(),
    help="The time of the copy.  [default: now, or when the backup was made]",
)
def export_site(*, source: Path, output: Path, date: datetime | None) -> int:
    """Write the public leaderboards as files.

    Of a server's folder, also while the server runs, or of a backup. The files need no server: open
    index.html, or publish the folder anywhere. They have only what a visitor sees who is not signed
    in.

    Exit status: 0 written, 1 a backup or the settings are rejected, 2 usage or system error.
    """
    from reverie_eval.server.operations.site import export_site

    report = export_site(source, output, date)
    print(
        f"{output}: {report.files:,} files, {report.size / 1e6:,.1f} MB, "
        f"as of {report.copied_at:%Y-%m-%d %H:%M:%S} UTC"
    )
    if not report.address:
        note("public_address is not set, so the pages and their citations name no server")
    return 0


@click.command("export-codabench")
@server_folder
@options.split
@click.option(
    "--image", metavar="NAME", required=True, help="A container image that has reverie-eval."
)
@options.new_path("ZIP", "The file to write.")
def export_codabench(*, folder: Folder, split: str, image: str, output: Path) -> None:
    """Write a split as a competition for Codabench.

    The zip archive has the split's rules, phases and quotas, the scoring program, and the solution:
    upload it to a Codabench that you trust, and show it to nobody else.
    """
    from reverie_eval.server.operations.codabench import export_codabench

    for sentence in export_codabench(folder.settings, split, image, output):
        note(f"not in the competition: {sentence}")
    print(f"{output}: {split}, with its solution")


@click.command("export-evalai")
@server_folder
@options.output("the configuration")
def export_evalai(*, folder: Folder, output: str | None) -> None:
    """Write all splits as phases and leaderboards of a challenge on EvalAI.

    That is their part of EvalAI's challenge_config.yaml, without the solution. Title, texts and
    dates of the challenge itself are yours to add.
    """
    from reverie_eval.server.operations.evalai import export_evalai

    config = export_evalai(folder.settings)
    for sentence in config.left_out:
        note(f"not in the challenge: {sentence}")
    write_text(config.text, output)


@click.command("evalai-worker")
@server_folder
def evalai_worker(*, folder: Folder) -> None:
    """Score the submissions to a challenge on EvalAI, until it is stopped.

    The section [evalai] of the settings names the challenge. Files are fetched from there and
    scored here, as on the server; EvalAI gets the scores that a leaderboard displays. If the worker
    is killed and started again, it finishes what it had begun, once.

    Exit status: 0 stopped, 1 settings or data are not sound, 2 usage or system error.
    """
    from reverie_eval.server.operations.checks import check_sound
    from reverie_eval.server.operations.evalai_worker import run_worker

    gc.enable()  # off in this command, which pays off in short lives only
    run_worker(check_sound(folder.path, note), partial(print, flush=True))
