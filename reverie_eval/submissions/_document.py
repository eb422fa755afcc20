"""Parse any JSON text or report where it stops being JSON, and tell its types of values apart."""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeGuard

from reverie_eval.errors import SubmissionError
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._predictions import Records, Submission
from reverie_eval.submissions._reading_log import ReadingLog

if TYPE_CHECKING:
    from json import JSONDecodeError

    from typing_extensions import TypeIs

MAX_VALUES = 30_000_000
"""Enough for a thousand poses in each of the 6,292 episodes of test: 25 million values."""
MAX_RECORDS = 200_000
"""Nearly twenty times the largest split, the 10,290 episodes of train."""

_NOT_JSON = {
    b"PK\x03\x04": "a zip archive within another",
    b"\xfd7zXZ": "an xz archive",
    b"BZh": "a bzip2 archive",
    b"7z\xbc\xaf": "a 7z archive",
    b"Rar!": "a rar archive",
    b"(\xb5/\xfd": "a Zstandard archive",
    b"\x1f\x8b": "packed twice",
    b"\x80": "a Python pickle",
    b"\x93NUMPY": "a numpy array",
    b"\x89HDF": "an HDF5 file",
    b"version https://git-lfs": "a git-lfs pointer, not the file itself",
    b"<": "a web page",
}
"""What people send instead of a result file, by its first bytes."""
_TAR_MARK = b"ustar"
_TAR_MARK_AT = 257
"""The offset of that mark."""
_PYTHON_LITERAL = re.compile(rb"[\s\[{(]+'")
_BRACKETS = ("[", "{")
_SHOWN_TEXT = 60
_SPACE = re.compile(r"\s*")

_NUMBER_TYPES = (float, int, Real)
"""The common types come first: checking against an abstract class takes ten times as long."""


class RepeatingObject(dict[str, Any]):
    """A JSON object with repeated fields, of which a plain parser would silently keep the last."""

    repeated: frozenset[str]


def are_records(submission: Submission) -> "TypeIs[Records]":
    """Whether a submission consists of Python objects: a list, or a mapping keyed by id."""
    # Text and bytes are sequences too, but they are a path or the content of a file.
    if isinstance(submission, str | bytes | bytearray):
        return False
    return isinstance(submission, Sequence | Mapping)


def parse_document(content: bytes, log: ReadingLog, *, has_lines: bool = False) -> Any:
    """Parse JSON text, including NaN and infinities, so that their locations can be reported.

    Text that is not quite JSON, but tells what was meant, is parsed and noted as a fault, and other
    text is refused. With ``has_lines``, one object after another is not a fault.
    """
    _check_kind(content)
    check_value_count(content, MAX_VALUES)
    try:
        return _decoded_twice(_parse_json(content, log, has_lines=has_lines), log)
    except UnicodeDecodeError as error:
        problem = problems.not_json(f"byte {error.start}", f"not {error.encoding} text")
    except RecursionError:
        problem = problems.too_deep()
    except ValueError:  # Python refuses to convert thousands of digits
        problem = problems.huge_number()
    raise SubmissionError([problem])


def _check_kind(content: bytes) -> None:
    for beginning, kind in _NOT_JSON.items():
        if content.startswith(beginning):
            raise SubmissionError([problems.another_kind(kind)])
    if content.startswith(_TAR_MARK, _TAR_MARK_AT):
        raise SubmissionError([problems.another_kind("a tar archive")])
    if not content.strip():
        raise SubmissionError([problems.another_kind("empty")])
    if is_python_literal(content):
        fault = problems.PYTHON_LITERAL
        raise SubmissionError([fault.problem(1, problems.WHOLE_FILE, (), None)])


def is_python_literal(content: bytes) -> bool:
    """Whether this is what Python prints for a list or a dictionary, which is not JSON."""
    return _PYTHON_LITERAL.match(content) is not None


def parse_python_literal(content: bytes, log: ReadingLog) -> Any:
    """Evaluate what Python printed for lists, dictionaries, strings and numbers; refuse others."""
    import ast

    log.add_whole_file_fault(problems.PYTHON_LITERAL, None)
    try:
        return ast.literal_eval(content.decode().strip())
    except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError) as error:
        raise SubmissionError([problems.not_a_literal()]) from error


def _parse_json(content: bytes | str, log: ReadingLog, *, has_lines: bool = False) -> Any:
    import json  # rarely needed: most files take the fast lane

    try:
        return json.loads(content, object_pairs_hook=_build_object)
    except json.JSONDecodeError as error:
        return _parse_almost_json(error, log, has_lines=has_lines)


