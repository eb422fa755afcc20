"""What a server said, as participants read it: results, quotas, receipts."""

from collections.abc import Iterator

from reverie_eval.ground_truth import DEMO_DATASET
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting._tables import Table, table_of_report
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import QuotaReport, QuotaWindow, Receipt, SubmissionReport
from reverie_eval.text import earliest_time_text, printable, time_text

_HOURS = {"day": "24 hours", "month": "30 days", "year": "365 days"}


def table_of_submission(report: ScoreReport, server: str) -> Table:
    """Word the scores that a server gave."""
    where = "the synthetic demo world, not REVERIE" if report.dataset == DEMO_DATASET else None
    table = table_of_report(report, where or f"that of {server} ({printable(report.dataset)})")
    captions = [printable(caption) for caption in table.captions]
    return Table(table.headings, table.rows, captions, table.has_names)


def submission_lines(submission: SubmissionReport, *, is_repeat: bool) -> Iterator[str]:
    """Say what became of a submission."""
    about = f"submission {submission.id} of {submission.team}: {submission.method.name}"
    yield printable(f"{about}, received {time_text(submission.received_at)}")
    if is_repeat:
        yield "this file had been scored already; nothing was spent"
    if submission.status == "unpublished":
        yield "not published: send it again with --publish; that spends nothing"
    else:
        yield submission.status


def quota_lines(quota: QuotaReport, split: str) -> Iterator[str]:
    """Say what is left, and when there will be more."""
    when = f"; the next is possible at {earliest_time_text(quota.next_at)}" if quota.next_at else ""
    yield f"left on {split}: {quota.remaining} now{when}"
    yield from (f"  {_window(window)}" for window in quota.windows)


def _window(window: QuotaWindow) -> str:
    reset = f"; one more at {earliest_time_text(window.resets_at)}" if window.resets_at else ""
    return f"{window.remaining} of {window.limit} in {_HOURS[window.name]}{reset}"


def receipt_lines(receipt: Receipt) -> Iterator[str]:
    """Say what a receipt proves."""
    about = f"received a file from {receipt.team} at {time_text(receipt.received_at)}"
    yield printable(f"proven: the server {about}, and gave it these scores")
    for key, value in receipt.scores.items():
        metric = CATALOGUE.get(key)
        if metric is not None and metric.headline:
            yield f"  {metric.heading:8}{metric.display(value):>7}"
    yield printable(receipt.signature)
    yield printable(f"submission {receipt.submission_id}, file sha256 {receipt.sha256}")
