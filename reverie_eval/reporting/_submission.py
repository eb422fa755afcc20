"""What a server replies about a submission: its scores, status, quota and receipt."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from datetime import timedelta
from types import MappingProxyType

from reverie_eval.errors import ProtocolError
from reverie_eval.ground_truth import DEMO_DATASET
from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting._table import MISSING, Table, cell_of, metric_cell, metric_cells
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import (
    WINDOWS,
    Accepted,
    QuotaReport,
    Receipt,
    Snapshot,
    SubmissionReport,
    WindowName,
)
from reverie_eval.scoring import task_of
from reverie_eval.tasks import Task
from reverie_eval.text import count_text, earliest_time_text, printable, time_text

_DAY = timedelta(days=1)
WINDOW_LENGTHS: Mapping[WindowName, str] = MappingProxyType(
    {
        name: count_text(length // timedelta(hours=1), "hour")
        if length <= _DAY
        else count_text(length // _DAY, "day")
        for name, length in WINDOWS.items()
    }
)
"""The lengths of the windows of quotas in words: "24 hours"."""


def headline_of(signature: str, scored: Collection[str]) -> Sequence[Metric]:
    """Return the headline metrics that a result has values for.

    The task decides which they are; if it is not installed here, all known metrics are returned.
    """
    task = known_task(signature)
    if task is None:
        return [metric for key, metric in CATALOGUE.items() if key in scored]
    return task.headline_metrics(scored)


def known_task(signature: str) -> Task | None:
    """Return the task that a signature names; None if it is not installed here."""
    try:
        return task_of(signature)
    except ProtocolError:
        return None


def submission_table(report: ScoreReport, server: str) -> Table:
    """Return the scores that a server gave."""
    task = known_task(report.signature)
    provenance = (
        f"the synthetic demo world, not {task.title}"
        if task and report.dataset == DEMO_DATASET
        else f"on {server} ({report.dataset})"
    )
    metrics = (
        task.table_metrics(report.scores) if task else headline_of(report.signature, report.scores)
    )
    notes = [report.signature, f"ground truth: {provenance}", *map("note: {}".format, report.notes)]
    return Table(
        headings=[metric.heading for metric in metrics],
        rows=[metric_cells(metrics, report.scores)],
        notes=list(map(printable, notes)),
    )


def result_tables(submission: SubmissionReport, server: str) -> Mapping[str, Table]:
    """Return the scores on each leaderboard of the split by its name; empty while held back.

    The name of the split's own leaderboard is "".
    """
    if submission.scores_held_until is not None:
        return {}
    return {
        further: submission_table(result.report, server)
        for further, result in submission.results.items()
    }


def submission_lines(accepted: Accepted, *, to_publish: str, to_change: str) -> Iterator[str]:
    """Yield which submission it is, its status, and what to do to publish or change it."""
    submission = accepted.submission
    about = f"submission {submission.id} of {submission.team}: {submission.method.name}"
    yield printable(f"{about}, received {time_text(submission.received_at)}")
    if accepted.is_repeat:
        yield "this file was already scored; no submission was used"
    if accepted.ignored:
        words = ", ".join(name.replace("_", " ") for name in accepted.ignored)
        yield f"ignored, because the first upload said otherwise: {words}; {to_change}"
    for result in submission.earlier:
        scores = ", ".join(
            f"{metric.label} {metric.display(result.report.scores[metric.key])}"
            for metric in headline_of(result.report.signature, result.report.scores)
        )
        again = f"scored again at {time_text(result.replaced_at)}: {result.reason}"
        yield printable(f"{again}; before, it had {scores}")
    if submission.scores_held_until is not None:
        ends = time_text(submission.scores_held_until)
        yield f"scores are published when the phase ends at {ends}"
    if submission.status == "unpublished":
        yield f"not published: {to_publish}"
    else:
        yield submission.status


def quota_lines(quota: QuotaReport, split: str) -> Iterator[str]:
    """Yield how many submissions are left, and when there will be more."""
    when = f"; next possible at {earliest_time_text(quota.next_at)}" if quota.next_at else ""
    yield f"submissions left on {split}: {quota.remaining}{when}"
    for window in quota.windows:
        reset = f"; one more at {earliest_time_text(window.resets_at)}" if window.resets_at else ""
        yield f"  {window.remaining} of {window.limit} per {WINDOW_LENGTHS[window.name]}{reset}"


def receipt_lines(receipt: Receipt) -> Iterator[str]:
    """Yield what a receipt proves."""
    about = f"received a file from {receipt.team} at {time_text(receipt.received_at)}"
    given = "gave it these scores" if receipt.scores else "held its scores back"
    yield printable(f"proven: the server {about} and {given}")
    for metric in headline_of(receipt.signature, receipt.scores):
        yield f"  {metric.heading:8}{metric.display(receipt.scores[metric.key]):>7}"
    yield printable(receipt.signature)
    yield printable(f"submission {receipt.submission_id}, file sha256 {receipt.sha256}")


def snapshot_lines(snapshot: Snapshot) -> Iterator[str]:
    """Yield what a snapshot proves."""
    board = snapshot.leaderboard
    state = f"as of {time_text(snapshot.as_of)}: {snapshot.title}"
    yield printable(f"proven: the server's leaderboard of {snapshot.split} {state}")
    metric = CATALOGUE.get(board.metric)
    for row in board.rows:
        rank, score = cell_of(row.rank), metric_cell(metric, row.scores) if metric else MISSING
        yield printable(f"  {rank:>3}  {score:>6}  {row.method.name}, {row.team or 'anonymous'}")
    yield printable(board.signature)
