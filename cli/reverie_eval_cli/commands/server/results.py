"""``reverie-eval server submit|submissions|review|rescore|import|reported``: results."""

import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import click

from reverie_eval.logs import is_run, submission_in
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.tables import cell_of, metric_cell, metric_cells
from reverie_eval.schemas.organising import (
    EmailedFile,
    NewCorrection,
    NewImport,
    NewReported,
    NewReview,
    Rates,
    ReportedChange,
    ResultChange,
)
from reverie_eval.schemas.service import Verdict
from reverie_eval.submissions import find_files
from reverie_eval.tasks import Task
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.commands.evaluation_server import MethodOptions, method_options, with_card
from reverie_eval_cli.groups import Group
from reverie_eval_cli.organising import Folder, actor, minute, print_list, read_text, server_folder
from reverie_eval_cli.output import note, with_progress
from reverie_eval_cli.servers import keep_receipts

if TYPE_CHECKING:
    from reverie_eval.server.store.tables import Submission


@click.command()
@server_folder
@click.argument("files", metavar="FILE|FOLDER", type=click.Path(exists=True, path_type=Path))
@options.split
@click.option("--team", required=True, metavar="NAME", help="The team that sent it.")
@click.option("--person", required=True, metavar="NAME", help="The person who sent it.")
@click.option(
    "--received",
    required=True,
    type=options.Time(),
    help="When it came, with the time zone: 2027-06-01T12:00:00Z.",
)
@method_options
@click.option("--publish", is_flag=True, help="Put the result on the leaderboard at once.")
def submit(
    *,
    folder: Folder,
    files: Path,
    split: str,
    team: str,
    person: str,
    received: datetime,
    method: MethodOptions,
    publish: bool,
) -> int:
    """Submit files that people sent to you, by e-mail for example.

    They are checked, scored and counted as if they had been uploaded when they were received, also
    while submissions are paused. The audit log names you. Prints a reply to each file, and writes
    its receipt beside it. Submitting a file again prints the same result, and uses no submission.

    Exit status: 0 all were scored, 1 some were refused, 2 usage or system error.
    """
    from reverie_eval.server.errors import RequestError
    from reverie_eval.server.intake.intake import submit_for_sender

    file = options.checked(
        EmailedFile, split=split, team=team, person=person, received_at=received, publish=publish
    )
    found = [Path(path) for path in find_files([str(files)])]
    chosen = [submission_in(path) if is_run(path) else path for path in found]
    # All are described before the first is scored, so that a wrong option leaves nothing half done.
    described = [with_card(method, str(path)).method(str(path)) for path in found]
    failed = False
    with folder.open() as state:
        for number, (path, each) in enumerate(zip(chosen, described, strict=True)):
            try:
                report = submit_for_sender(
                    state, actor(), file, path.read_bytes(), each, filename=path.name
                )
            except RequestError as refusal:
                # Without a text for the sender, the refusal is about the command, not about the
                # file.
                if refusal.reply is None:
                    raise
                failed, reply = True, refusal.reply
            else:
                reply = report.reply
                for receipt in keep_receipts(report.submission, None, str(path)):
                    note(f"attach {receipt}")
            print(*(["", "-" * 72, ""] if number else []), reply, sep="\n")
    return 1 if failed else 0


@click.command()
@server_folder
@click.option("--split", metavar="NAME", help="Only those to this split.")
@click.option("--team", metavar="NAME", help="Only those of this team.")
def submissions(*, folder: Folder, split: str | None, team: str | None) -> None:
    """List the submissions of all teams, the latest first."""
    from reverie_eval.server.accounts.people import team_named
    from reverie_eval.server.boards.schedules import Schedules
    from reverie_eval.server.intake.submissions import all_submissions

    with folder.reading() as session:
        if team is not None:
            team_named(session, team)
        rows = [_cells(row) for row in all_submissions(session, split=split, team=team)]
        if split is not None and not rows:  # the settings may not have it any more
            Schedules(folder.settings.splits).of_split(session, split)
    headings = ("submission", "received (UTC)", "split", "team", "person", "method", "status")
    print_list(headings, rows)


