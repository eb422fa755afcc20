"""Reading JSON text: records with their locations, or why the text holds none.

Text that is not quite JSON, and records within another structure, are read if they tell what was
meant. What holds no records at all is told by its form alone.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence, Sized
from typing import TYPE_CHECKING, Any

from reverie_eval.errors import Problem, SubmissionError
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._answers import has_answer
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._fields import (
    ID_KEYS,
    RECORD_FIELDS,
    fields_of,
    has_spelling,
    id_key_of,
    is_list,
    is_number,
    means_trajectory,
)
from reverie_eval.submissions._predictions import MOST, Records, Submission
from reverie_eval.submissions._problems import RecordLocation
from reverie_eval.submissions._sources import check_kind, check_value_count
from reverie_eval.tasks import Task
from reverie_eval.text import count_text

if TYPE_CHECKING:
    from json import JSONDecodeError

    from typing_extensions import TypeIs


MAX_VALUES = 30_000_000
"""Enough for a thousand poses in each of the 6,292 episodes of test: 25 million values."""
MAX_RECORDS = 200_000
"""Nearly twenty times the largest split, the 10,290 episodes of train."""

_BRACKETS = ("[", "{")
_SHOWN_TEXT = 60
# Enough to find where a file is not JSON.
_SHOWN_BEGINNING = 30
_SPACE = re.compile(r"\s*")
# What a file may end within besides texts, lists and objects: words, and the rest of a number.
_CUT_ANYWHERE = ("true", "false", "null", "NaN", "-Infinity", ".0", "e-0", "e+0", "E-0", "E+0")
_COMMA_AT_END = re.compile(r",\s*([\]}])")
_NO_RECORDS = "Expecting a list or an object"


class RepeatingObject(dict[str, Any]):
    """A JSON object with repeated fields, of which a plain parser would silently keep the last."""

    repeated: frozenset[str]


def are_records(submission: Submission) -> "TypeIs[Records]":
    """Whether a submission consists of Python objects: a list, or a mapping keyed by id."""
    # Text and bytes are sequences too, but they are a path or the content of a file.
    if isinstance(submission, str | bytes | bytearray):
        return False
    return isinstance(submission, Sequence | Mapping)


def parse_document(content: bytes, log: ReadingLog) -> Any:
    """Parse JSON or JSON Lines, including NaN and infinities, so that their locations can be told.

    Text that is neither, but tells what was meant, is parsed and noted as a fault, and other text
    is refused.
    """
    check_kind(content)
    check_value_count(content, MAX_VALUES)
    try:
        return _decoded_twice(_parse_json(content, log), log)
    except UnicodeDecodeError as error:
        found = error.object[error.start : error.start + _SHOWN_BEGINNING]
        problem = problems.NOT_JSON.of_file(
            f"byte {error.start}", reason=f"not {error.encoding} text", found=found
        )
    except RecursionError:
        problem = problems.TOO_DEEP.of_file()
    except ValueError:  # Python refuses to convert thousands of digits
        problem = problems.HUGE_NUMBER.of_file()
    raise SubmissionError([problem])


def parse_python_literal(content: bytes, log: ReadingLog) -> Any:
    """Evaluate what Python printed for lists, dictionaries, strings and numbers; refuse others."""
    import ast

    log.add_whole_file_fault(faults.PYTHON_LITERAL, None)
    try:
        return ast.literal_eval(content.decode().strip())
    except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError) as error:
        raise SubmissionError([problems.NOT_A_LITERAL.of_file()]) from error


def _parse_json(content: bytes | str, log: ReadingLog) -> Any:
    import json  # rarely needed: most files are valid

    try:
        return json.loads(content, object_pairs_hook=_build_object)
    except json.JSONDecodeError as error:
        return _parse_almost_json(error, log)


def _decoded_twice(document: Any, log: ReadingLog) -> Any:
    """Parse the JSON that a JSON text holds, as ``json.dump(json.dumps(...))`` writes it."""
    if not (isinstance(document, str) and document.lstrip().startswith(_BRACKETS)):
        return document
    log.add_whole_file_fault(faults.ENCODED_TWICE, None)
    return _parse_json(document, log)


def _parse_almost_json(error: "JSONDecodeError", log: ReadingLog) -> Any:
    """Parse text that ``json`` refuses, if it tells what was meant, or raise SubmissionError."""
    text = error.doc
    if error.msg == "Extra data":
        if text.lstrip().startswith("{") and text.startswith(",", error.pos):
            return _parse_without_brackets(text, log)
        values, later_error = _parse_several(text)
        if later_error is None:
            return _join(values, error, log)
        # What follows the last value that could be read.
        rest = text[later_error.pos :]
        if len(values) == 1 and not text[error.pos :].startswith(_BRACKETS):
            log.add_whole_file_fault(faults.TRAILING_TEXT, rest[:_SHOWN_TEXT])
            return values[0]
        # The later one is where the reader has to look: everything before it was read.
        error = later_error
    raise SubmissionError([_why_not_json(error)])


def _why_not_json(error: "JSONDecodeError") -> Problem:
    # Python stops at the bracket behind a comma too many, and from 3.13 on at the comma itself.
    is_at_comma = error.msg.startswith("Illegal trailing comma")
    comma = error.pos if is_at_comma else len(error.doc[: error.pos].rstrip()) - 1
    if ending := _COMMA_AT_END.match(error.doc, comma):
        return problems.COMMA_AT_END.of_file(_location(error.doc, comma), bracket=ending[1])
    where = _location(error.doc, error.pos)
    rest = error.doc[error.pos :].rstrip()
    # Python expects a comma where a number was cut, and a value where a word was. Between records,
    # a word is not a value that was begun.
    is_cut = any(each.startswith(rest) and rest != each for each in _CUT_ANYWHERE)
    if (is_cut and error.msg != _NO_RECORDS) or error.msg.startswith("Unterminated string"):
        return problems.CUT_SHORT.of_file(where)
    found = error.doc[error.pos : error.pos + _SHOWN_BEGINNING]
    return problems.NOT_JSON.of_file(where, reason=error.msg.removesuffix(" at"), found=found)


def _location(text: str, position: int) -> str:
    line, column = text.count("\n", 0, position) + 1, position - text.rfind("\n", 0, position)
    return f"line {line}, column {column}"


def _parse_without_brackets(text: str, log: ReadingLog) -> Any:
    """Parse the records of a list that lacks its brackets, each with a comma after it."""
    import json

    inner = text.rstrip().removesuffix(",")
    try:
        records = json.loads(f"[{inner}]", object_pairs_hook=_build_object)
    except json.JSONDecodeError as error:
        # Where it is in the text as it was given, without the bracket before it.
        given = json.JSONDecodeError(error.msg, inner, error.pos - 1)
        raise SubmissionError([_why_not_json(given)]) from None
    log.add_whole_file_fault(faults.NO_BRACKETS, None)
    return records


def _join(values: Sequence[Any], error: "JSONDecodeError", log: ReadingLog) -> Sequence[Any]:
    """Return the records of JSON Lines, or of several lists one after another."""
    if all(isinstance(value, dict) for value in values):
        return values
    if all(isinstance(value, list) for value in values):
        log.add_whole_file_fault(faults.SEVERAL_LISTS, None)
        return [record for value in values for record in value]
    raise SubmissionError([_why_not_json(error)])


def _parse_several(text: str) -> tuple[Sequence[Any], "JSONDecodeError | None"]:
    """Return the lists and objects that follow one another, and the error at which that ends."""
    import json

    decoder = json.JSONDecoder(object_pairs_hook=_build_object)
    values: list[Any] = []
    position = _end_of_space(text, 0)
    while position < len(text):
        if not text.startswith(_BRACKETS, position):
            return values, json.JSONDecodeError(_NO_RECORDS, text, position)
        try:
            value, position = decoder.raw_decode(text, position)
        except json.JSONDecodeError as error:
            return values, error
        values.append(value)
        _check_record_count(len(values))
        position = _end_of_space(text, position)
    return values, None


def _end_of_space(text: str, position: int) -> int:
    space = _SPACE.match(text, position)
    return position if space is None else space.end()


def _check_record_count(count: int) -> None:
    """Refuse more records than any split could need."""
    if count > MAX_RECORDS:
        raise SubmissionError([problems.TOO_MANY_RECORDS.of_file(limit=MAX_RECORDS)])


def _build_object(fields: list[tuple[str, Any]]) -> dict[str, Any]:
    record = dict(fields)
    if len(record) == len(fields):
        return record
    counts = Counter(name for name, _ in fields)
    repeating = RepeatingObject(record)
    repeating.repeated = frozenset(name for name, count in counts.items() if count > 1)
    return repeating


def locate_records(
    document: Any, log: ReadingLog, task: Task
) -> Sequence[tuple[RecordLocation, Mapping[str, Any]]]:
    """Return the records that a document holds, each with its location.

    Raises
    ------
    SubmissionError
        If it holds none: it is neither a list of records nor records keyed by their ids, or has
        positions instead of viewpoints, or is an annotation file.
    """
    _check_viewpoints(document)
    given, document = document, _unwrap(document, log)
    if document is not given:
        _check_viewpoints(document)
    _check_predictions(document)
    if isinstance(document, Sized):
        _check_record_count(len(document))
    return [
        (location, record)
        for location, record in _located_records(document, log, task)
        if _is_record(location, record, log, task)
    ]


def _unwrap(document: Any, log: ReadingLog) -> Any:
    """Return the records of a document that holds them in another structure, if it tells which."""
    if is_list(document):
        if document and all(_is_list_of_records(value) for value in document):
            log.add_whole_file_fault(faults.NESTED_LISTS, None)
            return [record for records in document for record in records]
        if document and all(isinstance(value, str) and value[:1] == "{" for value in document):
            return _decode_records(document, log)
    elif isinstance(document, Mapping) and not isinstance(document, RepeatingObject):
        return _unwrap_object(document, log)
    return document


def _decode_records(texts: Sequence[str], log: ReadingLog) -> Sequence[Any]:
    """Parse records that are JSON texts in a list; return the texts if one cannot be read."""
    import json

    try:
        records = [json.loads(text, object_pairs_hook=_build_object) for text in texts]
    except (ValueError, RecursionError):
        return texts
    log.add_whole_file_fault(faults.ENCODED_RECORDS, texts[0])
    return records


def _unwrap_object(document: Mapping[str, Any], log: ReadingLog) -> Any:
    rows = rows_of_table(document)
    if rows is not None:
        log.add_whole_file_fault(faults.TABLE, None)
        return rows
    # The values may be notes beside the records, but not records themselves.
    if not ID_KEYS.isdisjoint(document) or any(
        _is_record_like(value) for value in document.values()
    ):
        return _without_row_numbers(document, log)
    if len(document) > 1 and all(map(_is_lone_record, document.values())):
        log.add_whole_file_fault(faults.LISTED_VALUES, next(iter(document.values())))
        return {key: record for key, (record,) in document.items()}
    return _take_held(document, log)


def _take_held(document: Mapping[str, Any], log: ReadingLog) -> Any:
    """Return the records that an object holds under some of its keys, if it tells which."""
    # One key with records is a wrapper around them; of two, neither is known to be the one that is
    # meant.
    held = {key: value for key, value in document.items() if _holds_records(value)}
    within = [value for value in document.values() if _has_records_within(value)]
    if len(within) == 1 and not held:
        return _unwrap_object(within[0], log)
    if len(held) == 1:
        ((key, records),) = held.items()
        log.add_whole_file_fault(faults.WRAPPED, key)
        return records
    lists = [value for value in held.values() if is_list(value) and _is_record_like(value[0])]
    if lists and len(lists) == len(document):
        log.add_whole_file_fault(faults.WRAPPED_LISTS, next(iter(held)))
        return [record for records in lists for record in records]
    return document


def _is_lone_record(value: Any) -> bool:
    """Whether this is a list of one record, whose id is the key of the list."""
    is_lone = is_list(value) and len(value) == 1 and isinstance(value[0], Mapping)
    return is_lone and ID_KEYS.isdisjoint(value[0])


def _has_records_within(value: Any) -> bool:
    return isinstance(value, Mapping) and any(map(_holds_records, value.values()))


def _is_list_of_records(value: Any) -> bool:
    return is_list(value) and bool(value) and isinstance(value[0], Mapping)


def _is_record_like(value: Any) -> bool:
    return isinstance(value, Mapping) and not RECORD_FIELDS.isdisjoint(value)


def _holds_records(value: Any) -> bool:
    if isinstance(value, Mapping):
        return bool(value) and all(map(_is_record_like, value.values()))
    return _is_list_of_records(value)


def _without_row_numbers(document: Mapping[str, Any], log: ReadingLog) -> Any:
    """Return the records alone if they are keyed by row numbers and have their ids within."""
    for key, record in document.items():
        if not (str(key).isdigit() and isinstance(record, Mapping)):
            return document
        ids = [record[name] for name in ID_KEYS.intersection(record)]
        if not ids or key in map(str, ids):
            return document
    log.add_whole_file_fault(faults.KEYED_BY_ROW, next(iter(document)))
    return list(document.values())


def _located_records(
    document: Any, log: ReadingLog, task: Task
) -> Iterable[tuple[RecordLocation, Any]]:
    if isinstance(document, list | tuple):
        return [
            (RecordLocation(row, id_key=_id_key(record, task)), record)
            for row, record in enumerate(document)
        ]
    if not isinstance(document, Mapping):
        raise _not_a_list(document, task)
    # One record by itself is not a set of keyed records, nor is a report with some sections.
    if 2 * sum(isinstance(value, Mapping) for value in document.values()) < len(document):
        raise _not_a_list(document, task)
    of_task = fields_of(task)
    records = [record for record in document.values() if isinstance(record, Mapping)]
    is_other = records and not any(has_spelling(record, of_task) for record in records)
    if is_other and not isinstance(document, RepeatingObject):
        raise _not_a_list(document, task)
    if isinstance(document, RepeatingObject):
        repeated = sorted(document.repeated)
        log.problems.extend(problems.REPEATED_KEY.of_file(key=key) for key in repeated)
    log.differences["keyed"] += len(document)
    return [
        (RecordLocation(row, key, id_key=_id_key(record, task)), record)
        for row, (key, record) in enumerate(document.items())
    ]


def _not_a_list(document: Any, task: Task) -> SubmissionError:
    record = problems.official_form(task)
    return SubmissionError([problems.NOT_A_LIST.of_file(found=document, record=record)])


def _id_key(record: Any, task: Task) -> str:
    return id_key_of(record, task) if isinstance(record, Mapping) else task.id_field.name


def _is_record(location: RecordLocation, record: Any, log: ReadingLog, task: Task) -> bool:
    if not isinstance(record, Mapping):
        log.add_wrong_type(location, "", record, problems.record_form(task))
        return False
    if isinstance(record, RepeatingObject):
        for field in sorted(record.repeated & RECORD_FIELDS):
            found = problems.REPEATED_FIELD.of_record(location, field=field)
            log.problems.append(found)
    return True


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
        # As pandas writes columns: by row labels, which must be the same in all of them.
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


_POSITION_KEYS = ("position", "pos", "location", "agent_position", "xyz")
_PATHS_OF_POSITIONS = ("positions", "locations", "waypoints", "poses", "states")
_AXES = ("x", "y", "z")
# The fields with lists that the annotations of the tasks have, and predictions do not.
_TEXTS_OF_ANNOTATIONS = ("instructions", "dialog_history", "timed_instruction")
# A position and a rotation: x, y, z and a quaternion.
_MOST_COORDINATES = 7


def _check_viewpoints(document: Any) -> None:
    """Raise one SubmissionError for a file of a continuous environment, which has positions.

    VLN-CE writes ``{"<episode_id>": [{"position": [x, y, z], "heading": h, "stop": b}, ...]}``, and
    RxR-Habitat a line ``{"instruction_id": n, "path": [[x, y, z], ...]}`` for each episode [1]_.

    References
    ----------
    .. [1] jacobkrantz/VLN-CE 729d141, vlnce_baselines/common/base_il_trainer.py, lines 597-625
    """
    if isinstance(document, Mapping):
        # The records by their ids, or the list of records under a key.
        records = list(document.values())
        records += [each for value in records if is_list(value) for each in value[:1]]
        records = records if _walk_of(document) is None else [document]
    else:
        records = list(document) if is_list(document) else []
    walks = [walk for walk in map(_walk_of, records) if walk is not None]
    found = [walk for walk in walks if all(map(_is_position, walk))]
    # Whole numbers may be viewpoints by their index.
    has_fractions = any(map(_has_fractions, found))
    if found and has_fractions and len(found) > MOST * len(walks):
        problem = problems.POSITIONS.of_file(
            count=len(found), paths=count_text(len(walks), "path"), example=found[0][0]
        )
        raise SubmissionError([problem])


def _walk_of(record: Any) -> Sequence[Any] | None:
    """Return the elements of a record's path; None for what is not a record."""
    if is_list(record) and record and not _are_coordinates(record):
        return record
    if not isinstance(record, Mapping):
        return None
    named = (key for key in record if means_trajectory(key) or key in _PATHS_OF_POSITIONS)
    return next((record[key] for key in named if is_list(record[key]) and record[key]), None)


