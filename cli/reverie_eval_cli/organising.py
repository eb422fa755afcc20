"""What an organiser's commands share: who acts, the time, the database, and lists."""

import getpass
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from reverie_eval import ReverieEvalError
from reverie_eval.reporting._table import Table, print_table
from reverie_eval_cli.output import note, show

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

    from reverie_eval.schemas.wire import WireModel
    from reverie_eval.server.operations.checks import Finding
    from reverie_eval.server.service.transactions import Transaction

Request = TypeVar("Request", bound="WireModel")


def actor() -> str:
    """Return the name of the user, for the audit log."""
    try:
        name = getpass.getuser()
    except (KeyError, OSError):  # in a container, a user may have no name
        name = f"user {os.getuid()}"
    return f"{name} (command line)"


def now() -> datetime:
    """Return the time."""
    return datetime.now(UTC)


def after(days: int | None) -> datetime | None:
    """Return the time after so many days, or None for no end."""
    return None if days is None else now() + timedelta(days=days)


@contextmanager
def acting(folder: Path) -> Iterator["Transaction"]:
    """Change something on a server, as the user; it may be serving meanwhile."""
    from reverie_eval.server.operations.checks import acting as acting_on
    from reverie_eval.server.settings import load_settings

    with acting_on(load_settings(folder), actor()) as transaction:
        yield transaction


def checked(model: type[Request], **fields: object) -> Request:
    """Return a request for a change, checked as the API checks it.

    Raises
    ------
    ReverieEvalError
        Naming each field that is wrong.
    """
    from pydantic import ValidationError

    from reverie_eval.server.wrong_values import wrong_value

    try:
        return model.model_validate(fields)
    except ValidationError as error:
        wrong = [wrong_value(detail) for detail in error.errors()]
        told = "; ".join(f"{each.where}: {each.message}" for each in wrong)
        raise ReverieEvalError(told) from None


@contextmanager
def revoking(folder: Path) -> Iterator["Transaction"]:
    """Change something as :func:`acting`, and warn if no organiser can sign in any more."""
    from reverie_eval.server.service.tokens import has_organiser

    with acting(folder) as transaction:
        had_one = has_organiser(transaction.session, transaction.now)
        yield transaction
        if had_one and not has_organiser(transaction.session, transaction.now):
            note("no organiser has a valid token now; `server token add` creates one")


def read_text(file: Path) -> str:
    """Return the text of a file to be imported.

    Raises
    ------
    ReverieEvalError
        If it is not UTF-8.
    """
    try:
        return file.read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ReverieEvalError(f"{file}: invalid UTF-8 from byte {error.start} on") from None


@contextmanager
def reading(folder: Path) -> Iterator["Session"]:
    """Open a server's database to read it."""
    from reverie_eval.server.operations.checks import opened
    from reverie_eval.server.settings import load_settings

    with opened(load_settings(folder)) as database, database.reading() as session:
        yield session


def minute(instant: datetime | None) -> str:
    """Write an instant, in UTC."""
    return "" if instant is None else f"{instant:%Y-%m-%d %H:%M}"


def print_list(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a list: as a table on a terminal, in plain columns for a pipe."""
    table = Table(headings, rows, frozenset(range(len(headings))))
    show(table.to_text, None, lambda console: print_table(console, table))


def show_findings(findings: Sequence["Finding"]) -> int:
    """Print the findings of a check, and return the exit status."""
    rows = [(finding.check, finding.kind, finding.what) for finding in findings]
    print_list(("checked", "result", "details"), rows)
    return 1 if any(finding.kind == "fault" for finding in findings) else 0
