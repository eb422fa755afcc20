"""Paged lists, in the order of a unique key; a cursor is the last key of the previous page."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from sqlalchemy import Select
from sqlalchemy.orm import InstrumentedAttribute, Session

from reverie_eval.schemas.report import ProblemReport
from reverie_eval.server.errors import WRONG_FORM, MalformedError

LONGEST = 1000
"""The largest number of rows on a page."""
LARGEST = 2**31 - 1
"""The largest integer key of a database."""

Row = TypeVar("Row")
Report = TypeVar("Report")


class Page(NamedTuple):
    """The requested page of a list."""

    limit: int = 100
    cursor: str | None = None
    """The cursor from the previous page; None for the first page."""


@dataclass(frozen=True, slots=True)
class Listed(Generic[Report]):
    """A page of a list."""

    rows: list[Report]
    next_cursor: str | None
    """The cursor for the next page; None if this is the last."""


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

    Raises MalformedError if the cursor is invalid.
    """
    rows = rows.order_by(key.desc() if newest_first else key)
    if page.cursor is not None:
        if "\0" in page.cursor:  # not allowed in PostgreSQL's texts
            raise wrong_cursor()
        last = key_of(page.cursor) if key.type.python_type is int else page.cursor
        rows = rows.where(key < last if newest_first else key > last)
    listed = session.scalars(rows.limit(page.limit + 1)).all()
    return cut(listed, page, report, lambda row: getattr(row, key.key))


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
    rows: Sequence[Row],
    page: Page,
    report: Callable[[Row], Report],
    key: Callable[[Row], object],
) -> Listed[Report]:
    """Return a page, given its rows and, if there is a next page, one more row."""
    shown = rows[: page.limit]
    next_cursor = str(key(shown[-1])) if len(rows) > page.limit else None
    return Listed([report(row) for row in shown], next_cursor)


def key_of(cursor: str) -> int:
    """Return the integer key in a cursor. Raises MalformedError if it is invalid."""
    is_short_number = cursor.isascii() and cursor.isdigit() and len(cursor) <= len(str(LARGEST))
    if not is_short_number or int(cursor) > LARGEST:
        raise wrong_cursor()
    return int(cursor)


def wrong_cursor() -> MalformedError:
    """Return the error about an invalid cursor."""
    message = "unknown cursor; take it from the Link header of the previous page of this list"
    problem = ProblemReport(code="wrong-value", where="cursor", message=message)
    return MalformedError(WRONG_FORM, [problem])
