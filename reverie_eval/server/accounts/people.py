"""Teams and people: adding, changing, merging and listing them.

A team that was merged stays as a row, because receipts and the audit log have its name. The audit
log has an entry for each row that the merge changed.
"""

from collections.abc import Sequence
from typing import TypeAlias

from sqlalchemy import exists, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session, aliased, selectinload

from reverie_eval.schemas import organising as schemas
from reverie_eval.server.audit.log import entries
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import ConflictError, NotFoundError
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import (
    IS_CHANGE,
    AuditEntry,
    Grant,
    Person,
    Submission,
    Team,
    name_key,
    read_stored,
)

_RENAMED = "team renamed"
_OfTeam: TypeAlias = Person | Submission | Grant
"""What belongs to a team."""


def add_team(transaction: Transaction, new: schemas.NewTeam) -> schemas.TeamReport:
    """Add a team.

    Raises ConflictError if a team has that name or one that looks the same, or another had results
    under it before it was renamed.
    """
    _check_name(transaction.session, new.name)
    team = Team(name=new.name, created_at=transaction.now)
    _write(transaction, team, _name_is_taken(team.name))
    transaction.record("team added", team, team.name)
    return team_report(team)


def rename_team(transaction: Transaction, name: str, new: schemas.NewTeam) -> schemas.TeamReport:
    """Rename a team; receipts keep the name under which they were signed.

    Raises
    ------
    NotFoundError
        If there is no such team.
    ConflictError
        If another team has the new name or one that looks the same, or had results under it before
        it was renamed.
    """
    team = team_named(transaction.session, name)
    _check_name(transaction.session, new.name, team)
    team.name, team.name_key = new.name, name_key(new.name)
    _write(transaction, team, _name_is_taken(team.name))
    transaction.record(_RENAMED, team, name, before=name, after=team.name)
    return team_report(team)


def merge_teams(transaction: Transaction, new: schemas.NewMerge) -> schemas.MergeReport:
    """Give one team's people, submissions and grants to another.

    Quotas count the submissions of both from then on; of a file that both have submitted, only the
    earlier submission. Published submissions stay published. Receipts keep the name under which
    they were signed.

    Raises
    ------
    NotFoundError
        If there is no such team.
    ConflictError
        If the teams are the same, or have people with the same name.
    """
    session = transaction.session
    team, into = team_named(session, new.team), team_named(session, new.into)
    if team is into:
        raise ConflictError("a team cannot be merged into itself; name two teams")
    _check_names(team, into)
    moved = _rows_of(session, team)
    marked = _mark_repeats(session, team, into)
    report = schemas.MergeReport(
        team=team.name,
        into=into.name,
        people=sum(person.deleted_at is None for person in team.people),
        submissions=sum(isinstance(row, Submission) for row in moved),
        repeats=len(marked),
    )
    for row in moved:
        row.team_id = into.id
    team.merged_into, team.merged_at = into, transaction.now
    session.flush()
    session.expire_all()
    for row in dict.fromkeys([*moved, *marked]):
        details = {"merged": report.team, "into": report.into}
        transaction.record("changed by a merge", row, _subject_of(row, into), **details)
    transaction.record("team merged", team, report.team, **report.model_dump(exclude={"team"}))
    return report


def add_person(transaction: Transaction, new: schemas.NewPerson) -> schemas.PersonReport:
    """Add a person to a team.

    Raises
    ------
    ConflictError
        If the team has a person of that name.
    NotFoundError
        If there is no such team.
    """
    team = team_named(transaction.session, new.team)
    person = Person(
        team_id=team.id, name=new.name, email=new.email, role=new.role, created_at=transaction.now
    )
    _write(transaction, person, f"the team {team.name!r} already has a person {person.name!r}")
    transaction.record("person added", person, person, team=team.name, role=person.role)
    return person_report(person)


