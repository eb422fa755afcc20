"""Opening a server or its database: whatever prevents it is said in a sentence, with a remedy.

Whatever is changed, the snapshots that are due are taken first.
"""

import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from datetime import datetime
from pathlib import Path

from sqlalchemy import URL
from sqlalchemy.exc import DBAPIError, OperationalError, SQLAlchemyError

from reverie_eval.errors import Problem, RejectedError, ReverieEvalError
from reverie_eval.server.audit.log import AuditLog
from reverie_eval.server.audit.transactions import Clock, Transaction, Transactions, utc_now
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.scoring.boards import Board, Boards, load_boards
from reverie_eval.server.scoring.processes import ScoringProcesses
from reverie_eval.server.scoring.rules import LastRules
from reverie_eval.server.settings import Settings, SettingsError
from reverie_eval.server.state import ServerState, signer_of
from reverie_eval.server.store.damage import damage_in, find_damage
from reverie_eval.server.store.database import Database, is_full, is_unreachable, known_revisions
from reverie_eval.text import first_few
from reverie_eval.version import __version__

REFUSALS = (SQLAlchemyError, ModuleNotFoundError, ValueError)
"""Errors from using a database; a stored value that cannot be read is a ValueError."""
_OF_FILE = {"SQLITE_CANTOPEN", "SQLITE_READONLY", "SQLITE_PERM"}
"""SQLite's errors about files that it may not use."""
_LATER_VERSION = f"was made by a later version than {__version__}; install the latest reverie-eval"


class FolderError(RejectedError):
    """A server cannot start from its folder; ``problems`` lists why, with remedies."""

    subject = "server folder"


def open_server(settings: Settings, clock: Clock = utc_now, workers: int = 0) -> ServerState:
    """Open everything that a server needs, and check it.

    Files are scored in so many processes, which start with the context of ``scoring``; with 0, they
    are scored in this one.

    Raises
    ------
    SettingsError
        If a split cannot be scored, or the database is not up to date.
    ReceiptError
        If the signing key is missing, others can read it, or another one is in use.
    """
    database = Database(settings.database_url)
    try:
        boards = Boards(_load_boards(settings, database))
        scoring = ScoringProcesses(settings, boards, workers) if workers else None
        server = ServerState(settings, boards, database, clock, scoring)
    except BaseException:
        database.close()
        raise
    server.transactions.begins = server.get(Snapshots).take_due
    return server


def _load_boards(settings: Settings, database: Database) -> Mapping[str, Board]:
    """Load the ground truth in force.

    Raises SettingsError if a split cannot be scored, or the database is not of this version.
    """
    if not database.is_current():
        remedy = f"is not of this version; run `reverie-eval server upgrade {settings.folder}`"
        raise SettingsError([Problem("old-database", "database", remedy)])
    with database.reading() as session:
        return load_boards(settings, LastRules().read(session))


@contextmanager
def opened_server(settings: Settings) -> Iterator[ServerState]:
    """Open a server, not only its database; it may be running.

    Raises
    ------
    SettingsError, ReceiptError
        As :func:`open_server`.
    """
    _refuse(database_fault(settings))
    with database_errors(settings.database_url):
        state = open_server(settings)
        with closing(state.database):
            yield state


@contextmanager
def opened(settings: Settings) -> Iterator[Database]:
    """Open a server's database; the server may be running.

    Raises FolderError if this version cannot use it.
    """
    _refuse(database_fault(settings))
    url = settings.database_url
    with database_errors(url), closing(Database(url)) as database:
        yield database


@contextmanager
def acting(
    settings: Settings, actor: str, clock: Callable[[], datetime] = utc_now
) -> Iterator[Transaction]:
    """Change something on a server from its own machine, whether or not it is serving.

    Raises
    ------
    FolderError
        If this version cannot use the database.
    ReceiptError
        If the signing key is not the one in use.
    """
    with opened(settings) as database:
        snapshots = Snapshots(
            lambda: _load_boards(settings, database), Schedules(settings.splits), settings.organiser
        )
        audit_log = AuditLog(signer_of(settings, database))
        transactions = Transactions(
            database, audit_log, clock, settings.channels, snapshots.take_due
        )
        with transactions.begin(actor) as transaction:
            yield transaction


