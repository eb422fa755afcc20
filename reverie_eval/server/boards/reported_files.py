"""Files of reported results: tables as papers and other leaderboards print them.

A file is CSV with a heading for each column, or JSON: a list of objects, or columns and methods as
in ``{"columns": ["SR", "SPL"], "methods": {"Walker": {"test": [59.6, 39.0]}}}``. A column contains
a metric or a field of the result, and has one of the names in ``_COLUMNS``.
"""

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from decimal import Decimal
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError

from reverie_eval.errors import Problem
from reverie_eval.metrics import CATALOGUE, Metric, printed_value
from reverie_eval.schemas.organising import NewReported, Rates, ReportedChange
from reverie_eval.schemas.service import ReportedMethod
from reverie_eval.schemas.wire import wrong_value
from reverie_eval.server.csv_files import CsvRow, CsvTable, read_csv, unreadable
from reverie_eval.server.errors import TableError
from reverie_eval.text import did_you_mean

Request = TypeVar("Request", NewReported, ReportedChange)

_PER_CENT = 100
_ABOUT = ("team", "method", "date", "source", "dataset")
_OF_METHOD = tuple(name for name in ReportedMethod.model_fields if name != "name")
_TEXTS = frozenset({"team", "method", "source", "dataset", "description"})
"""Fields that are an empty text, not null, if they have no value."""
_COLUMNS: Mapping[str, str] = MappingProxyType(
    {
        **{name: name for name in (*_ABOUT, *_OF_METHOD)},
        "dataset_version": "dataset",
        "link": "paper",
        **{metric.label.lower(): metric.key for metric in CATALOGUE.values()},
        **{key: key for key in CATALOGUE},
        # The columns of the public REVERIE leaderboard of 2020 to 2026.
        "nav_success": "success",
        "nav_oracle_success": "oracle_success",
        "nav_spl": "spl",
        "nav_length": "path_length",
        # The names of R2R's and NDH's own scripts.
        "nav_error": "navigation_error",
        "dist_to_end_reduction": "goal_progress",
        # The words of the REVERIE paper.
        "length": "path_length",
        "reverie_success": "rgs",
    }
)
"""The metric or field of a column, by the column's name in lower case without a unit."""
_UNIT = re.compile(r"(\s*%|\s*\(%\)|\s+m|\s*\(m\))$")
_NO_VALUE = (None, "", "-")


class FileRow(NamedTuple):
    """A result in a file; only its scores are checked."""

    place: int
    """The index of the row in the file."""
    where: str
    """The row for people: ``line 5``, ``[3]`` or ``methods.Walker.test``."""
    about: Mapping[str, Any]
    """Everything else in the row, by field."""
    scores: Mapping[str, float]
    """Fractions or metres, by metric."""


class ResultsFile(NamedTuple):
    """A file that was read."""

    rows: Sequence[FileRow]
    problems: Sequence[Problem]
    unread: Sequence[str]
    """Parts of a JSON file that contain no results."""


def as_printed(metric: Metric, value: float) -> str:
    """Return a value as tables print it, in percent or metres, with all its digits.

    >>> as_printed(CATALOGUE["success"], 0.525), as_printed(CATALOGUE["path_length"], 12.0)
    ('52.5', '12')
    """
    number = Decimal(repr(value)) * (_PER_CENT if metric.unit == "fraction" else 1)
    return f"{number.normalize():f}"


def read_results(
    text: str, split: str, rates: Rates, metrics: Collection[str] = CATALOGUE
) -> ResultsFile:
    """Read a file of results; if it covers several splits, the results of one of them.

    ``metrics`` are the keys of the metrics that the split's task has; by default, all metrics.

    Raises
    ------
    TableError
        If the rows or the columns cannot be recognised, with all reasons.
    """
    text = text.removeprefix("\ufeff")
    is_json = text.lstrip().startswith(("{", "["))
    table, unread = _read_json(text, split) if is_json else (read_csv(text), ())
    fields = _fields_of(table.columns, metrics)
    if not {"team", "method"} & set(fields):
        raise TableError(
            [Problem("no-column", "columns", "expected one for the team or the method")]
        )
    rows, problems = [], []
    for place, (where, cells) in enumerate(table.rows):
        row, wrong = _read_row(place, where, dict(zip(fields, cells, strict=False)), rates)
        if len(cells) == len(fields):
            rows.append(row)
        else:
            columns = ", ".join(table.columns)
            wrong = [f"has {len(cells)} values for {len(fields)} columns: {columns}"]
        problems += [Problem("wrong-value", where, told, (place,)) for told in wrong]
    if rates == "percent" and not problems:
        problems += _below_one_percent(rows)
    return ResultsFile(rows, problems, unread)


