"""``reverie-eval server export-site SOURCE -o FOLDER``: the public pages as files."""

from datetime import datetime
from pathlib import Path

import click

from reverie_eval_cli import options
from reverie_eval_cli.output import note


@click.command("export-site")
@click.argument("source", metavar="FOLDER|BACKUP", type=click.Path(exists=True, path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FOLDER",
    type=options.PATH,
    help="The folder to write; an earlier copy in it is replaced.",
)
@click.option(
    "--date",
    type=options.Time(),
    help="The time of the copy.  [default: now, or when the backup was made]",
)
def export_site(*, source: Path, output: Path, date: datetime | None) -> int:
    """Write the public leaderboards as files.

    Of a server's folder, also while the server runs, or of a backup. The files need no server: open
    index.html, or publish the folder anywhere. They have only what a visitor sees who is not signed
    in. ro-crate-metadata.json describes them to archives.

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