def _cells(row: "Submission") -> tuple[str, ...]:
    names = row.team.name, row.person.name, str(row.method["name"])
    return row.id, minute(row.received_at), row.split, *names, row.status


@click.group(cls=Group)
def review() -> None:
    """Publish verdicts on submissions, each with its reason."""


@review.command()
@server_folder
@click.argument("submission")
@click.argument("verdict", type=options.Choice(get_args(Verdict)))
@click.option("--reason", required=True, metavar="TEXT", help="The reason, which is public.")
def add(*, folder: Folder, submission: str, verdict: str, reason: str) -> None:
    """Review a submission.

    A disqualified result is shown separately, without a rank.
    """
    from reverie_eval.server.boards.reviews import review as add_review

    new = options.checked(NewReview, submission_id=submission, verdict=verdict, reason=reason)
    with folder.acting() as transaction:
        added = add_review(transaction, new)
    print(f"review {added.id}: {submission} is {verdict}")


@review.command("list")
@server_folder
def list_all(*, folder: Folder) -> None:
    """List all reviews with their numbers, the latest first."""
    from reverie_eval.server.boards.reviews import list_reviews

    known = folder.all_of(list_reviews)
    rows = [
        (
            *(str(each.id), minute(each.created_at), each.submission_id),
            *(each.verdict, each.reason, minute(each.lifted_at)),
        )
        for each in known
    ]
    print_list(("number", "made (UTC)", "submission", "verdict", "reason", "lifted (UTC)"), rows)


@review.command()
@server_folder
@click.argument("number", type=options.Number(1))
def lift(*, folder: Folder, number: int) -> None:
    """Lift a review."""
    from reverie_eval.server.boards.reviews import lift_review

    with folder.acting() as transaction:
        lift_review(transaction, number)
    print(f"review {number} lifted")


@click.command()
@server_folder
@click.argument("split")
@click.option("--reason", metavar="TEXT", help="Why; shown on the leaderboard with the date.")
@click.option(
    "--bundle",
    metavar="FILE",
    type=options.PATH,
    help="New ground truth for the split; replaces the bundle that the settings name.",
)
@click.option("--dry-run", is_flag=True, help="Show how results would change; change nothing.")
@options.jobs
def rescore(
    *,
    folder: Folder,
    split: str,
    reason: str | None,
    bundle: Path | None,
    dry_run: bool,
    jobs: int | None,
) -> int:
    """Score submissions again after a correction.

    All submissions to SPLIT that were scored with other ground truth or rules than the current ones
    are scored from their uploads; so are those without a result on another leaderboard. Dates,
    quotas and reviews stay the same; the earlier results and receipts are kept. All results are
    replaced at once; with --bundle, so is the ground truth, also of servers that run. If it is
    interrupted, nothing has changed.

    Prints how every result changed, the largest changes first, for each leaderboard of the split.

    Exit status: 0 all were scored, 1 some cannot be scored again, 2 usage or system error.
    """
    from reverie_eval.server.operations import scoring_again

    if reason is None and not dry_run:
        raise click.UsageError("give a --reason, or --dry-run to change nothing")
    settings, jobs = folder.settings, jobs or os.cpu_count() or 1
    # A preview needs no reason, because nothing is shown to anyone.
    if reason is None or dry_run:
        changes = scoring_again.preview(settings, split, bundle, jobs=jobs, progress=with_progress)
    else:
        new = options.checked(NewCorrection, split=split, reason=reason)
        if bundle is not None:
            changes, earlier = scoring_again.replace_ground_truth(
                settings,
                split,
                bundle,
                new.reason,
                actor=actor(),
                jobs=jobs,
                progress=with_progress,
            )
            note(f"servers that run use the new ground truth; the earlier one is now {earlier}")
        else:
            changes = scoring_again.rescore(
                settings, split, new.reason, actor=actor(), jobs=jobs, progress=with_progress
            )
    _print(changes, settings.tasks[split])
    failed = sum(bool(change.problem) for change in changes)
    if failed:
        note(f"{count_text(failed, 'submission')} cannot be scored again, and kept the old result")
    return 1 if failed else 0


