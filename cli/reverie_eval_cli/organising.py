"""What an organiser's commands share: who acts, what time it is, and how lists are shown."""

import getpass
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from reverie_eval.reporting._grids import Grid, aligned, rich_table

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

    from reverie_eval.server.checks import Finding
    from reverie_eval.server.service.people import Minted


def actor() -> str:
    """Return who acts, for the audit log."""
    try:
        name = getpass.getuser()
    except (KeyError, OSError):  # in a container, a user may have no name
        name = f"user {os.getuid()}"
    return f"{name} (command line)"


def now() -> datetime:
    """Return the time."""
    return datetime.now(UTC)


def after(days: int | None) -> datetime | None:
    """Return the time after so many days, if there is an end."""
    return None if days is None else now() + timedelta(days=days)


@contextmanager
def writing(folder: Path) -> Iterator["Session"]:
    """Open a server's database to change it; a server may be serving meanwhile."""
    from reverie_eval.server.checks import opened
    from reverie_eval.server.settings import load_settings

    with opened(load_settings(folder)) as database, database.writing() as session:
        yield session


@contextmanager
def reading(folder: Path) -> Iterator["Session"]:
    """Open a server's database to look into it."""
    from reverie_eval.server.checks import opened
    from reverie_eval.server.settings import load_settings

    with opened(load_settings(folder)) as database, database.reading() as session:
        yield session


def minute(instant: datetime | None) -> str:
    """Write an instant, in UTC."""
    return "" if instant is None else f"{instant:%Y-%m-%d %H:%M}"


def show_list(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a list: as a table on a terminal, in plain columns for a pipe."""
    grid = Grid(headings, rows, frozenset(range(len(headings))))
    if sys.stdout.isatty():
        from rich.console import Console

        Console().print(rich_table(grid))
    else:
        print(aligned(grid))


def show_findings(findings: Sequence["Finding"]) -> int:
    """Print what a look at a server came to, and return the exit status."""
    rows = [(finding.check, finding.kind, finding.what) for finding in findings]
    show_list(("looked at", "is", "what"), rows)
    return 1 if any(finding.kind == "fault" for finding in findings) else 0


def show_token(minted: "Minted") -> None:
    """Print a token alone, for a script, and beside it whose it is and that it is shown once."""
    token = minted.token
    ends = f", until {minute(token.expires_at)} UTC" if token.expires_at else ""
    kind = "invitation" if token.kind == "invite" else "token"
    print(minted.text)
    print(
        f"{kind} of {token.person.name}, {token.person.team.name}{ends}; it is not shown again",
        file=sys.stderr,
    )
