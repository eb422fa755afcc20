"""Damage of the database: looked for in SQLite's file, and recognised in errors.

SQLite keeps no checksums. Its own check finds malformed pages, rows out of order and indexes that
differ from their tables, but not bytes that changed within a value. So every value is read as well:
text must be UTF-8, and JSON, times and numbers must be such. PostgreSQL checks all of that itself.
"""

import logging
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Any, TypeVar

import sqlalchemy as sa
from sqlalchemy.exc import DataError, DBAPIError

from reverie_eval.server.store.database import (
    AT_ONCE,
    Database,
    FileReplacedError,
    UnreadableValueError,
)
from reverie_eval.server.store.tables import Base, UtcDateTime

AnyResult = TypeVar("AnyResult")

_LOGGER = logging.getLogger("reverie_eval.server")
_SAID = {
    sqlite3.SQLITE_CORRUPT: "database disk image is malformed",
    sqlite3.SQLITE_NOTADB: "file is not a database",
}
"""SQLite's messages, without what it may quote from the file."""
_UNREADABLE = "a stored value cannot be read"
_PRIMARY_CODE = 0xFF
"""Bits of SQLite's error code; the others tell more: https://www.sqlite.org/rescode.html"""
_NOT_UTF8 = "Could not decode to UTF-8"
"""How Python's message about a text in SQLite begins; the text itself follows."""
_NOT_JSON = "malformed JSON"
"""What SQLite's functions say of such a text, with an unspecific code."""
_OTHER_FORMAT = "unsupported file format"
"""What SQLite says of one number in its header, with an unspecific code."""
_SQLSTATES = {"XX001": "a page is malformed", "XX002": "an index is malformed"}
"""PostgreSQL's ``data_corrupted`` and ``index_corrupted``."""
_COLUMNS = 'PRAGMA table_info("{}")'
"""No rows for a table that does not exist."""
_MEMORY = "cache_size = -262144"
"""KiB; the check of indexes looks up each row in each of them, in any order."""


def find_damage(url: sa.URL) -> Sequence[str]:
    """Return what is wrong with SQLite's file; empty for a sound one, and for PostgreSQL.

    The database must have the revision of this version. The file is read on a connection of its
    own, because others may have its pages in memory.
    """
    try:
        with closing(Database(url)) as database:
            return list(_damages(database)) if database.is_sqlite else []
    except DBAPIError as error:
        found = damage_in(error)
        if found is None:
            raise
        return [found]


def damage_in(error: BaseException | None) -> str | None:
    """Return the damage that an error, or one of its causes, is about; None if there is none.

    Nothing that was read is quoted: it may be anything. What reads stored values says so by an
    UnreadableValueError: whether a model is at fault, or what it was given, its own error does not
    tell.
    """
    match error:
        case None:
            return None
        case sqlite3.Error() if found := _said_by_sqlite(error):
            return found
        case FileReplacedError():
            return str(error)
        # Without a statement, the driver was reading a row: PostgreSQL has times after all years.
        case UnreadableValueError() | DataError(statement=None):
            return _UNREADABLE
        case _ if found := _SQLSTATES.get(getattr(error, "sqlstate", None) or ""):
            return found
        case _:
            return damage_in(error.__cause__ or error.__context__)


def if_readable(what: str, read: Callable[[], AnyResult]) -> AnyResult | None:
    """Read something; None, and a line in the log, if its rows cannot be read."""
    try:
        return read()
    except Exception as error:
        if not _is_of_rows(error):
            raise
        _LOGGER.warning("rows of %s cannot be read: %s", what, type(error).__name__)
        return None


def _is_of_rows(error: Exception) -> bool:
    """Whether an error is that rows cannot be read, and the transaction can read others.

    PostgreSQL ends a transaction in which it finds damage itself.
    """
    is_ended = isinstance(error, DBAPIError) and getattr(error.orig, "sqlstate", None)
    is_about_one = isinstance(error, UnreadableValueError | DBAPIError)
    return is_about_one and not is_ended and damage_in(error) is not None


def _said_by_sqlite(error: sqlite3.Error) -> str | None:
    code = getattr(error, "sqlite_errorcode", 0)  # Python raises some itself
    if str(error).startswith(_NOT_UTF8):
        return "a stored text is not UTF-8"
    if str(error) == _NOT_JSON:
        return _UNREADABLE
    return _SAID.get(code & _PRIMARY_CODE) or (
        _OTHER_FORMAT if str(error) == _OTHER_FORMAT else None
    )


def _damages(database: Database) -> Iterator[str]:
    with database.engine.connect() as connection:
        connection.exec_driver_sql(f"PRAGMA {_MEMORY}")
        for (said,) in connection.exec_driver_sql("PRAGMA integrity_check"):
            lines = said.splitlines()
            yield from (line for line in lines if line != "ok" and not line.startswith("***"))
        for table in Base.metadata.sorted_tables:
            stored = {row.name for row in connection.exec_driver_sql(_COLUMNS.format(table.name))}
            if missing := [column.name for column in table.columns if column.name not in stored]:
                what = f"lacks {', '.join(missing)}" if stored else "is missing"
                yield f"the table {table.name} {what}"
            elif not _is_readable(connection, table):
                yield f"a stored value of {table.name} cannot be read"


def _is_readable(connection: sa.Connection, table: sa.Table) -> bool:
    """Whether each value of a table is one that its column may have."""
    texts = [
        sa.type_coerce(column, sa.String)  # as it is stored
        for column in table.columns
        if isinstance(column.type, sa.String | sa.JSON)
    ]
    chosen = sa.select(*texts, sa.and_(*map(_is_sound, table.columns)))
    try:
        rows = connection.execute(chosen.execution_options(yield_per=AT_ONCE))
        return all(row[-1] for row in rows)
    except DBAPIError as error:
        if damage_in(error) is None:
            raise
        return False


def _is_sound(column: sa.Column[Any]) -> sa.ColumnElement[bool]:
    """Return the condition that a column's value is of its type; SQLite takes any."""
    kind = sa.func.typeof(column)
    match column.type:
        case sa.JSON():
            is_sound = sa.func.json_valid(column) == 1
        case UtcDateTime():
            is_sound = sa.func.datetime(column).is_not(None) & (kind == "text")
        case sa.Boolean():
            is_sound = sa.type_coerce(column, sa.Integer).in_((0, 1))
        case sa.Integer():
            is_sound = kind == "integer"
        case _:
            has_nul = sa.func.instr(column, sa.func.char(0)) > 0
            is_sound = (kind == "text") & ~has_nul
    return sa.or_(column.is_(None), is_sound) if column.nullable else is_sound
