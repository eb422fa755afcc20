"""Dumping and loading all rows in a portable form, to move a server to another database.

Tables come before those that refer to them. The columns are those of the database's own migration,
which may be older than this version. Times are ISO 8601, in UTC.
"""

from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import groupby, islice
from operator import itemgetter
from typing import Any

from sqlalchemy import Connection, DateTime, MetaData, Table, func, insert, select, text

from reverie_eval.server.store.database import AT_ONCE, Database, migrate

_LEFT_OUT = frozenset({"alembic_version", "fingerprint"})
"""Tables that are made again: by a migration, and from the uploads."""


Row = Sequence[Any]
"""The name of a table, and the values of a row by column."""


def dump(database: Database) -> Iterator[Row]:
    """Return all rows of one snapshot; others can write meanwhile."""
    with database.reading() as session:
        connection = session.connection()
        for table in _tables(connection):
            chosen = select(table).order_by(*table.primary_key)
            rows = connection.execute(chosen, execution_options={"yield_per": AT_ONCE})
            for row in rows.mappings():
                yield table.name, {name: _portable(value) for name, value in row.items()}


def load(database: Database, revision: str, rows: Iterable[Row]) -> None:
    """Fill an empty database and migrate it to this version, in one transaction."""
    with database.migrating() as connection:
        migrate(connection, revision)
        tables = {table.name: table for table in _tables(connection)}
        for name, group in groupby(rows, key=itemgetter(0)):
            typed = _typed(tables[name], group)
            while some := list(islice(typed, AT_ONCE)):
                connection.execute(insert(tables[name]), some)
        if not database.is_sqlite:
            for table in tables.values():
                if "id" in table.columns:
                    _continue_numbers(connection, table)
        migrate(connection, "head")


def _tables(connection: Connection) -> list[Table]:
    metadata = MetaData()
    metadata.reflect(connection, only=lambda name, _: name not in _LEFT_OUT)
    return metadata.sorted_tables


def _portable(value: Any) -> Any:
    if not isinstance(value, datetime):
        return value
    aware = value if value.tzinfo else value.replace(tzinfo=UTC)
    return aware.astimezone(UTC).isoformat()


def _typed(table: Table, rows: Iterable[Row]) -> Iterator[dict[str, Any]]:
    instants = {column.name for column in table.columns if isinstance(column.type, DateTime)}
    for _, row in rows:
        yield {
            name: datetime.fromisoformat(value) if value and name in instants else value
            for name, value in row.items()
        }


def _continue_numbers(connection: Connection, table: Table) -> None:
    """Make PostgreSQL's next id follow the highest that was loaded."""
    serial = text("SELECT pg_get_serial_sequence(:table, 'id')")
    sequence = connection.scalar(serial, {"table": table.name})
    if sequence is not None:
        highest = connection.scalar(select(func.max(table.c.id)))
        following = text("SELECT setval(:sequence, :number, false)")
        connection.execute(following, {"sequence": sequence, "number": (highest or 0) + 1})
