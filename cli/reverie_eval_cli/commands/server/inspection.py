"""``reverie-eval server inspect|evidence|download``: what was submitted, episode by episode."""

from pathlib import Path

import click

from reverie_eval.files import staged_file
from reverie_eval.reporting.service import (
    history_table,
    pairs_table,
    same_files_table,
    teams_table,
)
from reverie_eval.reporting.tables import Table
from reverie_eval.schemas.evidence import EvidenceReport
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.organising import Folder, actor, server_folder
from reverie_eval_cli.output import STANDARD_OUTPUT, note, open_output, write_text

_OWNER_ONLY = 0o600


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
    from reverie_eval.server.operations.inspection import inspect as inspected

    submission, scores = inspected(folder.settings, submission_id, actor=actor())
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
    """Show what files of different teams have in common, and how those of a team differ.

    These are numbers, not a verdict; the documentation explains each under "Inspect
    submissions". The first run reads all uploads to SPLIT, later ones only new uploads.
    """
    with folder.open() as state:
        report = state.evidence.report_on_all(split, team)
    for submission, reason in report.unreadable.items():
        note(f"{submission} is left out: {reason}")
    match layout:
        case "json":
            text = report.model_dump_json(indent=2)
        case "csv":
            text = _main_table(report, team).to_csv()
        case _:
            text = _as_text(report, team)
    write_text(f"{text}\n", output)


def _main_table(report: EvidenceReport, team: str | None) -> Table:
    return teams_table(report.teams) if team is None else history_table(report.history)


def _as_text(report: EvidenceReport, team: str | None) -> str:
    parts = [f"{count_text(report.submissions, 'submission')} to {report.split}"]
    if report.same_files:
        parts += [
            "The same file from several teams:",
            same_files_table(report.same_files).to_text(),
        ]
    if report.similar:
        parts += ["The most similar files of two teams:", pairs_table(report).to_text()]
    if report.teams:
        heading = "Files of each team:" if team is None else f"Submissions of {team}:"
        parts += [heading, _main_table(report, team).to_text()]
    return "\n\n".join(parts)


@click.command()
@server_folder
@click.argument("split")
@options.new_path("FILE", "The .tar to write.")
def download(*, folder: Folder, split: str, output: Path) -> None:
    """Write all submissions to SPLIT into one tar archive.

    It has metadata.csv, with a row per submission, and every file as it was submitted, unpacked.
    The archive appears complete or not at all; a new one can be read by its owner alone.
    """
    from reverie_eval.server.service.bulk import archive_of

    with folder.open() as state:
        with state.database.reading() as session:
            view = state.submissions.view(session, state.clock())
            archive = archive_of(session, state.board(split), state.uploads, view)
        with staged_file(output, mode=_OWNER_ONLY) as file:
            file.writelines(archive.pieces())
    print(f"{output}: {count_text(archive.files, 'submission')}, {archive.length / 1e6:,.1f} MB")
