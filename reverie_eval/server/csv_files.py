"""CSV as spreadsheets write and read it."""

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, TextIO
from unicodedata import normalize

from reverie_eval.errors import Problem
from reverie_eval.server.errors import TableError

_DELIMITERS = ",;\t"
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


class CsvRow(NamedTuple):
    """The cells of a row, in the order of the columns."""

    where: str
    """The row's place in the file, for people: ``line 5``."""
    cells: Sequence[Any]


class CsvTable(NamedTuple):
    """The columns and rows of a file."""

    columns: Sequence[str]
    rows: Sequence[CsvRow]


def read_csv(text: str) -> CsvTable:
    """Read a file whose first line names the columns; empty lines are left out.

    Raises TableError if it cannot be read, or has no rows.
    """
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=_delimiter(text), strict=True)
    rows = []
    start = 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append(CsvRow(f"line {start}", [cell.strip() for cell in cells]))
            start = reader.line_num + 1
    except csv.Error as error:
        raise unreadable(f"line {start}", f"cannot be read as CSV: {error}") from None
    if len(rows) < 2:
        raise unreadable("the file", "has no rows below a line with the names of the columns")
    return CsvTable(rows[0].cells, rows[1:])


def _delimiter(text: str) -> str:
    """Return the separator of the columns in the first line: spreadsheets also use ; and tabs."""
    first_line = text.lstrip().partition("\n")[0]
    return max(_DELIMITERS, key=first_line.count)


def spreadsheet_cell(value: str | float | None) -> str | float | None:
    """Return a cell of CSV that no spreadsheet reads as a formula."""
    if isinstance(value, bool):
        return str(value).lower()
    # Spreadsheets read full-width signs as the ASCII ones, to which NFKC maps them.
    if isinstance(value, str) and normalize("NFKC", value[:1]).startswith(_FORMULA):
        return f"'{value}"
    return value


def write_csv(
    file: TextIO, headings: Iterable[str], rows: Iterable[Iterable[str | float | None]]
) -> None:
    """Write headings and rows as CSV whose cells no spreadsheet reads as formulas."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(map(spreadsheet_cell, row) for row in rows)


def csv_text(headings: Iterable[str], rows: Iterable[Iterable[str | float | None]]) -> str:
    """Return what :func:`write_csv` writes."""
    text = io.StringIO()
    write_csv(text, headings, rows)
    return text.getvalue()


def unreadable(where: str, message: str) -> TableError:
    """Return the error about a file that is not a table."""
    return TableError([Problem("unreadable", where, message)])
