"""Scoring submissions again after a split's ground truth or rules were corrected.

Each submission is scored from its upload, on one leaderboard of its split after the other. The new
result replaces the old one, which stays on record with its receipt. The time at which a submission
was received, its use of the quota, and its reviews do not change.

A leaderboard that is added to a split later gets its results in the same way.
"""

from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import NamedTuple, TypeAlias

from sqlalchemy import Label, func, select
from sqlalchemy.orm import Session

from reverie_eval.errors import SubmissionError
from reverie_eval.metrics import Metric
from reverie_eval.schemas.organising import ResultChange
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import BoardResult, CorrectionReport, EarlierResult, Receipt
from reverie_eval.server.audit.signing import read_as
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.boards.leaderboard import Sums, cluster_sums, ranks, store_sums
from reverie_eval.server.boards.news import corrections_of
from reverie_eval.server.intake.submissions import has_review
from reverie_eval.server.scoring.boards import Board, find_board, without_version
from reverie_eval.server.scoring.contexts import Context
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import IS_SHOWN, Correction, Submission, read_stored
from reverie_eval.server.store.uploads import UploadsError, stored_upload


class Outdated(NamedTuple):
    """A submission without a result under current ground truth and rules, to be scored again."""

    submission_id: str
    sha256: str
    has_intervals: bool
    upload_deleted_at: datetime | None
    was_scored: bool
    """Whether it has a result under other ground truth or rules."""


class Rescored(NamedTuple):
    """The result of scoring a submission again."""

    report: ScoreReport
    sums: Sums | None
    """The sums by which it is compared for ranks; None for a result without intervals."""


Outcome: TypeAlias = Rescored | str
"""The result of scoring again, or why a submission cannot be scored again."""


def rescore_one(context: Context, split: str, name: str, old: Outdated) -> Outcome:
    """Score a submission again on a leaderboard, or return why that cannot be done."""
    if old.upload_deleted_at is not None:
        return f"its upload was deleted on {old.upload_deleted_at:%Y-%m-%d} (keep_uploads_days)"
    board = find_board(context.boards, split, name)
    try:
        content = stored_upload(context.uploads, old.sha256)
        report, scores = board.scored(content, has_intervals=old.has_intervals)
    except SubmissionError as error:
        return rejected(error)
    except UploadsError as error:
        return str(error)
    sums = cluster_sums(scores) if scores and report.intervals else None
    return Rescored(report, sums)


def rejected(error: SubmissionError) -> Outcome:
    """Return why a submission cannot be scored again."""
    return f"rejected: {error.problems[0]}"


def replace_results(
    transaction: Transaction, board: Board, reason: str, outcomes: Mapping[Outdated, Outcome]
) -> None:
    """Announce a correction, and replace the results of a leaderboard.

    First results correct nothing, so they are not announced.
    """
    if any(old.was_scored for old in outcomes):
        reason = _announced(transaction, board, reason)
    for old, outcome in outcomes.items():
        if isinstance(outcome, Rescored):
            _replace(transaction, board, reason, old, outcome)


def _replace(
    transaction: Transaction, board: Board, reason: str, old: Outdated, rescored: Rescored
) -> None:
    report = rescored.report
    row = transaction.session.get_one(Submission, old.submission_id)
    results = row.results
    known, quota = results.get(board.name), read_as(Receipt, results[""].receipt).quota
    if known is not None and board.measures_as(known.report):
        return  # another process has done it meanwhile
    earlier = [] if known is None else [*known.earlier, _replaced(known, transaction, reason)]
    receipt = transaction.audit_log.signer.sign_result(row, report, quota)
    result = BoardResult(report=report, receipt=receipt, earlier=earlier)
    row.store_result(board.name, result)
    row.rescored_at = transaction.now
    if rescored.sums is not None:
        store_sums(transaction.session, row.id, {board.name: rescored.sums})
    transaction.record(
        "scored again",
        row,
        row.id,
        board=board.name,
        before="" if known is None else known.report.signature,
        after=report.signature,
    )


def _replaced(known: BoardResult, transaction: Transaction, reason: str) -> EarlierResult:
    return EarlierResult(
        report=known.report, receipt=known.receipt, replaced_at=transaction.now, reason=reason
    )


def outdated(session: Session, board: Board) -> Sequence[Outdated]:
    """Return the submissions without a result under current data and rules, the oldest first.

    The published ones are to be scored with intervals, if the split is open.
    """
    chosen = (
        select(
            Submission.id,
            Submission.sha256,
            *_scored_by(board.name),
            Submission.published_at,
            Submission.upload_deleted_at,
        )
        .where(Submission.split == board.split)
        .order_by(Submission.received_at, Submission.id)
    )
    return [
        Outdated(
            submission_id=name,
            sha256=sha256,
            has_intervals=published is not None and not board.is_private,
            upload_deleted_at=deleted,
            was_scored=signature is not None,
        )
        for name, sha256, signature, fingerprint, published, deleted in session.execute(chosen)
        if not board.is_current(signature or "", fingerprint or "")
    ]


