"""Whether the rows of the database are as the audit log left them.

Each entry has a digest of its row. So the last one on a row tells whether it was changed since, and
there is no row without an entry, or entry without its row. The signatures of results and snapshots
cover what these digests leave out.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, islice
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from reverie_eval.receipts import key_id_of
from reverie_eval.server.audit.log import (
    KEY_REPLACED,
    entries,
    logged_columns,
    row_digest,
    row_name,
)
from reverie_eval.server.audit.signing import all_keys
from reverie_eval.server.store import tables
from reverie_eval.server.store.database import AT_ONCE
from reverie_eval.server.store.paging import LARGEST

_IS_OF_ROW = tables.AuditEntry.row_digest != ""
_LOGGED: Sequence[type[tables.Base]] = (
    tables.Team,
    tables.Person,
    tables.JoinRequest,
    tables.Token,
    tables.Submission,
    tables.Grant,
    tables.Review,
    tables.ReportedResult,
    tables.News,
    tables.Notice,
    tables.SetSchedule,
    tables.StoredSnapshot,
    tables.Correction,
    tables.SigningKey,
)
"""The tables whose rows have entries."""
_WITHOUT_ENTRY: Mapping[type[tables.Base], sa.ColumnElement[bool]] = {
    tables.JoinRequest: tables.JoinRequest.decision.is_(None),
    tables.SigningKey: tables.SigningKey.replaced_at.is_(None),
}
"""Rows of these that have none yet: open requests, which anyone may send, and the key in use."""


def mismatches(session: Session) -> Iterator[str]:
    """Describe every disagreement between the audit log and the rows of the database."""
    # The database compares them: there may be millions.
    rows = (sa.select(_name(kind)).where(~_WITHOUT_ENTRY.get(kind, sa.false())) for kind in _LOGGED)
    visible = sa.union_all(*rows).subquery().select()
    logged = sa.select(tables.AuditEntry.row).where(_IS_OF_ROW)
    for row in sorted(session.scalars(sa.except_(logged, visible))):
        yield f"{row}: in the audit log, but no longer in the database"
    for row in sorted(session.scalars(sa.except_(visible, logged))):
        yield f"{row}: in the database, but not in the audit log"
    yield from _changed(session)
    yield from _mismatched_keys(session)


def _changed(session: Session) -> Iterator[str]:
    """Describe the rows that were changed since their last entries."""
    last = sa.select(sa.func.max(tables.AuditEntry.id)).where(_IS_OF_ROW)
    chosen = (
        sa.select(tables.AuditEntry.row, tables.AuditEntry.row_digest)
        .where(tables.AuditEntry.id.in_(last.group_by(tables.AuditEntry.row)))
        .order_by(tables.AuditEntry.row)
        .execution_options(yield_per=AT_ONCE)
    )
    kinds = {kind.__tablename__: kind for kind in _LOGGED}
    with session.execute(chosen) as every:  # closed also where a row cannot be read
        for table, found in groupby(every, lambda each: each.row.partition(":")[0]):
            while table in kinds and (few := [*islice(found, AT_ONCE)]):
                digests = {each.row: each.row_digest for each in few}
                yield from _changed_of(session, kinds[table], digests)


def _changed_of(
    session: Session, kind: type[tables.Base], digests: Mapping[str, str]
) -> Iterator[str]:
    """Describe the rows of a table that have other digests; those that are missing are not here."""
    names, key = logged_columns(kind), _key_of(kind)
    found = [_value_of(key, row.partition(":")[2]) for row in digests]
    chosen = sa.select(*(getattr(kind, name) for name in names))
    for values in session.execute(
        chosen.where(key.in_(each for each in found if each is not None))
    ):
        columns = dict(zip(names, values, strict=True))
        row = f"{kind.__tablename__}:{columns[key.name]}"
        if row in digests and row_digest(columns) != digests[row]:
            yield f"{row} was changed after its last entry in the audit log"


def _name(kind: type[tables.Base]) -> sa.ColumnElement[str]:
    """Select the names by which entries refer to the rows of a table."""
    return sa.literal(f"{kind.__tablename__}:").concat(sa.cast(_key_of(kind), sa.String))


def _key_of(kind: type[tables.Base]) -> sa.Column[Any]:
    (key,) = kind.__table__.primary_key.columns  # type: ignore[attr-defined]
    return key  # type: ignore[no-any-return]


def _value_of(key: sa.Column[Any], text: str) -> int | str | None:
    """Return the key in an entry, which may have been changed; None if no row has such a key."""
    if key.type.python_type is str:
        return text
    is_number = text.isdecimal() and len(text) <= len(f"{LARGEST}") and int(text) <= LARGEST
    return int(text) if is_number else None


def _mismatched_keys(session: Session) -> Iterator[str]:
    """Describe every signing key that disagrees with its name or with those before and after it."""
    keys = all_keys(session)
    replaced = entries(session, tables.AuditEntry.action == KEY_REPLACED)
    successors = {entry.subject: entry.details.get("by") for entry in replaced}
    for place, key in enumerate(keys):
        name = f"signing key {key.key_id}"
        following = keys[place + 1].key_id if place + 1 < len(keys) else None
        if key_id_of(key.public_key) != key.key_id:
            yield f"{name}: its public key was changed"
        if key.replaced_at is None and (key.valid_until or key.revoked_at or key.reason):
            yield f"{name}: it is in use, but has an end, or a reason for one"
        # That of the first one is before the log, and nothing depends on it.
        if place and key.valid_from != keys[place - 1].replaced_at:
            yield f"{name}: its beginning differs from the log"
        if successors.get(key.key_id) != following:
            yield f"{name}: its successor differs from the log"


def all_names_of_teams(session: Session) -> Mapping[str, frozenset[str]]:
    """Return all names that each team and those merged into it have had, by its current name."""
    names = defaultdict(set)
    for entry in entries(session, tables.AuditEntry.action.in_(["team added", "team renamed"])):
        names[entry.row].add(entry.details.get("after", entry.subject))
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
