"""Parse any JSON text, or tell where it stops being JSON; and what its values are."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeGuard

from reverie_eval.errors import SubmissionError
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._predictions import Records, Submission
from reverie_eval.submissions._sources import read_bytes

if TYPE_CHECKING:
    from typing_extensions import TypeIs

MAX_VALUES = 30_000_000
"""A thousand poses for each of the 6,292 episodes of test are 25 million values."""

_NOT_JSON = {
    b"PK\x03\x04": "a zip archive within another",
    b"\xfd7zXZ": "an xz archive",
    b"\x1f\x8b": "gzipped twice",
    b"version https://git-lfs": "a git-lfs pointer, not the file itself",
    b"<": "a web page",
}
"""What people send instead of a result file, by how it begins."""

_NUMBER_TYPES = (float, int, Real)
"""Common types first: checking an abstract class takes ten times as long."""


class RepeatingObject(dict[str, Any]):
    """A JSON object with repeated fields; a plain parser would silently keep the last of each."""

    repeated: frozenset[str]


def read_document(submission: Submission) -> Any:
    """Return a submission's records as Python objects, wherever they come from.

    Raises
    ------
    SubmissionError
        If it is not JSON.
    OSError
        If the file cannot be read.
    """
    return submission if are_records(submission) else parse_document(read_bytes(submission))


def are_records(submission: Submission) -> "TypeIs[Records]":
    """Whether a submission comes as Python objects, a list or an object keyed by id."""
    if isinstance(submission, str | bytes | bytearray):
        return False
    return isinstance(submission, Sequence | Mapping)


def parse_document(content: bytes) -> Any:
    """Parse JSON text, including NaN and infinities, so that their places can be reported.

    Raises
    ------
    SubmissionError
        If it is not JSON.
    """
    import json  # Seldom needed: most files take the fast lane.

    for beginning, kind in _NOT_JSON.items():
        if content.startswith(beginning):
            raise SubmissionError([problems.another_kind(kind)])
    if not content.strip():
        raise SubmissionError([problems.another_kind("empty")])
    check_value_count(content, MAX_VALUES)
    try:
        return json.loads(content, object_pairs_hook=_object)
    except json.JSONDecodeError as error:
        problem = problems.not_json(
            f"line {error.lineno}, column {error.colno}", error.msg.removesuffix(" at")
        )
    except UnicodeDecodeError as error:
        problem = problems.not_json(f"byte {error.start}", f"not {error.encoding} text")
    except RecursionError:
        problem = problems.too_deep()
    except ValueError:
        problem = problems.huge_number()
    raise SubmissionError([problem])


def check_value_count(content: bytes, limit: int) -> None:
    """Refuse JSON text that would take gigabytes once it is parsed.

    Every value but the first follows a comma or the beginning of a list or an object.

    Raises
    ------
    SubmissionError
        If it may hold more values than the limit.
    """
    count = sum(map(content.count, (b"[", b"{", b",")))
    if count > limit:
        raise SubmissionError([problems.too_many_values(count, limit)])


def _object(fields: list[tuple[str, Any]]) -> dict[str, Any]:
    record = dict(fields)
    if len(record) == len(fields):
        return record
    counts = Counter(name for name, _ in fields)
    repeating = RepeatingObject(record)
    repeating.repeated = frozenset(name for name, count in counts.items() if count > 1)
    return repeating


def is_list(value: Any) -> TypeGuard[Sequence[Any]]:
    """Whether a value is what JSON writes as a list."""
    return isinstance(value, list | tuple)


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a number, of Python or numpy; booleans are not."""
    return isinstance(value, _NUMBER_TYPES) and not isinstance(value, bool)


def is_integer(value: Any) -> TypeGuard[int]:
    """Whether a value is of an integer type; 3.0 is not."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_finite(number: float) -> bool:
    """Whether a number fits a float and is neither infinite nor NaN."""
    try:
        return math.isfinite(number)
    except OverflowError:  # an integer beyond the range of floats
        return False