def read_change(model: type[Request], cells: Mapping[str, str], **more: object) -> Request:
    """Return a request about a reported result, whose values are given as cells of a file.

    Parameters
    ----------
    model : type
        ``ReportedChange`` or ``NewReported``.
    cells : mapping of str to str
        New values by column; an empty one, or ``-`` for a score, removes the earlier value.
    more
        Fields of the request that a file does not have.

    Raises
    ------
    TableError
        If columns are unknown, or values wrong; lists all of them.

    Examples
    --------
    >>> change = read_change(ReportedChange, {"SR": "59.64", "RGS": "", "date": "01/2026"})
    >>> change.scores, change.date
    ({'success': 0.5964, 'rgs': None}, '2026-01')
    """
    given = dict(zip(_fields_of(list(cells), CATALOGUE), cells.values(), strict=True))
    scores, wrong = _read_scores(given, "percent")
    about = {
        name: cell if cell or name in _TEXTS else None
        for name, cell in given.items()
        if name not in CATALOGUE
    }
    renamed = {"name": about.pop("method")} if "method" in about else {}
    method = {name: about.pop(name) for name in _OF_METHOD if name in about} | renamed
    empty = [key for key, cell in given.items() if key in CATALOGUE and cell in _NO_VALUE]
    cleared = dict.fromkeys(empty) if model is ReportedChange else {}
    fields = {**about, **more, "method": method, "scores": {**scores, **cleared}}
    problems = [Problem("wrong-value", "values", told) for told in wrong]
    try:
        request = model.model_validate(fields)
    except ValidationError as error:
        found = map(wrong_value, error.errors())
        # Scores may seem to be missing because they are wrong.
        problems += [
            Problem(each.code, each.where, each.message)
            for each in found
            if not (wrong and each.where == "scores")
        ]
        raise TableError(problems) from None
    if problems:
        raise TableError(problems)
    return request


def _read_row(
    place: int, where: str, cells: Mapping[str, Any], rates: Rates
) -> tuple[FileRow, Sequence[str]]:
    """Return a row, given its cells by field, and what is wrong with its scores."""
    scores, wrong = _read_scores(cells, rates)
    if not scores and not wrong:
        wrong = ["has no score"]
    about = {
        name: cell
        for name, cell in cells.items()
        if name not in CATALOGUE and cell not in _NO_VALUE
    }
    return FileRow(place, where, about, scores), wrong


def _read_scores(
    cells: Mapping[str, Any], rates: Rates
) -> tuple[Mapping[str, float], Sequence[str]]:
    """Return the scores among the cells of a row, and what is wrong with other scores."""
    scores, wrong = {}, []
    for metric in CATALOGUE.values():
        cell = cells.get(metric.key)
        if cell not in _NO_VALUE:
            try:
                scores[metric.key] = printed_value(metric, str(cell), rates)
            except ValueError as error:
                wrong.append(str(error))
    return scores, wrong


def _below_one_percent(rows: Sequence[FileRow]) -> Iterator[Problem]:
    """Report rates that seem to be fractions."""
    values = [
        value
        for row in rows
        for key, value in row.scores.items()
        if CATALOGUE[key].unit == "fraction"
    ]
    if any(values) and max(values) <= 1 / _PER_CENT:
        message = "no rate is above 1 %; if they are fractions, set rates to fraction"
        yield Problem("fractions", "all rates", message)


def _fields_of(columns: Sequence[str], metrics: Collection[str]) -> Sequence[str]:
    """Return the metric, if it is one of those given, or the field of each column.

    A column must not be unknown or have the same meaning as another.
    """
    fields: dict[str, str] = {}
    problems = []
    names = {
        name: field
        for name, field in _COLUMNS.items()
        if field not in CATALOGUE or field in metrics
    }
    for column in columns:
        name = _UNIT.sub("", column.strip().lower()).replace(" ", "_").replace("-", "_")
        known = names.get(name)
        if known is None:
            is_of_others = "not a metric of this split" if name in _COLUMNS else "unknown"
            message = f"{is_of_others}{did_you_mean(name, names)}"
            problems.append(Problem("unknown-column", f"column {column!r}", message))
        elif known in fields:
            message = f"means the same as column {fields[known]!r}; remove one"
            problems.append(Problem("repeated-column", f"column {column!r}", message))
        else:
            fields[known] = column
    if problems:
        raise TableError(problems)
    return list(fields)


def _read_json(text: str, split: str) -> tuple[CsvTable, Sequence[str]]:
    """Return a table, and the parts of the file that contain no results."""
    try:
        # Numbers stay text, so that they are read by the same rule as those of CSV.
        content = json.loads(text, parse_float=str, parse_int=str, parse_constant=str)
    except json.JSONDecodeError as error:
        reason = f"invalid JSON at column {error.colno}: {error.msg}"
        raise unreadable(f"line {error.lineno}", reason) from None
    except RecursionError:
        raise unreadable("the file", "is nested too deeply") from None
    match content:
        case [dict(), *_] if all(isinstance(each, dict) for each in content):
            return _read_objects(content), ()
        case {"columns": [*columns], "methods": dict()}:
            unread = [name for name in content if name not in {"columns", "methods"}]
            return _read_methods(list(map(str, columns)), content["methods"], split), unread
        case _:
            expected = '{"columns": [...], "methods": {NAME: {SPLIT: [...]}}}'
            raise unreadable("the file", f"expected a list of objects, or {expected}")


def _read_objects(objects: Sequence[Mapping[str, Any]]) -> CsvTable:
    columns = list(dict.fromkeys(name for each in objects for name in each))
    rows = [
        CsvRow(f"[{place}]", [each.get(name) for name in columns])
        for place, each in enumerate(objects)
    ]
    return CsvTable(columns, rows)


def _read_methods(columns: Sequence[str], methods: Mapping[str, Any], split: str) -> CsvTable:
    by_split = {name: each for name, each in methods.items() if isinstance(each, dict)}
    rows = [
        CsvRow(f"methods.{name}.{split}", [name, *_as_list(each[split])])
        for name, each in by_split.items()
        if split in each
    ]
    if not rows:
        found = ", ".join(dict.fromkeys(name for each in by_split.values() for name in each))
        message = f"there are no results of {split}; there are results of: {found or 'no split'}"
        raise unreadable("methods", message)
    return CsvTable(["method", *columns], rows)


def _as_list(values: Any) -> Sequence[Any]:
    return values if isinstance(values, list) else [values]
