"""From rows to what is said over the wire."""

from datetime import datetime
from math import ceil

from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import Method, QuotaReport, QuotaWindow, Receipt, SubmissionReport
from reverie_eval.server.service.quotas import QuotaState
from reverie_eval.server.store.tables import Submission


def submission_report(row: Submission) -> SubmissionReport:
    """Word a submission for its team."""
    return SubmissionReport(
        id=row.id,
        split=row.split,
        team=row.team.name,
        person=row.person.name,
        sha256=row.sha256,
        received_at=row.received_at,
        method=Method.model_validate(row.method),
        report=ScoreReport.model_validate(row.report),
        receipt=Receipt.model_validate(row.receipt),
        status="withdrawn"
        if row.withdrawn_at
        else "published"
        if row.published_at
        else "unpublished",
        published_at=row.published_at,
        withdrawn_at=row.withdrawn_at,
        anonymous_until=row.anonymous_until,
    )


def quota_report(state: QuotaState, now: datetime) -> QuotaReport:
    """Word what is left."""
    waiting = state.next_at - now if state.next_at else None
    return QuotaReport(
        remaining=state.remaining,
        next_at=state.next_at,
        seconds_to_next=0 if waiting is None else ceil(waiting.total_seconds()),
        windows=[QuotaWindow.model_validate(window) for window in state.windows],
    )
