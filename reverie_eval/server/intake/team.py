"""A team as its people see it."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.schemas.service import SubmissionReport
from reverie_eval.server.boards.embargo import View
from reverie_eval.server.store.database import count_rows
from reverie_eval.server.store.tables import Person, Submission, Token


@dataclass(frozen=True, slots=True)
class TeamView:
    """What people see of their own team."""

    people: Sequence[Person]
    submissions: Sequence[SubmissionReport]
    """The latest, the newest first."""
    submitted: int
    """The number of all submissions."""
    tokens: Sequence[Token]
    """The tokens of the person who asks, the newest first."""


def team_of(session: Session, person: Person, most: int, view: View) -> TeamView:
    """Return a person's team, with its latest submissions."""
    of_team = Submission.team_id == person.team_id
    latest = select(Submission).where(of_team).order_by(Submission.received_at.desc()).limit(most)
    members = select(Person).where(Person.team_id == person.team_id, Person.deleted_at.is_(None))
    tokens = select(Token).where(Token.person_id == person.id).order_by(Token.id.desc())
    return TeamView(
        people=session.scalars(members.order_by(Person.name)).all(),
        submissions=[view.report(row) for row in session.scalars(latest)],
        submitted=count_rows(session, Submission, of_team),
        tokens=session.scalars(tokens).all(),
    )
