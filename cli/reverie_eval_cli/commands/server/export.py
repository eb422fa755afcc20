"""``reverie-eval server export FOLDER -o DIR``: the leaderboards as tables."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options

if TYPE_CHECKING:
    from reverie_eval.server.operations.export import Format


@click.command("export")
@options.server_folder
@click.option(
    "-o", "--output", required=True, metavar="DIR", type=options.PATH, help="A new or empty folder."
)
@options.layout("csv", "parquet", explained=" parquet needs reverie-eval[parquet].")
def export_tables(*, folder: Path, output: Path, layout: "Format") -> None:
    """Write what the leaderboards show as tables.

    These are leaderboards, results, reviews and corrections, with datapackage.json, which describes
    their columns and units, and ro-crate-metadata.json, by which archives catalogue the folder.
    Nothing is in them that the leaderboards do not show.
    """
    from reverie_eval.server.operations.export import export
    from reverie_eval.server.settings import load_settings

    tables = export(load_settings(folder), output, layout)
    counts = ", ".join(f"{each.name} ({count_text(len(each.rows), 'row')})" for each in tables)
    print(f"{output}: {counts}")
