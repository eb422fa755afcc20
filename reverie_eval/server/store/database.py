"""The database: SQLite in a file, or PostgreSQL.

Only one transaction writes at a time: SQLite locks its file when a transaction begins, PostgreSQL
takes an advisory lock. So decisions inside a transaction, such as on quotas or the chain of the
audit log, cannot be outdated when it is committed. Scoring comes before, so transactions are short.
"""

import errno
import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from threading import Lock
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError, OperationalError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as NoConnectionLeftError
from sqlalchemy.orm import DeclarativeBase, Session

from reverie_eval.errors import ReverieEvalError
from reverie_eval.text import first_few

MIGRATIONS = Path(__file__).parent / "migrations"

AT_ONCE = 1000
"""Rows in memory while all of a table, which may be a million, are read or written."""
IS_READING = "is a reading"
"""In ``info`` of sessions that only read, so what was read once need not be read again."""

_FULL = {errno.ENOSPC, errno.EDQUOT}
_FULL_SQLSTATE = "53100"
"""PostgreSQL's ``disk_full``: https://www.postgresql.org/docs/current/errcodes-appendix.html"""
_NO_CONNECTION_SQLSTATES = ("08", "57P", "53300")
"""Connection exceptions, an operator's intervention, too many connections."""
_NO_SPACE_FOR_INDEX = sqlite3.SQLITE_IOERR_SHMSIZE
_INDEX_SIZE = 32 << 10
"""Bytes, at least: https://www.sqlite.org/walformat.html#the_wal_index_file_format"""
_BUSY = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}
_WRITER_LOCK = 0x5EEDED
"""An arbitrary number that identifies the advisory lock."""

_SQLITE_PRAGMAS = (
    "journal_mode = WAL",  # reading is possible during a write
    "synchronous = FULL",  # committed transactions survive a power cut
    "foreign_keys = ON",
    "busy_timeout = 30000",  # milliseconds to wait for the lock
)


class UnreadableValueError(ValueError):
    """A stored value cannot be read; it is not quoted, as it may be anything."""


class FileReplacedError(SQLAlchemyError):
    """SQLite's file was removed or replaced: what is written to the open one would be lost."""


class NoSpaceError(SQLAlchemyError):
    """The disk is so full that only one connection can use SQLite's file, and another one does."""

    def __init__(self) -> None:
        super().__init__("the disk is full, so only one connection at a time can use the database")


class Database:
    """Database sessions for reading and for writing."""

    def __init__(self, url: sa.URL | str) -> None:
        self.engine = sa.create_engine(
            url, pool_pre_ping=True, hide_parameters=True, json_deserializer=_read_json
        )
        self._write_lock = Lock()
        """Held by this process's writer. SQLite waits by polling, less and less often, so the
        writer that waited longest would come last."""
        self._opened: tuple[int, int] | None = None
        """What tells SQLite's file from another one in its place, since it was opened."""
        # Every transaction of SQLite is a snapshot.
        isolation = {} if self.is_sqlite else {"isolation_level": "REPEATABLE READ"}
        self._snapshots = self.engine.execution_options(**isolation)
        if self.is_sqlite:
            sa.event.listen(self.engine, "do_connect", self._connect_sqlite)
            sa.event.listen(self.engine, "begin", _begin_sqlite)

    @property
    def is_sqlite(self) -> bool:
        """Whether the database is an SQLite file."""
        return self.engine.dialect.name == "sqlite"

    def check_file(self) -> None:
        """Raise FileReplacedError if SQLite's file was removed or replaced since it was opened."""
        if self._opened is not None and self._file_now() != self._opened:
            path = self.engine.url.database
            raise FileReplacedError(f"{path} was removed or replaced while the server runs")

    def _file_now(self) -> tuple[int, int] | None:
        file = Path(self.engine.url.database or "")
        if not file.is_file():
            return None
        status = file.stat()
        return status.st_dev, status.st_ino

    def _connect_sqlite(self, dialect: sa.Dialect, _: Any, given: Any, named: Any) -> Any:
        self.check_file()  # connecting would create the file
        try:
            connection = _connect_sqlite(dialect, given, named)
        except sqlite3.OperationalError as error:
            # Who writes does not keep others from connecting; who has the file alone does.
            if error.sqlite_errorcode in _BUSY and not self._has_space():
                raise NoSpaceError from None
            raise
        self._opened = self._opened or self._file_now()
        return connection

    def _has_space(self) -> bool:
        """Whether the disk has space for the index that processes share."""
        try:
            with TemporaryFile(dir=Path(self.engine.url.database or "").parent) as file:
                file.write(bytes(_INDEX_SIZE))
        except OSError as error:
            return not is_full(error)
        return True

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """Open a session for reading that sees one snapshot of the database."""
        with Session(self._snapshots, info={IS_READING: True}) as session:
            yield session

    @contextmanager
    def writing(self) -> Iterator[Session]:
        """Open a session for writing; it is committed at the end, or rolled back after an error."""
        engine = self.engine.execution_options(writes=True)
        with self._write_lock, Session(engine, expire_on_commit=False) as session, session.begin():
            self._take_write_lock(session.connection())
            yield session

    @contextmanager
    def trying(self) -> Iterator[Session]:
        """Open a session like :meth:`writing`, and undo at its end what was written."""
        with self.writing() as session:
            yield session
            session.flush()
            session.rollback()

    def upgrade(self) -> None:
        """Migrate the tables to this version, from any released version or from none."""
        with self.migrating() as connection:
            migrate(connection, "head")

    @contextmanager
    def migrating(self) -> Iterator[sa.Connection]:
        """Open a transaction in which tables can be changed.

        Changing a table in SQLite means copying and dropping it, which it refuses while other rows
        refer to it. So foreign keys are only checked at the end.
        """
        with self._write_lock, self.engine.connect() as connection:
            if self.is_sqlite:
                connection.detach()  # not for reuse: it does not check foreign keys
                connection.connection.cursor().execute("PRAGMA foreign_keys = OFF")
            with connection.execution_options(writes=True).begin():
                self._take_write_lock(connection)
                yield connection
                if self.is_sqlite:
                    _check_foreign_keys(connection)

    def _take_write_lock(self, connection: sa.Connection) -> None:
        if self.is_sqlite:  # it locked its file when the transaction began
            self.check_file()
        else:
            connection.execute(sa.text(f"SELECT pg_advisory_xact_lock({_WRITER_LOCK})"))

    def revision(self) -> str | None:
        """Return the current migration of the tables; None if there are no tables."""
        if self.is_sqlite and not Path(str(self.engine.url.database)).is_file():
            return None  # connecting would create the file
        with self.engine.connect() as connection:
            if not sa.inspect(connection).has_table("alembic_version"):
                return None
            version = sa.text("SELECT version_num FROM alembic_version")
            revision: str | None = connection.scalar(version)
            return revision

    def is_current(self) -> bool:
        """Whether the tables are those of this version."""
        return self.revision() == known_revisions()[-1]

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()
        self._opened = None


