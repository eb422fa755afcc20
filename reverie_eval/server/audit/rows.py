"""Whether the rows of the database are those that the audit log tells of.

Every lasting action in the log must be visible in a row of the database, by its time, and vice
versa. Each column of a row must have the last value that its entries give. Names of persons, which
the log does not have, are compared by their digests.
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from itertools import chain, groupby, islice
from operator import itemgetter
from typing import Any, NamedTuple, Self, TypeAlias, get_args

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from reverie_eval.receipts import key_id_of
from reverie_eval.schemas.organising import TokenKind
from reverie_eval.schemas.service import Verdict
from reverie_eval.server.audit.log import KEY_REPLACED, entries, name_digest, row_name
from reverie_eval.server.audit.signing import all_keys
from reverie_eval.server.store import tables
from reverie_eval.server.store.database import AT_ONCE
from reverie_eval.server.store.paging import LARGEST

_Values: TypeAlias = Mapping[str, Any]
_ENDS_OF_KEYS = (KEY_REPLACED, "signing key revoked")
_REPEATABLE = frozenset({"changed", "token revoked", "scored again", "signing key revoked"})
"""Actions that rows show, but only the last if there were several."""
_NAMING = ("person added", "person changed", "person deleted")
"""Actions that give a person a name."""


class Action(NamedTuple):
    """An action on a row of the database."""

    name: str
    row: str
    """The row as entries refer to it: ``team:3``."""
    at: datetime

    def __str__(self) -> str:
        return f"{self.name} ({self.row}, {self.at:%Y-%m-%d %H:%M:%S})"


_Actions: TypeAlias = sa.Select[Any, Any, Any]
"""Selects name, row and time of actions."""


def mismatches(session: Session) -> Iterator[str]:
    """Describe every disagreement between the audit log and the rows of the database."""
    # The database compares them: there may be millions.
    visible = sa.union_all(*(shown.actions for shown in _VISIBLE)).subquery().select()
    logged = sa.select(tables.AuditEntry.action, tables.AuditEntry.row, tables.AuditEntry.at)
    lasting = logged.where(tables.AuditEntry.action.in_(_LASTING))
    for action in _difference(session, lasting, visible):
        yield f"{action}: logged, but no longer in the database"
    for action in _difference(session, visible, logged):
        yield f"{action}: in the database, but not logged"
    names = dict(_recorded_names(session))
    for team in session.scalars(sa.select(tables.Team)):
        recorded = names.get(row_name(team), team.name)
        if recorded != team.name:
            yield f"{row_name(team)} is called {team.name!r}; the audit log calls it {recorded!r}"
    yield from _mismatched_keys(session)


def _difference(session: Session, some: _Actions, others: _Actions) -> Sequence[Action]:
    """Return the actions that only the first statement selects."""
    rows = session.execute(sa.except_(some, others))
    return sorted((Action(*row) for row in rows), key=str)


def swapped_names(session: Session) -> Iterator[str]:
    """Describe every person whose name is not the one that the audit log records."""
    named = entries(session, tables.AuditEntry.action.in_(_NAMING))
    recorded = {entry.row: entry.details.get("name_digest") for entry in named}
    for person in session.scalars(sa.select(tables.Person)):
        if recorded.get(row_name(person)) not in {None, name_digest(person)}:
            yield f"{row_name(person)} is called {person.name!r}; the audit log has another name"


def changed_values(session: Session) -> Iterator[str]:
    """Describe every row with a value that is not the last one in the audit log."""
    columns = (tables.AuditEntry.row, tables.AuditEntry.details)
    chosen = sa.select(*columns).order_by(tables.AuditEntry.row, tables.AuditEntry.id)
    by_row = groupby(session.execute(chosen.execution_options(yield_per=AT_ONCE)), itemgetter(0))
    logged = ((row, _Logged.of(entries)) for row, entries in by_row)
    for table, rows in groupby(logged, lambda each: each[0].partition(":")[0]):
        if table in _TABLES:
            while few := dict(islice(rows, AT_ONCE)):
                yield from _changed_of(session, _TABLES[table], few)


class _Logged(NamedTuple):
    """What the log has of a row. Entries may have been changed, so anything can be in them."""

    values: dict[str, Any]
    """By column, as JSON has them."""
    whole: set[str]
    """Columns of which the log has all parts; of others, it may have only those that changed."""

    @classmethod
    def of(cls, entries: Iterable[Any]) -> Self:
        """Return the values with which the entries of a row leave it."""
        logged = cls({}, set())
        for _, details in entries:
            if not isinstance(details, Mapping):
                continue
            is_change = "after" in details
            before, after = (details.get(name) for name in ("before", "after"))
            if is_change and isinstance(before, Mapping) and isinstance(after, Mapping):
                _apply(logged.values, before, after)
            elif not is_change:
                _apply(logged.values, {}, details)
                logged.whole.update(details)
        return logged

    def differs(self, column: sa.Column[Any], value: Any) -> bool:
        """Whether a row has another value in a column than the log, if that has one."""
        if column.name not in self.values:
            return False
        return _differs(self.values[column.name], value, is_whole=column.name in self.whole)


def _changed_of(session: Session, table: sa.Table, logged: Mapping[str, _Logged]) -> Iterator[str]:
    """Describe the rows of a table that differ; those that are missing are not among them."""
    (key,) = table.primary_key.columns
    names = {name for row in logged.values() for name in row.values}
    columns = [column for column in table.columns if column.name in names]
    keys = [_key(key, row.partition(":")[2]) for row in logged]
    known = [each for each in keys if each is not None]
    for number, *values in session.execute(sa.select(key, *columns).where(key.in_(known))):
        row = f"{table.name}:{number}"
        changed = [
            column.name
            for column, value in zip(columns, values, strict=True)
            if row in logged and logged[row].differs(column, value)
        ]
        if changed:
            yield f"{row} differs from the audit log in {', '.join(changed)}"


def _key(column: sa.Column[Any], text: str) -> int | str | None:
    """Return the key of a row in an entry; None if no row has such a key."""
    if column.type.python_type is str:
        return text
    is_key = text.isdecimal() and len(text) <= len(f"{LARGEST}") and int(text) <= LARGEST
    return int(text) if is_key else None


def _apply(values: dict[str, Any], before: _Values, after: _Values) -> None:
    """Apply a change that has only the values that differ, also inside mappings."""
    for name in before.keys() - after.keys():
        values.pop(name, None)
    for name, value in after.items():
        if isinstance(value, Mapping):
            known, earlier = values.get(name), before.get(name)
            values[name] = dict(known) if isinstance(known, Mapping) else {}
            _apply(values[name], earlier if isinstance(earlier, Mapping) else {}, value)
        else:
            values[name] = value


def _differs(logged: Any, value: Any, *, is_whole: bool) -> bool:
    """Whether a value is another one than in the log, which has all of its parts or only some."""
    if isinstance(logged, Mapping) and isinstance(value, Mapping):
        names = {*logged, *value} if is_whole else {*logged}
        return any(
            _differs(_part(logged, name), _part(value, name), is_whole=is_whole) for name in names
        )
    if isinstance(value, datetime):
        return _time_in(logged) != value
    return bool(logged != value)


def _part(values: _Values, name: str) -> Any:
    """Return a part of a mapping; None if it was left empty, which uploads do not log."""
    part = values.get(name)
    return None if part == "" else part


def _time_in(logged: Any) -> datetime | None:
    """Return a time in an entry; None if it is not one."""
    try:
        return datetime.fromisoformat(logged)
    except (TypeError, ValueError):
        return None


def _mismatched_keys(session: Session) -> Iterator[str]:
    """Describe every signing key that disagrees with its name or the audit log."""
    keys = all_keys(session)
    ends: dict[str, Mapping[str, Any]] = {}
    for entry in entries(session, tables.AuditEntry.action.in_(_ENDS_OF_KEYS)):
        ends[entry.subject] = {**ends.get(entry.subject, {}), **entry.details}
    for place, key in enumerate(keys):
        end, name = ends.get(key.key_id, {}), f"signing key {key.key_id}"
        until = None if key.valid_until is None else key.valid_until.isoformat()
        following = keys[place + 1].key_id if place + 1 < len(keys) else None
        if key_id_of(key.public_key) != key.key_id:
            yield f"{name}: its public key was changed"
        # That of the first one is before the log, and nothing depends on it.
        if place and key.valid_from != keys[place - 1].replaced_at:
            yield f"{name}: its beginning differs from the log"
        if (end.get("by"), end.get("until")) != (following, until):
            yield f"{name}: its end or its successor differs from the log"


def all_names_of_teams(session: Session) -> Mapping[str, frozenset[str]]:
    """Return all names that each team and those merged into it have had, by its current name."""
    names = defaultdict(set)
    for row, name in _recorded_names(session):
        names[row].add(name)
    teams = session.scalars(sa.select(tables.Team)).all()
    for team in teams:
        names[row_name(team)].add(team.name)
    all_names = {row: set(own) for row, own in names.items()}
    for team in teams:
        # Followed team by team, not by the times of the merges: a clock may have run back.
        way = [team]
        while (into := way[-1].merged_into) is not None and into not in way:
            all_names[row_name(into)] |= names[row_name(team)]
            way.append(into)
    return {team.name: frozenset(all_names[row_name(team)]) for team in teams}


def _recorded_names(session: Session) -> Iterator[tuple[str, str]]:
    """Yield each recorded name of a team, with its row, the earliest first."""
    for entry in entries(session, tables.AuditEntry.action.in_(["team added", "team renamed"])):
        yield entry.row, entry.details.get("after", entry.subject)


class _Shown(NamedTuple):
    """Actions that the rows of a table show."""

    names: Collection[str]
    actions: _Actions


def _shown(action: str, at: InstrumentedAttribute[Any], *where: sa.ColumnElement[bool]) -> _Shown:
    """Select an action that the rows of a table show, as entries refer to it, by its time."""
    return _shown_as(sa.literal(action), [action], at, *where)


def _shown_as(
    name: sa.SQLColumnExpression[Any],
    names: Collection[str],
    at: InstrumentedAttribute[Any],
    *where: sa.ColumnElement[bool],
) -> _Shown:
    """Select actions whose names the rows of a table have, one of these."""
    table = at.class_
    row = sa.literal(f"{table.__tablename__}:").concat(sa.cast(table.id, sa.String))
    return _Shown(names, sa.select(name, row, at).where(at.is_not(None), *where))


_TABLES = {
    name: table
    for name, table in tables.Base.metadata.tables.items()
    if name != tables.JoinRequest.__tablename__ and len(table.primary_key.columns) == 1
}
"""Tables that entries refer to and that keep what these say: answered requests forget people."""
_CREATED = " token created"
_VISIBLE: Sequence[_Shown] = (
    _shown("team added", tables.Team.created_at),
    _shown("team merged", tables.Team.merged_at),
    _shown("person added", tables.Person.created_at),
    _shown("person deleted", tables.Person.deleted_at),
    _shown_as(
        tables.JoinRequest.decision, get_args(tables.Decision), tables.JoinRequest.decided_at
    ),
    _shown_as(
        tables.Token.kind.concat(_CREATED),
        [f"{kind}{_CREATED}" for kind in get_args(TokenKind)],
        tables.Token.created_at,
    ),
    # Using an invitation is not logged; creating the token that it was exchanged for is.
    _shown("token revoked", tables.Token.revoked_at, tables.Token.kind == "access"),
    _shown(tables.SUBMITTED, tables.Submission.scored_at),
    _shown("changed", tables.Submission.published_at),
    _shown("changed", tables.Submission.withdrawn_at),
    _shown(tables.UPLOAD_DELETED, tables.Submission.upload_deleted_at),
    _shown("scored again", tables.Submission.rescored_at),
    _shown("granted", tables.Grant.created_at),
    _shown_as(tables.Review.verdict, get_args(Verdict), tables.Review.created_at),
    _shown("review lifted", tables.Review.lifted_at),
    _shown("reported result added", tables.ReportedResult.created_at),
    _shown("reported result removed", tables.ReportedResult.removed_at),
    _shown(KEY_REPLACED, tables.SigningKey.replaced_at),
    _shown("signing key revoked", tables.SigningKey.revoked_at),
    _shown("news added", tables.News.created_at),
    _shown("news removed", tables.News.removed_at),
    _shown("notice posted", tables.Notice.created_at),
    _shown("schedule set", tables.SetSchedule.created_at),
    _shown("snapshot taken", tables.StoredSnapshot.created_at),
    _shown("correction announced", tables.Correction.created_at),
)
"""The actions that the rows of the database show. Others need not be named here."""
_LASTING = frozenset(chain.from_iterable(shown.names for shown in _VISIBLE)) - _REPEATABLE
"""Actions that the rows of the database show for ever."""
