"""Tables: the other ways in which pandas and other programs write a list of records as JSON."""

from collections.abc import Mapping, Sequence
from typing import Any

from reverie_eval.submissions._document import is_list
from reverie_eval.submissions._fields import RECORD_FIELDS


def rows_of_table(document: Mapping[str, Any]) -> Sequence[Mapping[str, Any]] | None:
    """Return the rows of a table of columns; None if the document is no table.

    >>> rows_of_table({"instr_id": {"0": "1_2_0", "1": "1_2_1"}, "predObjId": {"0": 3, "1": 4}})
    [{'instr_id': '1_2_0', 'predObjId': 3}, {'instr_id': '1_2_1', 'predObjId': 4}]
    >>> rows_of_table({"columns": ["instr_id", "predObjId"], "data": [["1_2_0", 3]]})
    [{'instr_id': '1_2_0', 'predObjId': 3}]
    """
    names, rows = document.get("columns"), document.get("data")
    if is_list(names) and is_list(rows):
        return _named(names, rows)
    columns = list(document.values())
    if RECORD_FIELDS.isdisjoint(document) or len(columns) == 1:
        return None
    if all(isinstance(column, Mapping) for column in columns):
        keys = columns[0].keys()
        if all(column.keys() == keys for column in columns):
            return [{name: column[key] for name, column in document.items()} for key in keys]
    if all(is_list(column) and len(column) == len(columns[0]) for column in columns):
        return [dict(zip(document, row, strict=True)) for row in zip(*columns, strict=True)]
    return None


def _named(names: Sequence[Any], rows: Sequence[Any]) -> Sequence[Mapping[str, Any]] | None:
    if not all(isinstance(name, str) for name in names):
        return None
    if not all(is_list(row) and len(row) == len(names) for row in rows):
        return None
    return [dict(zip(names, row, strict=True)) for row in rows]
