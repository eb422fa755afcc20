"""What an organiser's commands share: the server's folder, who acts, the time, and lists."""

import getpass
import logging
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from datetime import datetime, timedelta, timezone
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from reverie_eval import ReverieEvalError
from reverie_eval.reporting.tables import Table
from reverie_eval_cli import options
from reverie_eval_cli.output import note, show_table

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

    from reverie_eval.server.audit.transactions import Transaction
    from reverie_eval.server.operations.checks import Finding
    from reverie_eval.server.settings import Settings
    from reverie_eval.server.state import ServerState
    from reverie_eval.server.store.paging import Listed, Page

Report = TypeVar("Report")
# Later dates are beyond what a token needs, and close to what Python's calendar ends at.
_MOST_DAYS = 100 * 365


class Folder:
    """The folder of the server that a command works on; the server may be running meanwhile."""

    def __init__(self, folder: str) -> None:
        self.path = Path(folder)

    def __str__(self) -> str:
        return str(self.path)

    @cached_property
    def settings(self) -> "Settings":
        """The settings in the folder."""
        from reverie_eval.server.settings import load_settings

        return load_settings(self.path)

    def open(self) -> "AbstractContextManager[ServerState]":
        """Open the server, not only its database; what it logs are notes of the command."""
        from reverie_eval.server.opening import opened_server

        if logging.lastResort is not None:
            logging.lastResort.setFormatter(_Notes())
        return opened_server(self.settings)

    @contextmanager
    def reading(self) -> Iterator["Session"]:
        """Open the database to read it."""
        from reverie_eval.server.opening import opened

        with opened(self.settings) as database, database.reading() as session:
            yield session

    def all_of(self, list_rows: "Callable[[Session, Page], Listed[Report]]") -> Sequence[Report]:
        """Return the rows of all pages of a list."""
        from reverie_eval.server.store.paging import all_pages

        with self.reading() as session:
            return list(all_pages(partial(list_rows, session)))

    def acting(self) -> "AbstractContextManager[Transaction]":
        """Change something, as the user."""
        from reverie_eval.server.opening import acting

        return acting(self.settings, actor())

    @contextmanager
    def revoking(self) -> Iterator["Transaction"]:
        """Change something, and warn if no organiser can sign in any more.

        Over HTTP this is refused. Here it is not, because this machine has what is needed to let an
        organiser in again, and the last token may be one that was stolen.
        """
        from reverie_eval.server.accounts.people import organisers
        from reverie_eval.server.identity import has_organiser

        with self.acting() as transaction:
            # Only a change is worth a warning: a new server has no organiser yet.
            had_one = has_organiser(transaction.session, transaction.now)
            yield transaction
            if had_one and not has_organiser(transaction.session, transaction.now):
                person, *_ = organisers(transaction.session)
                words = ["server", "token", "add", str(self), person.name]
                command = shlex.join(["reverie-eval", *words, "--team", person.team.name])
                note(f"no organiser has a valid token now; `{command}` creates one")


class _Notes(logging.Formatter):
    """Formats what is logged as a note in one line, with its cause in place of a traceback."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        cause = f": {record.exc_info[1]}".splitlines()[0] if record.exc_info else ""
        return f"note: {record.getMessage()}{cause}"


server_folder = click.argument("folder", type=click.Path(path_type=Folder))


of_team = click.option(
    "--team",
    metavar="NAME",
    help="The person's team, if several have a person of that name.",
)


def expiry(default: int | None) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add when a token expires."""
    return click.option(
        "--expires-days",
        metavar="N",
        type=options.Number(1, _MOST_DAYS),
        default=default,
        show_default="never" if default is None else True,
        help="Days until it expires.",
    )


lasting = options.with_default(
    "--days",
    metavar="N",
    type=options.Number(1, _MOST_DAYS),
    default=30,
    help="Days until the extra submissions expire.",
)


without_asking = click.option("--yes", is_flag=True, help="Do not ask for confirmation.")


def confirm(question: str) -> None:
    """Ask before something that cannot be undone, as the desk does."""
    # A script cannot answer a question, and must not hang on one.
    if not sys.stdin.isatty():
        raise click.UsageError(f"{question} This cannot be undone; confirm it with --yes")
    click.confirm(f"{question} This cannot be undone.", abort=True, err=True)


def actor() -> str:
    """Return the name of the user, for the audit log, which only organisers see."""
    try:
        name = getpass.getuser()
    except (KeyError, OSError):  # in a container, a user may have no name
        name = f"user {os.getuid()}"
    return f"{name} (command line)"


def now() -> datetime:
    """Return the time."""
    return datetime.now(timezone.utc)


def after(days: int | None) -> datetime | None:
    """Return the time after so many days, or None for no end."""
    return None if days is None else now() + timedelta(days=days)


def read_text(file: Path) -> str:
    """Return the text of a file to be imported, which has to be UTF-8."""
    try:
        # Spreadsheets begin UTF-8 with a mark of byte order.
        text = file.read_text("utf-8-sig")
    # Excel writes other encodings unless it is told not to; a guess would garble names.
    except UnicodeDecodeError as error:
        raise ReverieEvalError(f"{file}: invalid UTF-8 from byte {error.start} on") from None
    if not text:
        raise ReverieEvalError(f"{file}: the file is empty")
    return text


def minute(instant: datetime | None) -> str:
    """Write an instant, in UTC."""
    return "" if instant is None else f"{instant:%Y-%m-%d %H:%M}"


def print_list(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a list: as a table on a terminal, in plain columns for a pipe."""
    show_table(Table(headings, rows, frozenset(range(len(headings)))))


def show_findings(findings: Sequence["Finding"]) -> int:
    """Print the findings of a check, and return the exit status."""
    rows = [(finding.check, finding.kind, finding.what) for finding in findings]
    print_list(("checked", "result", "details"), rows)
    return 1 if any(finding.kind == "fault" for finding in findings) else 0
