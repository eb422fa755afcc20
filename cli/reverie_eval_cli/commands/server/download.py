"""``reverie-eval server download FOLDER SPLIT -o FILE``: all submissions to a split."""

from pathlib import Path

import click

from reverie_eval.files import staged_file
from reverie_eval.text import count_text
from reverie_eval_cli import options

_OWNER_ONLY = 0o600


@click.command()
@options.server_folder
@click.argument("split")
@click.option(
    "-o", "--output", required=True, metavar="FILE", type=options.PATH, help="The .tar to write."
)
def download(*, folder: Path, split: str, output: Path) -> None:
    """Write all submissions to SPLIT into one tar archive.

    It has metadata.csv, with a row per submission, and every file as it was submitted, unpacked.
    The archive appears complete or not at all; a new one can be read by its owner alone.
    """
    from reverie_eval.server.operations.checks import opened_server
    from reverie_eval.server.service.bulk import archive_of
    from reverie_eval.server.settings import load_settings

    with opened_server(load_settings(folder)) as state:
        with state.database.reading() as session:
            view = state.submissions.view(session, state.clock())
            archive = archive_of(session, state.board(split), state.uploads, view)
        with staged_file(output, mode=_OWNER_ONLY) as file:
            file.writelines(archive.pieces())
    print(f"{output}: {count_text(archive.files, 'submission')}, {archive.length / 1e6:,.1f} MB")