def _is_position(element: Any) -> bool:
    if not isinstance(element, dict):
        return _are_coordinates(element)
    return any(_are_coordinates(element.get(key)) for key in _POSITION_KEYS) or all(
        is_number(element.get(axis)) for axis in _AXES
    )


def _are_coordinates(value: Any) -> bool:
    is_short = is_list(value) and 1 < len(value) <= _MOST_COORDINATES
    return is_short and all(map(is_number, value))


def _has_fractions(walk: Sequence[Any]) -> bool:
    """Whether these are not viewpoints given by whole numbers, with their angles."""
    return any(isinstance(each, Mapping) or isinstance(each[0], float) for each in walk)


def _check_predictions(document: Any) -> None:
    """Raise one SubmissionError for the annotations of a dataset, which people send by mistake."""
    records = list(document.values()) if isinstance(document, Mapping) else document
    if is_list(records) and records and sum(map(_is_annotation, records)) > MOST * len(records):
        kind = "an annotation file of the dataset"
        raise SubmissionError([problems.ANOTHER_KIND.of_file(kind=kind)])


def _is_annotation(record: Any) -> bool:
    if not isinstance(record, Mapping) or has_answer(record):
        return False
    has_texts = any(is_list(record.get(key)) for key in _TEXTS_OF_ANNOTATIONS)
    return has_texts and not any(key != "path" and means_trajectory(key) for key in record)