def check_known(database: Database) -> str | None:
    """Return the migration of a database, None if it is empty.

    Raises FolderError if it was made by a later version.
    """
    revision = database.revision()
    if revision is not None and revision not in known_revisions():
        raise FolderError([Problem("unsound", "database", _LATER_VERSION)])
    return revision


def database_fault(settings: Settings) -> str | None:
    """Return why this version cannot use the database, and the remedy; None if it can."""
    try:
        return _revision_fault(settings)
    except REFUSALS as error:
        return reason_of(error)


def _revision_fault(settings: Settings) -> str | None:
    url = settings.database_url
    if url.drivername == "sqlite" and Path(str(url.database)).is_dir():
        return damaged(f"{url.database} is a folder")
    with closing(Database(url)) as database:
        revision = database.revision()
        is_current = revision is not None and database.is_current()
    if is_current:
        return None
    if revision is None:
        return (
            "is empty or missing; restore a backup with `reverie-eval server restore`, or create "
            f"an empty database with `reverie-eval server upgrade {settings.folder}`"
        )
    if revision not in known_revisions():
        return _LATER_VERSION
    return (
        "was made by an earlier version; make a backup, then run "
        f"`reverie-eval server upgrade {settings.folder}`"
    )


@contextmanager
def database_errors(url: URL | None = None) -> Iterator[None]:
    """Turn errors of a database into a ReverieEvalError with a remedy.

    With the URL of an SQLite file, it is looked through after an error that damage may have caused.
    """
    try:
        yield
    except REFUSALS as error:
        _refuse(_damage_behind(error, url))
        raise ReverieEvalError(f"database error: {reason_of(error)}") from None
    except (LookupError, TypeError, AttributeError) as error:
        _refuse(_damage_behind(error, url))
        raise


def _damage_behind(error: Exception, url: URL | None) -> str | None:
    """Return the damage that an error is about or may come from, and the remedy."""
    found = damage_in(error)
    if found is None and url is not None:
        if isinstance(error, ValueError):
            found = "a stored value cannot be read"
        elif not is_unreachable(error):
            with suppress(SQLAlchemyError):
                found = first_few(find_damage(url), 1)
    return damaged(found) if found else None


def _refuse(fault: str | None) -> None:
    if fault is not None:
        raise FolderError([Problem("unsound", "database", fault)]) from None


def reason_of(error: Exception) -> str:
    """Return a database's error message, and what to do."""
    damage = damage_in(error)
    return f"{said_by(error)}; {_remedy(error)}" if damage is None else damaged(damage)


def _remedy(error: Exception) -> str:
    match error:
        case ModuleNotFoundError():
            return "install it: pip install 'reverie-eval[postgresql]'"
        case OperationalError(orig=said) if "locked" in str(said):
            return "another program has locked it: stop that program, or try again"
        case _ if is_full(error):
            return "free some space"
        case OperationalError(orig=sqlite3.Error(sqlite_errorname=name)) if name in _OF_FILE:
            return (
                "check that `database` in the settings names a file that the server can read and "
                "write"
            )
        case _ if is_unreachable(error):
            return "check that it is running, and `database` in the settings"
        case _:
            return "`reverie-eval server doctor` checks all stored data"


def damaged(what: str) -> str:
    """Return that the database is damaged and what was found, and what to do."""
    remedy = "`reverie-eval server restore BACKUP FOLDER`"
    return f"is damaged ({what}); restore the last backup to another folder: {remedy}"


def said_by(error: Exception) -> str:
    """Return a database's error message on one line, without the SQL statement."""
    said = error.orig if isinstance(error, DBAPIError) else error
    return " ".join(str(said).split())