def count_outdated(session: Session, board: Board) -> int:
    """Count the submissions that :func:`outdated` returns."""
    counted = (
        select(*_scored_by(board.name), func.count())
        .where(Submission.split == board.split)
        .group_by("signature", "fingerprint")
    )
    return sum(
        number
        for signature, fingerprint, number in session.execute(counted)
        if not board.is_current(signature or "", fingerprint or "")
    )


def _scored_by(name: str) -> tuple[Label[str | None], Label[str | None]]:
    """Return signature and fingerprint of the reports on a leaderboard; NULL without a result."""

    def column(field: str) -> Label[str | None]:
        stored = Submission.boards[(name, "report", field)] if name else Submission.report[field]
        found: Label[str | None] = stored.as_string().label(field)
        return found

    return column("signature"), column("fingerprint")


def list_corrections(session: Session, page: Page) -> Listed[CorrectionReport]:
    """List the corrections of all splits, the latest first."""
    report = partial(read_stored, CorrectionReport)
    return list_page(session, select(Correction), Correction.id, page, report, newest_first=True)


def changes(
    session: Session,
    board: Board,
    outcomes: Mapping[str, Outcome],
    *,
    first_results: Collection[str] = (),
) -> Sequence[ResultChange]:
    """Compare a leaderboard's results before and after a correction, the largest changes first.

    ``outcomes`` has the submissions whose results were not replaced. ``first_results`` are
    submissions that had no result before.
    """
    correction = _current_correction(session, board)
    chosen = select(Submission).where(Submission.split == board.split)
    rows = session.scalars(chosen.order_by(Submission.received_at, Submission.id)).all()
    known = {row.id: row.results.get(board.name) for row in rows}
    before = [
        {} if name in first_results else _before(result, correction)
        for name, result in known.items()
    ]
    after = [_after(result, board, outcomes.get(name)) for name, result in known.items()]
    ranked_by, may_rank = board.primary, IS_SHOWN & ~has_review("disqualified")
    chosen_ids = select(Submission.id).where(Submission.split == board.split, may_rank)
    ranked = set(session.scalars(chosen_ids))
    is_ranked = [row.id in ranked for row in rows]
    ranks_before = _ranks_among(is_ranked, before, ranked_by)
    ranks_after = _ranks_among(is_ranked, after, ranked_by)
    problems = {name: told for name, told in outcomes.items() if isinstance(told, str)}
    found = [
        ResultChange(
            board=board.name,
            submission_id=row.id,
            team=row.team.name,
            method=row.method["name"],
            before=before[index],
            after=after[index],
            rank_before=ranks_before[index],
            rank_after=ranks_after[index],
            problem=problems.get(row.id, ""),
        )
        for index, row in enumerate(rows)
    ]
    return sorted(found, key=lambda change: -abs(change.difference(ranked_by.key)))


def _current_correction(session: Session, board: Board) -> CorrectionReport | None:
    """Return a leaderboard's latest correction, if it led to the current ground truth and rules."""
    latest = next(iter(corrections_of(session, board)), None)
    if latest is None or without_version(latest.signature) != without_version(board.signature):
        return None
    return latest


def _announced(transaction: Transaction, board: Board, reason: str) -> str:
    """Announce a correction to the current ground truth and rules, and return its reason.

    If one was already announced, it continues with the reason given then.
    """
    known = _current_correction(transaction.session, board)
    if known is not None:
        return known.reason
    row = Correction(
        split=board.split,
        board=board.name,
        signature=board.signature,
        reason=reason,
        created_at=transaction.now,
    )
    transaction.record("correction announced", row, board.label, reason=reason)
    return reason


def _before(known: BoardResult | None, correction: CorrectionReport | None) -> Mapping[str, float]:
    """Return the scores before a correction; empty if there were none."""
    if known is None:
        return {}
    last = known.earlier[-1] if known.earlier else None
    if last is not None and correction is not None and last.replaced_at >= correction.created_at:
        return last.report.scores
    return known.report.scores


def _after(known: BoardResult | None, board: Board, outcome: Outcome | None) -> Mapping[str, float]:
    """Return the scores under the current ground truth and rules; empty if there are none."""
    if isinstance(outcome, Rescored):
        return outcome.report.scores
    return known.report.scores if known and board.measures_as(known.report) else {}


def _ranks_among(
    is_ranked: Sequence[bool], scores: Sequence[Mapping[str, float]], metric: Metric
) -> Sequence[int | None]:
    values = [
        each.get(metric.key) if ranked else None
        for ranked, each in zip(is_ranked, scores, strict=True)
    ]
    return ranks(values, metric)