def count_rows(
    session: Session, table: type[DeclarativeBase], *where: sa.ColumnElement[bool]
) -> int:
    """Return the number of rows of a table that meet all conditions."""
    return session.scalar(sa.select(sa.func.count()).select_from(table).where(*where)) or 0


def migrate(connection: sa.Connection, revision: str) -> None:
    """Migrate the tables to a revision, in the connection's transaction."""
    # Takes a tenth of a second, which most starts of a server do not need.
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    config.attributes["connection"] = connection
    command.upgrade(config, revision)


def known_revisions() -> Sequence[str]:
    """Return all migrations up to this version in their order, by the names of their files."""
    files = (MIGRATIONS / "versions").glob("[0-9]*.py")
    return sorted(file.name.partition("_")[0] for file in files)


def broken_references(connection: sa.Connection) -> Sequence[str]:
    """Return the tables of an SQLite file that have rows that refer to missing rows."""
    rows = connection.exec_driver_sql("PRAGMA foreign_key_check")
    return sorted({table for table, *_ in rows})


def is_full(error: BaseException | None) -> bool:
    """Whether an error, or one of its causes, is that the disk or the database is full."""
    if error is None:
        return False
    match error:
        case OSError(errno=code) if code in _FULL:
            return True
        case NoSpaceError():
            return True
        case sqlite3.Error(sqlite_errorcode=sqlite3.SQLITE_FULL):
            return True
        case _ if getattr(error, "sqlstate", None) == _FULL_SQLSTATE:
            return True
    return is_full(error.__cause__ or error.__context__)


def is_unreachable(error: BaseException | None) -> bool:
    """Whether an error, or what led to it, is that the database cannot be asked for the moment."""
    if error is None:
        return False
    match error:
        case DBAPIError(connection_invalidated=True) | NoConnectionLeftError():
            return True
        case OperationalError(orig=sqlite3.Error(sqlite_errorcode=code)) if code in _BUSY:
            return True
        case OperationalError(orig=said) if _is_of_connection(said):
            return True
    return is_unreachable(error.__cause__ or error.__context__)


def _is_of_connection(said: BaseException | None) -> bool:
    """Whether psycopg had no connection, or PostgreSQL closed or refused it."""
    if not hasattr(said, "sqlstate"):
        return False
    state = getattr(said, "sqlstate", None)
    return state is None or state.startswith(_NO_CONNECTION_SQLSTATES)


def _read_json(stored: str | bytes) -> Any:
    try:
        return json.loads(stored)
    except (ValueError, RecursionError):
        raise UnreadableValueError("a stored JSON text cannot be read") from None


def _connect_sqlite(dialect: sa.Dialect, given: Any, named: Any) -> Any:
    """Open the file; on a full disk without the index that processes share, which takes space.

    Then no other connection can use the file, but what is in it can still be read. If a server is
    running, the index is there.
    """
    try:
        return _prepared(dialect.connect(*given, **named), _SQLITE_PRAGMAS)
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode != _NO_SPACE_FOR_INDEX:
            raise
    pragmas = ("locking_mode = EXCLUSIVE", *_SQLITE_PRAGMAS)
    return _prepared(dialect.connect(*given, **named), pragmas)


def _prepared(connection: Any, pragmas: Sequence[str]) -> Any:
    """Return an SQLite connection with these settings; it is closed if one of them fails."""
    try:
        connection.isolation_level = None  # _begin_sqlite begins transactions, not the driver
        for pragma in pragmas:
            connection.execute(f"PRAGMA {pragma}")
    except BaseException:
        connection.close()
        raise
    return connection


def _check_foreign_keys(connection: sa.Connection) -> None:
    if broken := broken_references(connection):
        raise ReverieEvalError(
            f"the database is damaged: rows of {first_few(broken)} refer to missing rows; nothing "
            "was changed, restore a backup"
        )


def _begin_sqlite(connection: sa.Connection) -> None:
    writes = connection.get_execution_options().get("writes")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
