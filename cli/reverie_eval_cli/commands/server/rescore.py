"""``reverie-eval server rescore FOLDER SPLIT``: score submissions again after a correction."""

import os
from collections.abc import Iterable, Sequence
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from reverie_eval.reporting.tables import cell_of, metric_cell
from reverie_eval.schemas.organising import NewCorrection, ResultChange
from reverie_eval.tasks import Task
from reverie_eval.text import count_text
from reverie_eval_cli import options
from reverie_eval_cli.organising import Folder, actor, print_list, server_folder
from reverie_eval_cli.output import note, with_progress

if TYPE_CHECKING:
    from reverie_eval.server.service.rescoring import Job, Outcome


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
    are scored from their uploads; so are those without a result on a further leaderboard. Dates,
    quotas and reviews stay the same; the earlier results and receipts are kept. With --bundle, the
    ground truth and all results are replaced at once, also of servers that run. If it is
    interrupted, run it again.

    Prints how every result changed, the largest changes first, for each leaderboard of the split.

    Exit status: 0 all were scored, 1 some cannot be scored again, 2 usage or system error.
    """
    from reverie_eval.server.operations import rescoring

    if reason is None and not dry_run:
        raise click.UsageError("give a --reason, or --dry-run to change nothing")
    settings, jobs = folder.settings, jobs or os.cpu_count() or 1
    if reason is None or dry_run:
        changes = rescoring.preview(settings, split, bundle, jobs=jobs, progress=_progress)
    else:
        new = options.checked(NewCorrection, split=split, reason=reason)
        if bundle is not None:
            changes, earlier = rescoring.correct(
                settings, split, bundle, new.reason, actor=actor(), jobs=jobs, progress=_progress
            )
            note(f"servers that run use the new ground truth; the earlier one is now {earlier}")
        else:
            changes = rescoring.rescore(
                settings, split, new.reason, actor=actor(), jobs=jobs, progress=_progress
            )
    _print(changes, settings.tasks[split])
    failed = sum(bool(change.problem) for change in changes)
    if failed:
        note(f"{count_text(failed, 'submission')} cannot be scored again, and kept the old result")
    return 1 if failed else 0


def _progress(
    outcomes: "Iterable[tuple[Job, Outcome]]", number: int
) -> "Iterable[tuple[Job, Outcome]]":
    return with_progress(outcomes, "scoring again", number)


def _print(changes: Sequence[ResultChange], task: Task) -> None:
    """Print a table for each leaderboard of the split."""
    if not changes:
        note("there are no submissions")
    for further, group in groupby(changes, attrgetter("board")):
        if further:
            print(f"\n{further}")
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
