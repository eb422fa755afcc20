"""Reviews: the organiser's public verdicts on submissions.

Verified, flagged and disqualified replace each other; baseline is independent of them. Reviews are
never deleted: a lifted or replaced review stays in the database with the time at which it ended.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial

from sqlalchemy import select
from sqlalchemy.orm import Session, joinedload

from reverie_eval.schemas.organising import NewReview, ReviewEntry
from reverie_eval.schemas.service import Verdict
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ConflictError, NotFoundError
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import Review, Submission, read_stored

VERDICTS: Mapping[Verdict, str] = {
    "verified": "The organiser has checked the result, and the reason says how.",
    "baseline": "A reference for comparison, not a competitor.",
    "flagged": "Something about the result is doubtful; it stays ranked.",
    "disqualified": "The result broke the rules. It is not ranked, but stays visible with the "
    "reason; its team cannot unpublish it.",
}
"""What each verdict means, as the guide and the desk say it."""
JUDGEMENTS: frozenset[Verdict] = frozenset({"verified", "flagged", "disqualified"})
"""Verdicts that replace each other."""


@dataclass(frozen=True, slots=True)
class PublishedReview:
    """A review as a leaderboard shows it."""

    verdict: Verdict
    reason: str
    created_at: datetime


def review(transaction: Transaction, new: NewReview) -> ReviewEntry:
    """Review a submission, which lifts earlier reviews that this one replaces.

    Raises NotFoundError if there is no such submission.
    """
    submission = any_submission(transaction.session, new.submission_id)
    for earlier in standing_reviews(transaction.session, submission.id):
        if new.verdict == earlier.verdict or {new.verdict, earlier.verdict} <= JUDGEMENTS:
            _lift(transaction, earlier)
    row = Review(**new.model_dump(), created_at=transaction.now)
    about = {"submission_id": row.submission_id, "reason": row.reason}
    transaction.record(row.verdict, row, submission.id, **about)
    return read_stored(ReviewEntry, row)


def lift_review(transaction: Transaction, review_id: int) -> ReviewEntry:
    """Lift a review.

    Raises NotFoundError if the review does not exist, ConflictError if it was already lifted.
    """
    row = transaction.session.get(Review, review_id)
    if row is None:
        raise NotFoundError(f"there is no review {review_id}; see the list of reviews")
    if row.lifted_at is not None:
        raise ConflictError(f"review {review_id} was already lifted")
    _lift(transaction, row)
    return read_stored(ReviewEntry, row)


def list_reviews(session: Session, page: Page) -> Listed[ReviewEntry]:
    """List all reviews, lifted or not, the latest first."""
    report = partial(read_stored, ReviewEntry)
    return list_page(session, select(Review), Review.id, page, report, newest_first=True)


def standing_reviews(session: Session, submission_id: str) -> Sequence[Review]:
    """Return the current reviews of a submission, the earliest first."""
    chosen = select(Review).where(Review.submission_id == submission_id)
    return session.scalars(chosen.where(Review.lifted_at.is_(None)).order_by(Review.id)).all()


def is_disqualified(reviews: Iterable[Review | PublishedReview]) -> bool:
    """Whether a submission with these current reviews is disqualified."""
    return any(review.verdict == "disqualified" for review in reviews)


def review_rows(session: Session, page: Page, *, standing: bool) -> Listed[Review]:
    """List the current or the lifted reviews, the latest first."""
    rows = select(Review).options(joinedload(Review.submission))
    rows = rows.where(Review.lifted_at.is_(None) if standing else Review.lifted_at.is_not(None))
    return list_page(session, rows, Review.id, page, lambda row: row, newest_first=True)


def latest_submissions(session: Session, limit: int) -> Sequence[Submission]:
    """Return the latest submissions of all teams, the latest first."""
    chosen = select(Submission).order_by(Submission.received_at.desc(), Submission.id)
    return session.scalars(chosen.limit(limit)).all()


def find_submission(session: Session, submission_id: str) -> Submission | None:
    """Return a submission of any team, or None."""
    # PostgreSQL cannot search for text with a zero byte.
    return session.get(Submission, submission_id) if submission_id.isalnum() else None


def any_submission(session: Session, submission_id: str) -> Submission:
    """Return a submission of any team; raise NotFoundError if it does not exist."""
    row = find_submission(session, submission_id)
    if row is None:
        raise NotFoundError(
            f"there is no submission {submission_id!r}; see the list of submissions"
        )
    return row


def _lift(transaction: Transaction, row: Review) -> None:
    row.lifted_at = transaction.now
    transaction.record("review lifted", row, row.submission_id, verdict=row.verdict)
