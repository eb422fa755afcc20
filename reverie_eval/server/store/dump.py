"""Dumping and loading all rows in a portable form, to move a server to another database.

Rows come in any order: a team may refer to one that was added later. The columns are those of the
database's own migration, which may be older than this version. Times are ISO 8601, in UTC.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import groupby, islice
from operator import itemgetter
from typing import Any

from sqlalchemy import Connection, DateTime, MetaData, Table, func, insert, select, text
from sqlalchemy.exc import DBAPIError, OperationalError, SQLAlchemyError
from sqlalchemy.schema import AddConstraint, DropConstraint

from reverie_eval.errors import ReverieEvalError
from reverie_eval.server.store.database import AT_ONCE, Database, broken_references, migrate
from reverie_eval.text import first_few

_LEFT_OUT = frozenset({"alembic_version"})
"""The table that a migration makes again."""


Row = Sequence[Any]
"""The name of a table, and the values of a row by column."""


class RowsError(ReverieEvalError):
    """Rows cannot be stored in a database: they contradict each other, or it alters them."""


def dump(database: Database) -> Iterator[Row]:
    """Return all rows of one snapshot; others can write meanwhile."""
    with database.reading() as session:
        connection = session.connection()
        yield from _rows(connection, _tables(connection))


def load(database: Database, revision: str, rows: Iterable[Row]) -> None:
    """Fill an empty database and migrate it to this version, in one transaction.

    All rows are read again and compared.

    Raises
    ------
    RowsError
        If the database cannot store the rows, or not as they are.
    """
    with database.migrating() as connection:
        migrate(connection, revision)
        tables = {table.name: table for table in _tables(connection)}
        given: Counter[str] = Counter()
        stored: Counter[str] = Counter()
        try:
            with _foreign_keys_last(connection, tables.values()):
                for name, group in groupby(_added_up(rows, given), key=itemgetter(0)):
                    typed = _typed(tables[name], group)
                    while some := list(islice(typed, AT_ONCE)):
                        connection.execute(insert(tables[name]), some)
        except OperationalError:
            raise
        except (SQLAlchemyError, LookupError, TypeError, ValueError, ArithmeticError) as error:
            said = error.orig if isinstance(error, DBAPIError) else error
            raise RowsError(" ".join(str(said).split())) from None
        for _ in _added_up(_rows(connection, tables.values()), stored):
            pass
        if differing := sorted(name for name in tables if stored[name] != given[name]):
            raise RowsError(f"rows of {first_few(differing)} are not stored as they were")
        if not database.is_sqlite:
            for table in tables.values():
                if "id" in table.columns:
                    _continue_numbers(connection, table)
        migrate(connection, "head")


def _added_up(rows: Iterable[Row], sums: Counter[str]) -> Iterator[Row]:
    """Yield rows and add up their digests by table, to compare any number of rows in any order."""
    for name, columns in rows:
        content = json.dumps(columns, sort_keys=True).encode()
        sums[name] += int.from_bytes(hashlib.sha256(content).digest())
        yield name, columns


@contextmanager
def _foreign_keys_last(connection: Connection, tables: Iterable[Table]) -> Iterator[None]:
    """Check foreign keys after all rows are there, as pg_restore does."""
    if connection.dialect.name == "sqlite":  # which does not check them while migrating
        yield
        if broken := broken_references(connection):
            raise RowsError(f"rows of {first_few(broken)} refer to missing rows")
        return
    keys = [key for table in tables for key in table.foreign_key_constraints]
    for key in keys:
        connection.execute(DropConstraint(key))
    yield
    for key in keys:
        connection.execute(AddConstraint(key))


def _rows(connection: Connection, tables: Iterable[Table]) -> Iterator[Row]:
    for table in tables:
        chosen = select(table).order_by(*table.primary_key)
        rows = connection.execute(chosen, execution_options={"yield_per": AT_ONCE})
        for row in rows.mappings():
            yield table.name, {name: _portable(value) for name, value in row.items()}


def _tables(connection: Connection) -> list[Table]:
    metadata = MetaData()
    metadata.reflect(connection, only=lambda name, _: name not in _LEFT_OUT)
    return sorted(metadata.tables.values(), key=lambda table: table.name)


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
