"""``reverie-eval server inspect|evidence|export``: what was submitted, to read."""

from collections.abc import Iterator
from pathlib import Path

import click

from reverie_eval.files import staged_file
from reverie_eval.reporting.service import history_table, pairs_table, same_files_table, teams_table
from reverie_eval.reporting.tables import Part, Printout
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, actor, server_folder
from reverie_eval_cli.output import (
    STANDARD_OUTPUT,
    note,
    open_output,
    show_printout,
    with_progress,
    write_text,
)

_OWNER_ONLY = 0o600

_source = click.argument(
    "source", metavar="FOLDER|BACKUP", type=click.Path(exists=True, path_type=Path)
)


@click.command()
@server_folder
@click.argument("submission_id")
@options.layout("table", "csv", "json", explained=" csv and json have all metrics, unrounded.")
@options.output("the values")
def inspect(*, folder: Folder, submission_id: str, layout: str, output: str | None) -> None:
    """Show the values of every episode of a submission.

    They are computed again from the upload, and their means are the stored scores. This also shows
    what a private split keeps secret, so it works on the server's own machine only, and the audit
    log records it. A new FILE can be read by its owner alone.
    """
    from reverie_eval.reporting.scores import episode_table, episodes_json, write_episodes
    from reverie_eval.server.intake.submissions import SubmissionService

    with folder.open() as state:
        submission, scores = state.get(SubmissionService).inspect(submission_id, actor())
    # On standard error, so that a file or a pipe has the values alone.
    note(f"{submission.method.name} by {submission.team}, {scores.signature}")
    with open_output(output or STANDARD_OUTPUT, mode=_OWNER_ONLY) as file:
        match layout:
            case "csv":
                write_episodes(scores, file)
            case "json":
                file.write(f"{episodes_json(scores)}\n")
            case _:
                file.write(f"{episode_table(scores).to_text()}\n")


@click.command()
@server_folder
@click.argument("split")
@click.option("--team", metavar="NAME", help="Also list the submissions of this team.")
@options.layout("table", "csv", "json", explained=" csv has the teams, or one team's submissions.")
@options.output("the numbers")
def evidence(
    *, folder: Folder, split: str, team: str | None, layout: str, output: str | None
) -> None:
    """Show what the files of teams have in common.

    Also shows how those of one team differ.

    These are numbers, not a verdict; the documentation explains each under "Inspect
    submissions". All uploads to SPLIT are read.
    """
    from reverie_eval.server.operations.evidence import gather_evidence

    with folder.open() as state:
        report = gather_evidence(state, split, team, with_progress)
    for submission, reason in report.unreadable.items():
        note(f"{submission} is left out: {reason}")
    of_teams = teams_table(report.teams) if team is None else history_table(report.history)

    def parts() -> Iterator[Part]:
        yield Part(note=f"{count_text(report.submissions, 'submission')} to {report.split}")
        if report.same_files:
            yield Part([same_files_table(report.same_files)], "The same file from several teams:\n")
        if report.similar:
            yield Part([pairs_table(report)], "The most similar files of two teams:\n")
        if report.teams:
            heading = "Files of each team:" if team is None else f"Submissions of {team}:"
            yield Part([of_teams], f"{heading}\n")

    shown = Printout(
        lambda: list(parts()), lambda: report.model_dump_json(indent=2), of_teams.to_csv
    )
    show_printout(shown, layout, output)


@click.group(cls=Group)
def export() -> None:
    """Write leaderboards or submissions, to keep or for others."""


@export.command()
@server_folder
@click.argument("split")
@options.new_path("FILE", "The .tar to write.")
def submissions(*, folder: Folder, split: str, output: Path) -> None:
    """Write all submissions to SPLIT into one tar archive.

    It has metadata.csv, with a row per submission, and every file as it was submitted, unpacked.
    The archive appears complete or not at all; a new one can be read by its owner alone.
    """
    from reverie_eval.server.boards.schedules import View
    from reverie_eval.server.intake.bulk import archive_of
    from reverie_eval.server.state import Reading

    with folder.open() as state:
        with state.database.reading() as session:
            view = View.of(Reading(state, session, state.clock()))
            archive = archive_of(session, state.board(split), state.uploads, view)
        with staged_file(output, mode=_OWNER_ONLY) as file:
            file.writelines(archive.pieces())
    print(f"{output}: {count_text(archive.files, 'submission')}, {archive.length / 1e6:,.1f} MB")


@export.command()
@_source
@options.new_path("DIR", "A new or empty folder.")
def tables(*, source: Path, output: Path) -> None:
    """Write what the leaderboards show as tables.

    Of a server's folder, also while the server runs, or of a backup. The tables are leaderboards,
    results, reviews and corrections, as CSV, with datapackage.json, which describes their columns
    and units. Nothing is in them that the leaderboards do not show.
    """
    from reverie_eval.server.platforms.export import export as written

    counts = ", ".join(
        f"{each.name} ({count_text(len(each.rows), 'row')})" for each in written(source, output)
    )
    print(f"{output}: {counts}")


@export.command()
@_source
@options.new_path("FOLDER", "The folder to write; an earlier copy in it is replaced.")
def site(*, source: Path, output: Path) -> int:
    """Write the public leaderboards as files.

    Of a server's folder, also while the server runs, or of a backup. The files need no server: open
    index.html, or publish the folder anywhere. They have only what a visitor sees who is not signed
    in.

    Exit status: 0 written, 1 a backup or the settings are rejected, 2 usage or system error.
    """
    from reverie_eval.server.platforms.site import export_site

    report = export_site(source, output)
    print(
        f"{output}: {report.files:,} files, {report.size / 1e6:,.1f} MB, "
        f"as of {report.copied_at:%Y-%m-%d %H:%M:%S} UTC"
    )
    if not report.address:
        note("public_address is not set, so the pages and their citations name no server")
    return 0


@export.command()
@server_folder
@options.split
@click.option(
    "--image", metavar="NAME", required=True, help="A container image that has reverie-eval."
)
@options.new_path("ZIP", "The file to write.")
def codabench(*, folder: Folder, split: str, image: str, output: Path) -> None:
    """Write a split as a competition for Codabench.

    The zip archive has the split's rules, phases and quotas, the scoring program, and the solution:
    upload it to a Codabench that you trust, and show it to nobody else.
    """
    from reverie_eval.server.platforms.codabench import export_codabench

    for sentence in export_codabench(folder.settings, split, image, output):
        note(f"not in the competition: {sentence}")
    print(f"{output}: {split}, with its solution")


@export.command()
@server_folder
@options.output("the configuration")
def evalai(*, folder: Folder, output: str | None) -> None:
    """Write all splits as phases of a challenge on EvalAI.

    With their leaderboards: their part of EvalAI's challenge_config.yaml, without the solution.
    Title, texts and dates of the challenge itself are yours to add.
    """
    from reverie_eval.server.platforms.evalai import export_evalai

    config = export_evalai(folder.settings)
    for sentence in config.left_out:
        note(f"not in the challenge: {sentence}")
    write_text(config.text, output)