def change_person(
    transaction: Transaction, person_id: int, change: schemas.PersonChange
) -> schemas.PersonReport:
    """Rename a person, change their address, or move them to another team.

    Their submissions stay with the team that they were in when they submitted.

    Raises
    ------
    NotFoundError
        If there is no such person or team.
    ConflictError
        If somebody else in the team has that name.
    """
    person = find_person(transaction.session, person_id)
    wanted = change.model_dump(exclude_unset=True)
    moved_from, current = person.team.name, person_report(person).model_dump()
    changed = [field for field, value in wanted.items() if value != current[field]]
    if not changed:
        return person_report(person)
    if "team" in changed:
        person.team = team_named(transaction.session, change.team)
    if "name" in changed:
        person.name = change.name
    if "email" in changed:
        person.email = change.email
    taken = f"the team {person.team.name!r} already has a person {person.name!r}"
    _write(transaction, person, taken)
    moved = {"moved_from": moved_from, "moved_to": change.team} if "team" in changed else {}
    transaction.record("person changed", person, person, changed=changed, **moved)
    return person_report(person)


def list_teams(session: Session, page: Page) -> Listed[schemas.TeamReport]:
    """List the teams by name."""
    teams = select(Team).where(Team.merged_at.is_(None)).options(selectinload(Team.people))
    return list_page(session, teams, Team.name, page, team_report)


def list_people(session: Session, page: Page) -> Listed[schemas.PersonReport]:
    """List all people in the order in which they were added."""
    people = select(Person).where(Person.deleted_at.is_(None))
    return list_page(session, people, Person.id, page, person_report)


def names_of_teams(session: Session) -> Sequence[str]:
    """Return the names of all teams."""
    current = select(Team.name).where(Team.merged_at.is_(None))
    return session.scalars(current.order_by(Team.name)).all()


def names_by_key(session: Session) -> dict[str, str]:
    """Return the names of all teams by :func:`name_key`, also of those that were merged."""
    return {row.name_key: row.name for row in session.execute(select(Team.name_key, Team.name))}


def everybody(session: Session) -> Sequence[schemas.PersonReport]:
    """Return all people by name, and by team if several have it."""
    # Columns only: thousands of rows of the ORM, each with its team, take twice as long.
    columns = (Person.id, Person.name, Person.email, Team.name.label("team"), Person.role)
    people = select(*columns, Person.created_at).join(Team)
    current = people.where(Person.deleted_at.is_(None)).order_by(Person.name, Team.name)
    return [read_stored(schemas.PersonReport, row) for row in session.execute(current)]


def team_named(session: Session, name: str) -> Team:
    """Return a team by name; raise NotFoundError if it does not exist, or was merged."""
    team = session.scalars(select(Team).where(Team.name == name)).first()
    if team is None:
        raise NotFoundError(f"there is no team {name!r}; see the list of teams")
    if team.merged_into is not None:
        raise NotFoundError(f"the team {name!r} was merged into {team.merged_into.name!r}")
    return team


def person_named(session: Session, name: str, team: str | None = None) -> Person:
    """Return a person by name; if no team is given, the name must be unique among all teams.

    Raises
    ------
    NotFoundError
        If there is no such person.
    ConflictError
        If several teams have one; it names them.
    """
    chosen = select(Person).where(Person.name == name, Person.deleted_at.is_(None))
    if team is not None:
        chosen = chosen.join(Team, Person.team_id == Team.id).where(Team.name == team)
    found = session.scalars(chosen.order_by(Person.id)).all()
    if not found and team is not None:
        raise NotFoundError(f"the team {team!r} has no person {name!r}; see the list of people")
    if not found:
        raise NotFoundError(f"there is no person {name!r}; see the list of people")
    if len(found) > 1:
        teams = ", ".join(repr(person.team.name) for person in found)
        raise ConflictError(
            f"several teams have a person {name!r}: {teams}; name the team: --team on the command "
            "line, `team` in a request"
        )
    return found[0]


def organisers(session: Session) -> Sequence[Person]:
    """Return all organisers in the order in which they were added."""
    chosen = select(Person).where(Person.is_organiser, Person.deleted_at.is_(None))
    return session.scalars(chosen.order_by(Person.id)).all()


