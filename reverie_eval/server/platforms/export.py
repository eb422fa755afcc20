"""Write what leaderboards show as tables for analysis: CSV, with a description of all columns.

Everything is taken from the leaderboards' own JSON, so nothing is exported that they do not show.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import staged_folder
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.service import METHOD_COSTS, METHOD_FLAGS
from reverie_eval.server.boards.leaderboard import Rankings, as_json
from reverie_eval.server.boards.news import corrections_of
from reverie_eval.server.csv_files import write_csv
from reverie_eval.server.opening import opened_server
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import Settings
from reverie_eval.server.state import ServerState

DESCRIPTION = "datapackage.json"
"""A Data Package: https://specs.frictionlessdata.io/data-package/"""

Row = Mapping[str, Any]


class ExportedTable(NamedTuple):
    """A table of the export."""

    name: str
    columns: Mapping[str, str]
    """The type of each: ``string``, ``integer``, ``number`` or ``boolean``."""
    rows: Sequence[Row]


def export(settings: Settings, folder: Path) -> Sequence[ExportedTable]:
    """Write the tables of all leaderboards into a new or empty folder; return what was written.

    Raises
    ------
    SettingsError, ReceiptError
        If the server cannot be opened.
    ReverieEvalError
        If the folder is not empty.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ReverieEvalError(f"{folder} is not empty; choose a new or an empty folder")
    with opened_server(settings) as state, staged_folder(folder, last=DESCRIPTION) as place:
        tables = list(_tables(state))
        for table in tables:
            with (place / f"{table.name}.csv").open("w", encoding="utf-8", newline="") as file:
                rows = ([row.get(name) for name in table.columns] for row in table.rows)
                write_csv(file, table.columns, rows)
        description = _description(settings.title, tables)
        text = json.dumps(description, indent=2, ensure_ascii=False)
        (place / DESCRIPTION).write_text(f"{text}\n", encoding="utf-8")
    return tables


def _tables(state: ServerState) -> Iterator[ExportedTable]:
    boards: list[Row] = []
    results: list[Row] = []
    reviews: list[Row] = []
    corrections: list[Row] = []
    with state.database.reading() as session:
        for board in state.all_boards:
            ranking = state.get(Rankings).detailed(session, board)
            told = corrections_of(session, board)
            shown = json.loads(as_json(ranking, told, state.settings.organiser))
            boards.append({name: shown[name] for name in _BOARD})
            corrections += shown["corrections"]
            for row in (*shown["rows"], *shown["apart"]):
                said = row.pop("reviews")
                of = {"split": board.split, "submission_id": row["submission_id"]}
                if not board.name:  # reviews are of submissions, and the same on all of them
                    reviews += [of | review for review in said]
                results.append(_flat(board, row))
    metrics = {key: "number" for key in CATALOGUE if any(key in row for row in results)}
    yield _table("leaderboards", boards, _BOARD)
    yield _table("results", results, {**_RESULT, **metrics})
    yield _table("reviews", reviews, _REVIEW)
    yield _table("corrections", corrections, _CORRECTION)


def _flat(board: Board, row: dict[str, Any]) -> Row:
    """Return a row of a leaderboard with a column for each field of its method and each metric."""
    scores, method = row.pop("scores"), row.pop("method")
    bounds = {
        f"{key}_{end}": bound
        for key, interval in (row.pop("intervals") or {}).items()
        for end, bound in zip(("low", "high"), interval, strict=True)
    }
    method["method"] = method.pop("name")
    row["rank_low"], row["rank_high"] = row.pop("rank_interval") or (None, None)
    return {"split": board.split, "board": board.name, **row, **method, **scores, **bounds}


_TEXT, _FLAG = "string", "boolean"
_BOARD = dict.fromkeys(("split", "board", "protocol", "metric", "fingerprint", "signature"), _TEXT)
_RESULT = {
    "split": _TEXT,
    "board": _TEXT,
    "standing": _TEXT,
    "rank": "integer",
    "rank_low": "integer",
    "rank_high": "integer",
    "group": "integer",
    "submission_id": _TEXT,
    "team": _TEXT,
    "published_at": _TEXT,
    "submissions": "integer",
    "method": _TEXT,
    "description": _TEXT,
    "paper": _TEXT,
    "code": _TEXT,
    **dict.fromkeys(METHOD_FLAGS, _FLAG),
    "input_class": _TEXT,
    "sample_size": "integer",
    **dict.fromkeys(METHOD_COSTS, "number"),
    "reference": _FLAG,
    "signature": _TEXT,
    "source": _TEXT,
    "reported_date": _TEXT,
    "dataset": _TEXT,
}
_REVIEW = dict.fromkeys(
    ("split", "submission_id", "verdict", "reason", "reviewer", "created_at"), _TEXT
)
_CORRECTION = dict.fromkeys(("split", "board", "created_at", "reason", "signature"), _TEXT)


def _table(name: str, rows: Sequence[Row], columns: Mapping[str, str]) -> ExportedTable:
    """Return a table; any further columns of its rows, the bounds of intervals, are numbers."""
    bounds = dict.fromkeys((key for row in rows for key in row if key not in columns), "number")
    return ExportedTable(name, {**columns, **bounds}, rows)


def _unit(column: str) -> str:
    """Return the unit of a column with a metric or a bound of its interval; empty for others."""
    metric = CATALOGUE.get(column.removesuffix("_low").removesuffix("_high"))
    return "" if metric is None else metric.unit


def _description(title: str, tables: Sequence[ExportedTable]) -> Row:
    return {
        "name": "leaderboards",
        "title": title,
        "resources": [
            {
                "name": table.name,
                "path": f"{table.name}.csv",
                "format": "csv",
                "schema": {
                    "fields": [
                        {"name": name, "type": kind}
                        | ({"unit": _unit(name)} if _unit(name) else {})
                        for name, kind in table.columns.items()
                    ]
                },
            }
            for table in tables
        ],
    }
