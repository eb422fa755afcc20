"""``reverie-eval server import FOLDER FILE``, and ``server reported list|edit|remove FOLDER``."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import get_args

import click

from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.tables import metric_cells
from reverie_eval.schemas.organising import NewImport, NewReported, Rates, ReportedChange
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, print_list, read_text, server_folder
from reverie_eval_cli.output import note


@click.command("import")
@server_folder
@click.argument("file", type=options.PATH)
@options.split
@click.option(
    "--source",
    required=True,
    metavar="TEXT",
    help="Where the results are from: a link or a text; a row of the file may name another.",
)
@click.option(
    "--dataset-version",
    default="",
    metavar="NAME",
    help="The version of the dataset that they are on, such as v2. If the split is on another, "
    "they are shown separately.  [default: not known]",
)
@options.with_default(
    "--rates",
    type=options.Choice(get_args(Rates)),
    default="percent",
    help="How FILE gives rates, such as SR: as 59.6 or as 0.596.",
)
@click.option("--dry-run", is_flag=True, help="Only show what would be added.")
def import_results(
    *,
    folder: Folder,
    file: Path,
    split: str,
    source: str,
    dataset_version: str,
    rates: Rates,
    dry_run: bool,
) -> None:
    """Import results that a paper or another leaderboard reports.

    FILE is CSV with a heading for each column (team, method, date, SR, SPL, ...), or JSON. Results
    that are already on the leaderboard are left unchanged.

    Exit status: 0 done, 1 file rejected and nothing added, 2 usage or system error.
    """
    from reverie_eval.server.service.reported import import_reported

    new = options.checked(
        NewImport,
        split=split,
        source=source,
        dataset=dataset_version,
        rates=rates,
        text=read_text(file),
        dry_run=dry_run,
    )
    tasks = folder.settings.tasks
    with folder.acting() as transaction:
        report = import_reported(transaction, new, tasks)
    if dry_run:
        _print_results(report.added)
    for text in report.repeated:
        note(text)
    if report.unread:
        note(f"not read: {', '.join(report.unread)}")
    done = "would be added" if dry_run else "added"
    counts = [f"{len(report.added):,} {done}", f"{report.known:,} already there"]
    if report.repeated:
        counts.append(f"{len(report.repeated):,} repeated")
    print(f"{split}: {count_text(report.rows, 'row')}: {', '.join(counts)}")


def _print_results(results: Sequence[NewReported]) -> None:
    scored = {key for each in results for key in each.scores}
    metrics = [metric for key, metric in CATALOGUE.items() if key in scored]
    rows = [
        (
            each.method.name,
            each.team,
            each.date or "-",
            *metric_cells(metrics, each.scores),
        )
        for each in results
    ]
    print_list(("method", "team", "date", *(metric.heading for metric in metrics)), rows)


@click.group(cls=Group)
def reported() -> None:
    """List, edit and remove reported results."""


@reported.command("list")
@server_folder
def list_results(*, folder: Folder) -> None:
    """List the reported results with their numbers, the latest first."""
    from reverie_eval.server.service.reported import list_reported

    known = folder.all_of(list_reported)
    rows = [
        (
            str(each.id),
            each.split,
            each.method.name,
            each.team,
            each.date or "-",
            each.dataset or "-",
            ", ".join(
                f"{CATALOGUE[key].label} {CATALOGUE[key].display(value)}"
                for key, value in each.scores.items()
            ),
        )
        for each in known
    ]
    print_list(("number", "split", "method", "team", "date", "dataset", "scores"), rows)


def _read_changes(
    context: click.Context,  # noqa: ARG001
    parameter: click.Parameter,  # noqa: ARG001
    words: Sequence[str],
) -> Mapping[str, str]:
    without = [word for word in words if "=" not in word]
    if without:
        raise click.BadParameter(f"expected FIELD=VALUE, found {without[0]!r}")
    return {name: value for name, _, value in (word.partition("=") for word in words)}


@reported.command()
@server_folder
@click.argument("number", type=options.Number(1))
@click.argument(
    "changes", metavar="FIELD=VALUE...", nargs=-1, required=True, callback=_read_changes
)
def edit(*, folder: Folder, number: int, changes: Mapping[str, str]) -> None:
    """Change fields of a reported result.

    A FIELD is a column of `server import`: team, method, date, source, dataset, paper, code,
    extra_data, SR, SPL, ... An empty VALUE removes the old one.
    """
    from reverie_eval.server.service.reported import change_reported
    from reverie_eval.server.service.reported_files import read_change

    change, tasks = options.checked(ReportedChange, **read_change(changes)), folder.settings.tasks
    with folder.acting() as transaction:
        changed = change_reported(transaction, number, change, tasks)
    print(f"reported result {changed.id} ({changed.method.name}) changed")


@reported.command()
@server_folder
@click.argument("numbers", metavar="NUMBER...", type=options.Number(1), nargs=-1, required=True)
def remove(*, folder: Folder, numbers: Sequence[int]) -> None:
    """Remove reported results from their leaderboards."""
    from reverie_eval.server.service.reported import remove_reported

    with folder.acting() as transaction:
        # A number that is given twice is removed once, and not an error the second time.
        for number in dict.fromkeys(numbers):
            remove_reported(transaction, number)
    print(f"{count_text(len(set(numbers)), 'reported result')} removed")
