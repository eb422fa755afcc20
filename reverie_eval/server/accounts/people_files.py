"""Files of people: CSV with a team, a person, an e-mail address and a role in each line."""

from collections.abc import Iterator, Mapping, Sequence

from pydantic import ValidationError

from reverie_eval.errors import Problem
from reverie_eval.schemas.organising import NewPerson, NewTeam, PersonReport
from reverie_eval.schemas.people import NewPeopleImport, PeopleImportReport, PersonInvitation
from reverie_eval.schemas.wire import wrong_value
from reverie_eval.server.accounts import people
from reverie_eval.server.accounts.joining import invite
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.csv_files import CsvRow, csv_text, read_csv
from reverie_eval.server.errors import TableError
from reverie_eval.server.store.tables import name_key
from reverie_eval.text import did_you_mean

_FIELDS: Mapping[str, str] = {"team": "team", "person": "name", "email": "email", "role": "role"}
"""The field of a person that each column contains."""
_REQUIRED = ("team", "person")


def import_people(transaction: Transaction, new: NewPeopleImport) -> PeopleImportReport:
    """Add the people of a file, and their teams; if there is a problem, add none.

    People who already exist stay as they are, so importing a file again changes nothing.

    Raises
    ------
    TableError
        If anything is wrong with the file; lists everything.
    """
    session = transaction.session
    table = read_csv(new.text.removeprefix("\ufeff"))
    columns = [column.strip().lower() for column in table.columns]
    _check_columns(columns)
    known = {(each.team, each.name): each for each in people.everybody(session)}
    team_names = people.names_by_key(session)
    listed: dict[tuple[str, str], str] = {}
    added, problems = [], []
    for place, row in enumerate(table.rows):
        person, wrong = _read(columns, row)
        if person is not None:
            key = (person.team, person.name)
            team = team_names.setdefault(name_key(person.team), person.team)
            wrong = list(_conflicts(person, team, known.get(key), listed.get(key)))
            listed.setdefault(key, row.where)
            if key not in known:
                added.append(person)
        problems += [Problem("wrong-value", row.where, told, (place,)) for told in wrong]
    if problems:
        raise TableError(problems)
    known_teams = set(people.names_of_teams(session))
    teams = [name for name in dict.fromkeys(each.team for each in added) if name not in known_teams]
    invitations = []
    if not new.dry_run:
        for team in teams:
            people.add_team(transaction, NewTeam(name=team))
        for person in added:
            people.add_person(transaction, person)
            if new.invite:
                invitations.append(invite(transaction, person))
    return PeopleImportReport(
        rows=len(table.rows),
        teams=teams,
        added=added,
        known=len(table.rows) - len(added),
        invitations=invitations,
    )


def invitations_csv(invitations: Sequence[PersonInvitation]) -> str:
    """Return invitations as CSV, for a program that mails them."""
    rows = []
    for each in invitations:
        expires = None if each.expires_at is None else each.expires_at.isoformat()
        rows.append((each.team, each.person, each.email, each.token, expires))
    return csv_text(("team", "person", "email", "invitation", "expires"), rows)


def _check_columns(columns: Sequence[str]) -> None:
    problems = [
        Problem("unknown-column", f"column {column!r}", f"unknown{did_you_mean(column, _FIELDS)}")
        for column in columns
        if column not in _FIELDS
    ]
    problems += [
        Problem("repeated-column", f"column {column!r}", "occurs twice; remove one")
        for column in dict.fromkeys(columns)
        if columns.count(column) > 1
    ]
    problems += [
        Problem("no-column", "columns", f"there is no column {column!r}")
        for column in _REQUIRED
        if column not in columns
    ]
    if problems:
        raise TableError(problems)


def _read(columns: Sequence[str], row: CsvRow) -> tuple[NewPerson | None, Sequence[str]]:
    """Return the person of a row, and what is wrong with it."""
    if len(row.cells) != len(columns):
        return None, [f"has {len(row.cells)} values for {len(columns)} columns"]
    cells = {_FIELDS[column]: cell for column, cell in zip(columns, row.cells, strict=True) if cell}
    try:
        return NewPerson.model_validate(cells), []
    except ValidationError as error:
        names = {field: column for column, field in _FIELDS.items()}
        found = [wrong_value(detail) for detail in error.errors()]
        return None, [f"{names[each.where]}: {each.message}" for each in found]


def _conflicts(
    new: NewPerson, team: str, known: PersonReport | None, earlier: str | None
) -> Iterator[str]:
    """Say how a row disagrees with an earlier one, or with a team or person that exists.

    ``team`` is the first name of a team that looks like that in the row.
    """
    if team != new.team:
        yield f"team: {people.looks_like(new.team, team)}"
    if earlier is not None:
        yield f"repeats the person of {earlier}; remove one"
    if known is not None and new.email not in {None, known.email}:
        yield "this person has another e-mail address; change it with `person edit`, or at the desk"
    if known is not None and new.role != known.role:
        yield f"this person is already registered as {known.role}; roles cannot be changed"