def find_person(session: Session, person_id: int) -> Person:
    """Return a person by number; raise NotFoundError if it does not exist."""
    person = session.get(Person, person_id)
    if person is None or person.deleted_at is not None:
        raise NotFoundError(f"there is no person number {person_id}; see the list of people")
    return person


def team_report(team: Team) -> schemas.TeamReport:
    """Return a team as organisers see it."""
    people = sorted(person.name for person in team.people if person.deleted_at is None)
    return team.as_report(schemas.TeamReport, people=people)


def person_report(person: Person) -> schemas.PersonReport:
    """Return a person as organisers see them."""
    return person.as_report(schemas.PersonReport, team=person.team.name)


def same_name(session: Session, name: str) -> Team | None:
    """Return the team whose name is this one or looks the same, also if it was merged."""
    return session.scalars(select(Team).where(Team.name_key == name_key(name))).first()


def looks_like(name: str, taken: str) -> str:
    """Say that a name looks the same as that of a team."""
    return (
        f"the name {name!r} looks like {taken!r}: names of teams must differ in more than case, "
        "spaces and dashes"
    )


def _check_name(session: Session, name: str, team: Team | None = None) -> None:
    """Check that no other team has a name that looks the same, or had results under it."""
    other = same_name(session, name)
    if other is not None and other is not team and other.name != name:
        raise ConflictError(looks_like(name, other.name))
    for entry in entries(session, IS_CHANGE, AuditEntry.action == _RENAMED):
        before = entry.details["before"]
        if name_key(before) != name_key(name):
            continue
        owner = _now(session.get_one(Team, int(entry.row.partition(":")[2])))
        had_results = exists().where(
            Submission.team_id == owner.id, Submission.scored_at <= entry.at
        )
        if owner is not team and session.scalar(select(had_results)):
            raise ConflictError(
                f"{before!r} was the name of {owner.name!r} until {entry.at:%Y-%m-%d}, and there "
                "are results under it; choose another name"
            )


def _now(team: Team) -> Team:
    """Return a team, or the one that has what it had since it was merged."""
    return team if team.merged_into is None else _now(team.merged_into)


def _name_is_taken(name: str) -> str:
    return f"the name {name!r} belongs to another team, or to one that was merged"


def _write(transaction: Transaction, row: Team | Person, taken: str) -> None:
    """Insert or change a row; raise ConflictError with a given message if its name is taken."""
    try:
        with transaction.session.begin_nested():
            transaction.add(row)
    except IntegrityError:
        raise ConflictError(taken) from None


def _check_names(team: Team, into: Team) -> None:
    shared = {person.name for person in team.people} & {person.name for person in into.people}
    if shared:
        names = ", ".join(map(repr, sorted(shared)))
        raise ConflictError(f"both teams have a person called {names}; rename one of them first")


def _rows_of(session: Session, team: Team) -> Sequence[_OfTeam]:
    return [
        *session.scalars(select(Person).where(Person.team == team).order_by(Person.id)),
        *session.scalars(select(Submission).where(Submission.team == team).order_by(Submission.id)),
        *session.scalars(select(Grant).where(Grant.team == team).order_by(Grant.id)),
    ]


def _subject_of(row: _OfTeam, team: Team) -> Person | str:
    """Return what an entry on a row is about."""
    match row:
        case Person():
            return row
        case Submission():
            return row.id
        case Grant():
            return team.name


def _mark_repeats(session: Session, team: Team, into: Team) -> Sequence[Submission]:
    """Mark the later of two submissions of each file that both teams have; return the marked."""
    first, second = aliased(Submission), aliased(Submission)
    pairs = session.execute(
        select(first, second)
        .join(second, (first.split == second.split) & (first.sha256 == second.sha256))
        .where(first.team_id == into.id, first.repeat == "")
        .where(second.team_id == team.id, second.repeat == "")
        .order_by(first.id)
    ).all()
    marked = [
        brought if known.received_at <= brought.received_at else known for known, brought in pairs
    ]
    for later in marked:
        later.repeat = later.id
    session.flush()
    return marked
