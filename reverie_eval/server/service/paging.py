"""Lists, a page at a time: in the order of a key that no two rows share, from a cursor on."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from sqlalchemy import Select
from sqlalchemy.orm import InstrumentedAttribute, Session

from reverie_eval.schemas.report import ProblemReport
from reverie_eval.server.errors import WRONG_FORM, MalformedError

LONGEST = 1000
"""The most rows of a page."""
LARGEST = 2**31 - 1
"""The largest integer key of a database."""

Row = TypeVar("Row")
Report = TypeVar("Report")


class Page(NamedTuple):
    """Which page of a list is asked for."""

    limit: int = 100
    cursor: str | None = None
    """Of the page before; None for the first."""


@dataclass(frozen=True, slots=True)
class Listed(Generic[Report]):
    """A page of a list."""

    rows: list[Report]
    next_cursor: str | None
    """Of the page after; None if this is the last."""


def list_page(
    session: Session,
    rows: Select[Row],
    key: InstrumentedAttribute[Any],
    page: Page,
    report: Callable[[Row], Report],
    *,
    newest_first: bool = False,
) -> Listed[Report]:
    """List the rows of a page, in the order of a key.

    Raises
    ------
    MalformedError
        If no page has such a cursor.
    """
    rows = rows.order_by(key.desc() if newest_first else key)
    if page.cursor is not None:
        if "\0" in page.cursor:  # PostgreSQL has no text with it
            raise wrong_cursor()
        last = key_of(page.cursor) if key.type.python_type is int else page.cursor
        rows = rows.where(key < last if newest_first else key > last)
    found = session.scalars(rows.limit(page.limit + 1)).all()
    return cut(found, page, report, lambda row: getattr(row, key.key))


def all_pages(list_rows: Callable[[Page], Listed[Report]]) -> Iterator[Report]:
    """List the rows of all pages, one page after the other."""
    page = Page(LONGEST)
    while True:
        listed = list_rows(page)
        yield from listed.rows
        if listed.next_cursor is None:
            return
        page = Page(LONGEST, listed.next_cursor)


def cut(
    found: Sequence[Row],
    page: Page,
    report: Callable[[Row], Report],
    key: Callable[[Row], object],
) -> Listed[Report]:
    """Return a page of rows, of which one more was looked for, to see whether that is all."""
    shown = found[: page.limit]
    next_cursor = str(key(shown[-1])) if len(found) > page.limit else None
    return Listed([report(row) for row in shown], next_cursor)


def key_of(cursor: str) -> int:
    """Return the integer key in a cursor; MalformedError if there is none."""
    is_short_number = cursor.isascii() and cursor.isdigit() and len(cursor) <= len(str(LARGEST))
    if not is_short_number or int(cursor) > LARGEST:
        raise wrong_cursor()
    return int(cursor)


def wrong_cursor() -> MalformedError:
    """Return the error about a cursor that no page of a list has."""
    message = "unknown cursor; take it from the Link header of the previous page of this list"
    problem = ProblemReport(code="wrong-value", where="cursor", message=message)
    return MalformedError(WRONG_FORM, [problem])
