"""Write what leaderboards show as tables for analysis: CSV, with a description of all columns.

Everything is taken from the leaderboards' own JSON, so nothing is exported that they do not show.
Results have the columns of a leaderboard's CSV.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import staged_folder
from reverie_eval.metrics import CATALOGUE
from reverie_eval.reporting.service import METHOD_COSTS, METHOD_FLAGS
from reverie_eval.server.boards.leaderboard import Rankings, as_json, columns_of, flat_rows
from reverie_eval.server.boards.news import corrections_of
from reverie_eval.server.csv_files import write_csv
from reverie_eval.server.operations.restore import copied_server
from reverie_eval.server.state import ServerState

DESCRIPTION = "datapackage.json"
"""A Data Package: https://specs.frictionlessdata.io/data-package/"""

Row = Mapping[str, Any]


class ExportedTable(NamedTuple):
    """A table of the export."""

    name: str
    columns: Sequence[str]
    rows: Sequence[Row]


def export(source: Path, folder: Path) -> Sequence[ExportedTable]:
    """Write the tables of all leaderboards into a new or empty folder; return what was written.

    The source is a server's folder, also while it is running, or a backup.

    Raises
    ------
    BackupError, SettingsError, ReceiptError
        If the source cannot be opened.
    ReverieEvalError
        If the folder is not empty.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ReverieEvalError(f"{folder} is not empty; choose a new or an empty folder")
    with copied_server(source) as state, staged_folder(folder, last=DESCRIPTION) as place:
        tables = list(_tables(state))
        for table in tables:
            with (place / f"{table.name}.csv").open("w", encoding="utf-8", newline="") as file:
                rows = ([row.get(name) for name in table.columns] for row in table.rows)
                write_csv(file, table.columns, rows)
        description = _description(state.settings.title, tables)
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
            of_board = {name: shown[name] for name in _OF_BOARD}
            boards.append(shown)
            results += [{**of_board, **row} for row in flat_rows(shown)]
            corrections += shown["corrections"]
            if not board.name:  # reviews are of submissions, and the same on all of them
                reviews += [
                    of_board | {"submission_id": row["submission_id"]} | review
                    for row in (*shown["rows"], *shown["apart"])
                    for review in row["reviews"]
                ]
    yield ExportedTable("leaderboards", _BOARD, boards)
    yield ExportedTable("results", [*_OF_BOARD, *columns_of(results), "description"], results)
    yield ExportedTable("reviews", _REVIEW, reviews)
    yield ExportedTable("corrections", _CORRECTION, corrections)


_OF_BOARD = ("split", "board")
_BOARD = (*_OF_BOARD, "protocol", "metric", "fingerprint", "signature")
_REVIEW = ("split", "submission_id", "verdict", "reason", "reviewer", "created_at")
_CORRECTION = (*_OF_BOARD, "created_at", "reason", "signature")
_INTEGERS = frozenset({"rank", "rank_low", "rank_high", "group", "submissions", "sample_size"})


def _field(column: str) -> Mapping[str, str]:
    """Describe a column: its type, and its unit if it is a metric or an end of its interval."""
    metric = CATALOGUE.get(column.removesuffix("_low").removesuffix("_high"))
    if metric is not None:
        return {"name": column, "type": "number", "unit": metric.unit}
    if column in _INTEGERS:
        return {"name": column, "type": "integer"}
    if column in METHOD_COSTS:
        return {"name": column, "type": "number"}
    is_flag = column in METHOD_FLAGS or column == "reference"
    return {"name": column, "type": "boolean" if is_flag else "string"}


def _description(title: str, tables: Sequence[ExportedTable]) -> Row:
    return {
        "name": "leaderboards",
        "title": title,
        "resources": [
            {
                "name": table.name,
                "path": f"{table.name}.csv",
                "format": "csv",
                "schema": {"fields": list(map(_field, table.columns))},
            }
            for table in tables
        ],
    }