def _print(changes: Sequence[ResultChange], task: Task) -> None:
    """Print a table for each leaderboard of the split."""
    if not changes:
        note("there are no submissions")
    # They come leaderboard by leaderboard, as groupby needs them.
    for name, group in groupby(changes, attrgetter("board")):
        if name:
            print(f"\n{name}")
        _print_board(list(group), task)


def _print_board(changes: Sequence[ResultChange], task: Task) -> None:
    # A result without answers has no RGSPL: the metric is one that any of the results has.
    metric = task.primary_metric(set().union(*(c.before.keys() | c.after.keys() for c in changes)))
    rows = [
        (
            change.submission_id,
            change.team,
            change.method,
            metric_cell(metric, change.before),
            metric_cell(metric, change.after),
            f"{cell_of(change.rank_before)} -> {cell_of(change.rank_after)}",
            change.problem,
        )
        for change in changes
    ]
    before, after = f"{metric.label} before", f"{metric.label} after"
    print_list(("submission", "team", "method", before, after, "rank", "problem"), rows)


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
    "--date",
    metavar="DATE",
    help="When they were published, such as 2020-06; a row of the file may name another.  "
    "[default: not known]",
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
@click.option(
    "--human",
    multiple=True,
    metavar="NAME",
    help="A row of FILE that is of people, if no column says so; can be repeated.",
)
@click.option(
    "--reference",
    multiple=True,
    metavar="NAME",
    help="A row of FILE that is no method but something to compare with, such as chance or the "
    "shortest path; can be repeated.",
)
@click.option("--dry-run", is_flag=True, help="Only show what would be added.")
def import_results(
    *,
    folder: Folder,
    file: Path,
    split: str,
    source: str,
    date: str | None,
    dataset_version: str,
    rates: Rates,
    human: Sequence[str],
    reference: Sequence[str],
    dry_run: bool,
) -> None:
    """Import results that a paper or another leaderboard reports.

    FILE is CSV with a heading for each column (team, method, date, SR, SPL, ...), or JSON. Results
    that are already on the leaderboard are left unchanged.

    Exit status: 0 done, 1 file rejected and nothing added, 2 usage or system error.
    """
    from reverie_eval.server.boards.reported import import_reported

    new = options.checked(
        NewImport,
        split=split,
        source=source,
        date=date,
        dataset=dataset_version,
        rates=rates,
        text=read_text(file),
        human=list(human),
        reference=list(reference),
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
    # Rows of the file that are there twice: worth a look, but not an error.
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
    from reverie_eval.server.boards.reported import list_reported

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
    from reverie_eval.server.boards.reported import change_reported
    from reverie_eval.server.boards.reported_files import read_change

    # Read as the columns of a file are, so that both take the same words.
    change, tasks = read_change(ReportedChange, changes), folder.settings.tasks
    with folder.acting() as transaction:
        changed = change_reported(transaction, number, change, tasks)
    print(f"reported result {changed.id} ({changed.method.name}) changed")


@reported.command()
@server_folder
@click.argument("numbers", metavar="NUMBER...", type=options.Number(1), nargs=-1, required=True)
def remove(*, folder: Folder, numbers: Sequence[int]) -> None:
    """Remove reported results from their leaderboards."""
    from reverie_eval.server.boards.reported import remove_reported

    with folder.acting() as transaction:
        # A number that is given twice is removed once, and not an error the second time.
        for number in dict.fromkeys(numbers):
            remove_reported(transaction, number)
    print(f"{count_text(len(set(numbers)), 'reported result')} removed")
