"""``reverie-eval server evidence FOLDER SPLIT``: evidence about submissions, in numbers."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.output import note, write_text

if TYPE_CHECKING:
    from reverie_eval.reporting._table import Table
    from reverie_eval.schemas.evidence import EvidenceReport


@click.command()
@options.server_folder
@click.argument("split")
@click.option("--team", metavar="NAME", help="Also list the submissions of this team.")
@options.layout("table", "csv", "json", explained=" csv has the teams, or one team's submissions.")
@options.output("the numbers")
def evidence(
    *, folder: Path, split: str, team: str | None, layout: str, output: str | None
) -> None:
    """Show what files of different teams have in common, and how those of a team differ.

        These are numbers, not a verdict; the documentation explains each under "Inspect
    submissions". The first run reads all uploads to SPLIT, later ones only new uploads.
    """
    from reverie_eval.server.operations.checks import opened_server
    from reverie_eval.server.settings import load_settings

    with opened_server(load_settings(folder)) as state:
        report = state.evidence.report(split, team, most=None)
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


def _main_table(report: "EvidenceReport", team: str | None) -> "Table":
    from reverie_eval.reporting._evidence import history_table, teams_table

    return teams_table(report.teams) if team is None else history_table(report.history)


def _as_text(report: "EvidenceReport", team: str | None) -> str:
    from reverie_eval.reporting._evidence import pairs_table, same_files_table

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
