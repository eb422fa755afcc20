"""Scoring submissions again after a split's ground truth or rules were corrected.

Each submission is scored from its upload. The new result replaces the old one in a transaction of
its own; the old one stays on record with its receipt. So an interrupted run is continued by the
next one, which finds only what is left. When a submission was received, what it used of the quota,
and how it was reviewed do not change.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple, TypeAlias

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from reverie_eval.errors import ProtocolError, SubmissionError
from reverie_eval.metrics import Metric
from reverie_eval.schemas.organising import NewCorrection, RescoringReport, ResultChange
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import CorrectionReport, EarlierResult, Receipt
from reverie_eval.server.errors import ConflictError
from reverie_eval.server.service.boards import Board, board_named, without_version
from reverie_eval.server.service.leaderboard import ranks
from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.service.rank_intervals import cluster_sums
from reverie_eval.server.service.receipts import Signer
from reverie_eval.server.service.reviews import reviews_of
from reverie_eval.server.service.transactions import Actor, Transaction, Transactions
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import ClusterSums, Correction, Review, Submission
from reverie_eval.server.store.uploads import Uploads, UploadsError, stored_upload

AT_ONCE = 20
"""Submissions that are scored in a request; the next request continues."""


class Job(NamedTuple):
    """A submission to be scored again."""

    submission_id: str
    sha256: str
    has_intervals: bool
    upload_deleted_at: datetime | None


class Rescored(NamedTuple):
    """What scoring a submission again gives."""

    report: ScoreReport
    sums: dict[str, list[float]] | None
    """What its rank is compared by; None for what has no intervals either."""


Outcome: TypeAlias = Rescored | str
"""What scoring again gives, or why a submission cannot be scored again."""


@dataclass(frozen=True, slots=True)
class Scorer:
    """Scores the uploads of a split again."""

    board: Board
    uploads: Uploads

    def __call__(self, job: Job) -> Outcome:
        """Score a submission again, or return why that cannot be done."""
        if job.upload_deleted_at is not None:
            return f"its upload was deleted on {job.upload_deleted_at:%Y-%m-%d} (keep_uploads_days)"
        try:
            return self._score(job)
        except SubmissionError as error:
            return f"rejected: {error.problems[0]}"
        except UploadsError as error:
            return str(error)

    def _score(self, job: Job) -> Rescored:
        reading = self.board.read(stored_upload(self.uploads, job.sha256))
        scores = self.board.score(reading)
        sums = None
        if job.has_intervals:
            with suppress(ProtocolError):  # no intervals from a single target
                scores, sums = scores.with_intervals(), cluster_sums(scores)
        return Rescored(self.board.report(scores, reading), sums)


@dataclass(frozen=True, slots=True)
class Rescoring:
    """Scores the submissions of splits again."""

    boards: Mapping[str, Board]
    database: Database
    uploads: Uploads
    signer: Signer
    transactions: Transactions

    def rescore(self, actor: Actor, new: NewCorrection) -> RescoringReport:
        """Score the next submissions that were scored with other ground truth or rules.

        Raises
        ------
        NotFoundError
            If the server has no such split.
        ConflictError
            If all were scored with the current ones.
        """
        board = board_named(self.boards, new.split)
        with self.database.reading() as session:
            jobs = outdated(session, board)
        if not jobs:
            raise ConflictError(
                f"all submissions to {board.name} were scored with the current ground truth and "
                "rules"
            )
        outcomes = map(Scorer(board, self.uploads), jobs)
        scored, rejected = 0, {}
        for job, outcome in self.replace_results(actor, board, new.reason, jobs, outcomes):
            if isinstance(outcome, str):
                rejected[job.submission_id] = outcome
            else:
                scored += 1
            if scored == AT_ONCE:
                break
        left = len(jobs) - scored - len(rejected)
        return RescoringReport(
            split=new.split, signature=board.signature, scored=scored, rejected=rejected, left=left
        )

    def replace_results(
        self,
        actor: Actor,
        board: Board,
        reason: str,
        jobs: Sequence[Job],
        outcomes: Iterable[Outcome],
    ) -> Iterator[tuple[Job, Outcome]]:
        """Announce the correction and replace results one by one; without jobs, do nothing.

        ``outcomes`` are those of the jobs, in their order.
        """
        if not jobs:
            return
        with self.transactions.begin(actor) as transaction:
            reason = _correction(transaction, board, reason).reason
        for job, outcome in zip(jobs, outcomes, strict=True):
            if isinstance(outcome, Rescored):
                with self.transactions.begin(actor) as transaction:
                    self._replace(transaction, board, reason, job, outcome)
            yield job, outcome

    def _replace(
        self, transaction: Transaction, board: Board, reason: str, job: Job, rescored: Rescored
    ) -> None:
        report = rescored.report
        row = transaction.session.get_one(Submission, job.submission_id)
        known, receipt = ScoreReport.model_validate(row.report), Receipt.model_validate(row.receipt)
        if board.measures_as(known):
            return  # another process has done it meanwhile
        earlier = EarlierResult(
            report=known, receipt=receipt, replaced_at=transaction.now, reason=reason
        )
        row.earlier = [*row.earlier, earlier.model_dump(mode="json")]
        row.rescored_at = transaction.now
        row.report = report.model_dump(mode="json")
        if rescored.sums is not None:
            transaction.session.merge(ClusterSums(submission_id=row.id, sums=rescored.sums))
        row.receipt = self.signer.sign(
            submission_id=row.id,
            team=row.team.name,
            sha256=row.sha256,
            received_at=row.received_at,
            split=row.split,
            signature=report.signature,
            scores=report.scores,
            quota=receipt.quota,
        ).model_dump(mode="json")
        transaction.record(
            "scored again", row, row.id, before=known.signature, after=report.signature
        )


def outdated(session: Session, board: Board) -> Sequence[Job]:
    """Return the submissions that were scored with other ground truth or rules, the oldest first.

    Those that are published come with intervals, if the split is open.
    """
    chosen = (
        select(
            Submission.id,
            Submission.sha256,
            Submission.report["signature"].as_string(),
            Submission.report["fingerprint"].as_string(),
            Submission.published_at,
            Submission.upload_deleted_at,
        )
        .where(Submission.split == board.name)
        .order_by(Submission.received_at, Submission.id)
    )
    return [
        Job(name, sha256, published is not None and not board.is_private, deleted)
        for name, sha256, signature, fingerprint, published, deleted in session.execute(chosen)
        if not board.is_current(signature, fingerprint)
    ]


def count_outdated(session: Session, boards: Mapping[str, Board]) -> Mapping[str, int]:
    """Count the submissions that :func:`outdated` returns, for each split that has any."""
    scored_by = (
        select(
            Submission.split,
            Submission.report["signature"].as_string().label("signature"),
            Submission.report["fingerprint"].as_string().label("fingerprint"),
        )
        .where(Submission.split.in_(boards))
        .subquery()
        .columns
    )
    counts: Counter[str] = Counter()
    counted = select(*scored_by, func.count().label("number")).group_by(*scored_by)
    for row in session.execute(counted):
        if not boards[row.split].is_current(row.signature, row.fingerprint):
            counts[row.split] += row.number
    return counts


def list_corrections(session: Session, page: Page) -> Listed[CorrectionReport]:
    """List the corrections of all splits, the latest first."""
    report = CorrectionReport.model_validate
    return list_page(session, select(Correction), Correction.id, page, report, newest_first=True)


def changes(
    session: Session, board: Board, outcomes: Mapping[str, Outcome]
) -> Sequence[ResultChange]:
    """Compare a split's results before and after its correction, the largest changes first.

    ``outcomes`` are those of submissions whose results were not replaced, by submission.
    """
    correction = _current_correction(session, board)
    chosen = select(Submission).where(Submission.split == board.name)
    rows = session.scalars(chosen.order_by(Submission.received_at, Submission.id)).all()
    before = [_before(row, correction).scores for row in rows]
    after = [_after(row, board, outcomes.get(row.id)) for row in rows]
    reviews, ranked_by = reviews_of(session, board.name), board.primary
    is_ranked = [_is_ranked(row, reviews) for row in rows]
    ranks_before = _ranks_among(is_ranked, before, ranked_by)
    ranks_after = _ranks_among(is_ranked, after, ranked_by)
    found = [
        ResultChange(
            submission_id=row.id,
            team=row.team.name,
            method=row.method["name"],
            before=before[index],
            after=after[index],
            rank_before=ranks_before[index],
            rank_after=ranks_after[index],
            problem=_problem(outcomes.get(row.id)),
        )
        for index, row in enumerate(rows)
    ]
    return sorted(found, key=lambda change: -abs(change.difference(ranked_by.key)))


def _current_correction(session: Session, board: Board) -> Correction | None:
    """Return the latest correction of a split, if it led to the current ground truth and rules."""
    chosen = select(Correction).where(Correction.split == board.name).order_by(Correction.id.desc())
    latest = session.scalars(chosen.limit(1)).first()
    if latest is None or without_version(latest.signature) != without_version(board.signature):
        return None
    return latest


def _correction(transaction: Transaction, board: Board, reason: str) -> Correction:
    """Return the correction that led to the current ground truth and rules, announced if new."""
    known = _current_correction(transaction.session, board)
    if known is not None:
        return known
    row = Correction(
        split=board.name, signature=board.signature, reason=reason, created_at=transaction.now
    )
    transaction.add(row)
    transaction.record("correction announced", row, board.name, reason=reason)
    return row


def _before(row: Submission, correction: Correction | None) -> ScoreReport:
    is_replaced = (
        correction is not None
        and row.rescored_at is not None
        and row.rescored_at >= correction.created_at
    )
    return ScoreReport.model_validate(row.earlier[-1]["report"] if is_replaced else row.report)


def _after(row: Submission, board: Board, outcome: Outcome | None) -> Mapping[str, float]:
    """Return the scores by the current ground truth and rules; empty if there are none."""
    known = ScoreReport.model_validate(row.report)
    if isinstance(outcome, Rescored):
        return outcome.report.scores
    return known.scores if board.measures_as(known) else {}


def _ranks_among(
    is_ranked: Sequence[bool], scores: Sequence[Mapping[str, float]], metric: Metric
) -> Sequence[int | None]:
    values = [
        each.get(metric.key) if ranked else None
        for ranked, each in zip(is_ranked, scores, strict=True)
    ]
    return ranks(values, metric)


def _problem(outcome: Outcome | None) -> str:
    return outcome if isinstance(outcome, str) else ""


def _is_ranked(row: Submission, reviews: Mapping[str, Sequence[Review]]) -> bool:
    """Whether a leaderboard ranks a submission that is scored by its rules."""
    is_disqualified = any(review.verdict == "disqualified" for review in reviews.get(row.id, ()))
    return row.published_at is not None and row.withdrawn_at is None and not is_disqualified
