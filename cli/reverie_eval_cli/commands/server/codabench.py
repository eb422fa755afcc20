"""``reverie-eval server export-codabench FOLDER --split NAME -o ZIP``: a competition elsewhere."""

from pathlib import Path

import click

from reverie_eval_cli import options
from reverie_eval_cli.output import note


@click.command("export-codabench")
@options.server_folder
@options.split
@click.option(
    "--image", metavar="NAME", required=True, help="A container image that has reverie-eval."
)
@click.option(
    "-o", "--output", required=True, metavar="ZIP", type=options.PATH, help="The file to write."
)
def export_codabench(*, folder: Path, split: str, image: str, output: Path) -> None:
    """Write a split as a competition for Codabench.

    The zip archive has the split's rules, phases and quotas, the scoring program, and the answers:
    upload it to a Codabench that you trust, and show it to nobody else.
    """
    from reverie_eval.server.operations.codabench import export_codabench
    from reverie_eval.server.settings import load_settings

    for sentence in export_codabench(load_settings(folder), split, image, output):
        note(f"not in the competition: {sentence}")
    print(f"{output}: {split}, with its answers")
