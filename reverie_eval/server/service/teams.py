"""A team, as its people see it: who is in it, and what it has submitted."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.service import SubmissionReport
from reverie_eval.server.service.reports import submission_report
from reverie_eval.server.store.tables import Person, Submission, Token


@dataclass(frozen=True, slots=True)
class TeamView:
    """What one sees of one's own team."""

    people: Sequence[Person]
    submissions: Sequence[SubmissionReport]
    """The latest, the newest first."""
    submitted: int
    """How many there are in all."""
    tokens: Sequence[Token]
    """One's own, not those of others; the newest first."""


def team_of(session: Session, person: Person, most: int) -> TeamView:
    """Return somebody's team, with at most so many of its submissions."""
    of_team = Submission.team_id == person.team_id
    latest = select(Submission).where(of_team).order_by(Submission.received_at.desc()).limit(most)
    members = select(Person).where(Person.team_id == person.team_id).order_by(Person.name)
    tokens = select(Token).where(Token.person_id == person.id).order_by(Token.id.desc())
    counted = select(func.count()).select_from(Submission).where(of_team)
    return TeamView(
        people=session.scalars(members).all(),
        submissions=[submission_report(row) for row in session.scalars(latest)],
        submitted=session.scalar(counted) or 0,
        tokens=session.scalars(tokens).all(),
    )
