"""What everybody may see of a submission: what its team has published, and no more."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy.orm import Session

from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import Method
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.service.reviews import standing_reviews
from reverie_eval.server.store.tables import Review, Submission


@dataclass(frozen=True, slots=True)
class Publication:
    """A published submission, for whoever reads the board."""

    id: str
    split: str
    team: str
    """Empty while the team chose to be anonymous."""
    method: Method
    report: ScoreReport
    published_at: datetime
    reviews: Sequence[Review]


def publication(session: Session, submission_id: str, now: datetime) -> Publication:
    """Return a published submission; while its team is anonymous, nothing in it tells which it is.

    Raises
    ------
    NotFoundError
        If there is none, it is not published, or it was withdrawn: nobody learns which.
    """
    row = session.get(Submission, submission_id) if submission_id.isalnum() else None
    if row is None or row.published_at is None or row.withdrawn_at is not None:
        raise NotFoundError("nothing is published here; sign in if it is a submission of your team")
    is_anonymous = row.anonymous_until is not None and row.anonymous_until > now
    return Publication(
        id=row.id,
        split=row.split,
        team="" if is_anonymous else row.team.name,
        method=Method.model_validate(row.method),
        report=ScoreReport.model_validate(row.report),
        published_at=row.published_at,
        reviews=standing_reviews(session, row.id),
    )
