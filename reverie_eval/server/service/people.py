"""Teams and people: adding, renaming and listing them, and the page of one's own team."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session, selectinload

from reverie_eval.schemas.organising import NewPerson, NewTeam, PersonReport, TeamReport
from reverie_eval.schemas.service import Role, SubmissionReport
from reverie_eval.server.errors import ConflictError, NotFoundError
from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.service.submissions import View
from reverie_eval.server.service.transactions import Transaction
from reverie_eval.server.store.tables import Person, Submission, Team, Token


def add_team(transaction: Transaction, new: NewTeam) -> TeamReport:
    """Add a team.

    Raises
    ------
    ConflictError
        If a team has that name.
    """
    team = Team(name=new.name, created_at=transaction.now)
    _write(transaction, team)
    transaction.record("team added", team, team.name)
    return team_report(team)


def rename_team(transaction: Transaction, name: str, new: NewTeam) -> TeamReport:
    """Rename a team; receipts keep the name under which they were signed.

    Raises
    ------
    NotFoundError
        If there is no such team.
    ConflictError
        If a team has the new name.
    """
    team = team_named(transaction.session, name)
    team.name = new.name
    _write(transaction, team)
    transaction.record("team renamed", team, name, before=name, after=team.name)
    return team_report(team)


def add_person(transaction: Transaction, new: NewPerson) -> PersonReport:
    """Add a person to a team.

    Raises
    ------
    ConflictError
        If a person has that name.
    NotFoundError
        If there is no such team.
    """
    team = team_named(transaction.session, new.team)
    person = Person(team_id=team.id, name=new.name, role=new.role, created_at=transaction.now)
    _write(transaction, person)
    name = transaction.audit_log.name_digest(person)
    transaction.record(
        "person added", person, person, team=team.name, role=person.role, name_digest=name
    )
    return person_report(person)


def list_teams(session: Session, page: Page) -> Listed[TeamReport]:
    """List the teams by name."""
    teams = select(Team).options(selectinload(Team.people))
    return list_page(session, teams, Team.name, page, team_report)


def list_people(session: Session, page: Page) -> Listed[PersonReport]:
    """List all people by name."""
    return list_page(session, select(Person), Person.name, page, person_report)


def names_of_teams(session: Session) -> Sequence[str]:
    """Return the names of all teams."""
    return session.scalars(select(Team.name).order_by(Team.name)).all()


def names_and_roles(session: Session) -> Mapping[str, Role]:
    """Return the role of each person, by name."""
    rows = session.execute(select(Person.name, Person.role).order_by(Person.name))
    return {name: role for name, role in rows}  # noqa: C416  # mypy does not accept rows as pairs


@dataclass(frozen=True, slots=True)
class TeamView:
    """What people see of their own team."""

    people: Sequence[Person]
    submissions: Sequence[SubmissionReport]
    """The latest, the newest first."""
    submitted: int
    """The number of all submissions."""
    tokens: Sequence[Token]
    """Those of the person who asks; the newest first."""


def team_of(session: Session, person: Person, most: int, view: View) -> TeamView:
    """Return a person's team, with its latest submissions."""
    of_team = Submission.team_id == person.team_id
    latest = select(Submission).where(of_team).order_by(Submission.received_at.desc()).limit(most)
    members = select(Person).where(Person.team_id == person.team_id).order_by(Person.name)
    tokens = select(Token).where(Token.person_id == person.id).order_by(Token.id.desc())
    counted = select(func.count()).select_from(Submission).where(of_team)
    return TeamView(
        people=session.scalars(members).all(),
        submissions=[view.report(row) for row in session.scalars(latest)],
        submitted=session.scalar(counted) or 0,
        tokens=session.scalars(tokens).all(),
    )


def team_named(session: Session, name: str) -> Team:
    """Return a team by name; raise NotFoundError if it does not exist."""
    team = session.scalars(select(Team).where(Team.name == name)).first()
    if team is None:
        raise NotFoundError(f"there is no team {name!r}")
    return team


def person_named(session: Session, name: str) -> Person:
    """Return a person by name; raise NotFoundError if it does not exist."""
    person = session.scalars(select(Person).where(Person.name == name)).first()
    if person is None:
        raise NotFoundError(f"there is no person {name!r}")
    return person


def team_report(team: Team) -> TeamReport:
    """Return a team as organisers see it."""
    people = sorted(person.name for person in team.people)
    return TeamReport(name=team.name, people=people, created_at=team.created_at)


def person_report(person: Person) -> PersonReport:
    """Return a person as organisers see them."""
    return PersonReport(
        name=person.name, team=person.team.name, role=person.role, created_at=person.created_at
    )


def _write(transaction: Transaction, row: Team | Person) -> None:
    """Insert or change a row; ConflictError if its name is taken."""
    name, kind = row.name, row.__tablename__
    try:
        with transaction.session.begin_nested():
            transaction.add(row)
    except IntegrityError:
        raise ConflictError(f"there is a {kind} {name!r} already") from None