def _decoded_twice(document: Any, log: ReadingLog) -> Any:
    """Parse the JSON that a JSON text holds, as ``json.dump(json.dumps(...))`` writes it."""
    if not (isinstance(document, str) and document.lstrip().startswith(_BRACKETS)):
        return document
    log.add_whole_file_fault(problems.ENCODED_TWICE, None)
    return _parse_json(document, log)


def _parse_almost_json(error: "JSONDecodeError", log: ReadingLog, *, has_lines: bool) -> Any:
    """Parse text that ``json`` refuses, if it tells what was meant, or raise SubmissionError."""
    text = error.doc
    if error.msg == "Extra data":
        values, later_error = _parse_several(text)
        if later_error is None:
            return _join(values, error, log, has_lines=has_lines)
        # What follows the last value that could be read.
        rest = text[later_error.pos :]
        if len(values) == 1 and not text[error.pos :].startswith(_BRACKETS):
            log.add_whole_file_fault(problems.TRAILING_TEXT, rest[:_SHOWN_TEXT])
            return values[0]
        error = later_error
    where = f"line {error.lineno}, column {error.colno}"
    if error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated string"):
        raise SubmissionError([problems.cut_short(where)])
    raise SubmissionError([problems.not_json(where, error.msg.removesuffix(" at"))])


def _join(
    values: Sequence[Any], error: "JSONDecodeError", log: ReadingLog, *, has_lines: bool
) -> Sequence[Any]:
    """Return the records of JSON Lines, or of several lists one after another."""
    if all(isinstance(value, dict) for value in values):
        if not has_lines:
            log.add_whole_file_fault(problems.JSON_LINES, None)
        return values
    if all(isinstance(value, list) for value in values):
        log.add_whole_file_fault(problems.SEVERAL_LISTS, None)
        return [record for value in values for record in value]
    where = f"line {error.lineno}, column {error.colno}"
    raise SubmissionError([problems.not_json(where, "Extra data")])


def _parse_several(text: str) -> tuple[Sequence[Any], "JSONDecodeError | None"]:
    """Return the lists and objects that follow one another, and the error at which that ends."""
    import json

    decoder = json.JSONDecoder(object_pairs_hook=_build_object)
    values: list[Any] = []
    position = _end_of_space(text, 0)
    while position < len(text):
        if not text.startswith(_BRACKETS, position):
            return values, json.JSONDecodeError("Expecting value", text, position)
        try:
            value, position = decoder.raw_decode(text, position)
        except json.JSONDecodeError as error:
            return values, error
        values.append(value)
        check_record_count(len(values))
        position = _end_of_space(text, position)
    return values, None


def _end_of_space(text: str, position: int) -> int:
    space = _SPACE.match(text, position)
    return position if space is None else space.end()


def check_record_count(count: int) -> None:
    """Refuse more records than any split could need."""
    if count > MAX_RECORDS:
        raise SubmissionError([problems.too_many_records(MAX_RECORDS)])


def check_value_count(content: bytes, limit: int) -> None:
    """Refuse JSON text that would take gigabytes once it is parsed."""
    if len(content) <= limit:
        return  # nearly always: counting takes as long as a third of parsing
    # Every value but the first follows a comma or the beginning of a list or an object. Counting
    # these bytes is an upper bound that takes milliseconds and no memory.
    count = sum(map(content.count, (b"[", b"{", b",")))
    if count > limit:
        raise SubmissionError([problems.too_many_values(count, limit)])


def _build_object(fields: list[tuple[str, Any]]) -> dict[str, Any]:
    record = dict(fields)
    if len(record) == len(fields):
        return record
    counts = Counter(name for name, _ in fields)
    repeating = RepeatingObject(record)
    repeating.repeated = frozenset(name for name, count in counts.items() if count > 1)
    return repeating


def is_list(value: Any) -> TypeGuard[Sequence[Any]]:
    """Whether JSON would write a value as a list."""
    return isinstance(value, list | tuple)


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a number of Python's or numpy's; booleans are not."""
    return isinstance(value, _NUMBER_TYPES) and not isinstance(value, bool)


def is_integer(value: Any) -> TypeGuard[int]:
    """Whether a value has an integer type; 3.0 has not."""
    # The common type comes first here too.
    return type(value) is int or (isinstance(value, Integral) and not isinstance(value, bool))


def is_finite(number: float) -> bool:
    """Whether a number fits a float and is neither infinite nor NaN."""
    try:
        return math.isfinite(number)
    except OverflowError:  # an integer too large for a float
        return False
