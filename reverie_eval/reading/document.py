"""Any JSON text as Python objects, or the place where it stops being JSON."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from reverie_eval.errors import SubmissionError
from reverie_eval.reading import problems
from reverie_eval.reading.predictions import Records, Submission
from reverie_eval.reading.sources import read_bytes

if TYPE_CHECKING:
    from typing_extensions import TypeIs

_NOT_JSON = {
    b"PK\x03\x04": "a zip archive within another",
    b"\xfd7zXZ": "an xz archive",
    b"\x1f\x8b": "gzipped twice",
    b"version https://git-lfs": "a pointer of git-lfs, not the file itself",
    b"<": "a web page",
}
"""What people send in place of a result file, by how it begins."""

MAX_VALUES = 30_000_000
"""A thousand poses for each of the 6,292 episodes of test are 25 million."""


class RepeatingObject(dict[str, Any]):
    """A JSON object that holds some fields twice; a plain parser would keep the last silently."""

    repeated: frozenset[str]


def read_document(submission: Submission) -> Any:
    """Return a submission's records as Python objects, from wherever they come.

    Raises
    ------
    SubmissionError
        If it is no JSON.
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
    """Parse JSON text, NaN and infinities included, so that their places can be told.

    Raises
    ------
    SubmissionError
        If it is no JSON.
    """
    import json  # Seldom needed: most files take the fast lane.

    for beginning, kind in _NOT_JSON.items():
        if content.startswith(beginning):
            raise SubmissionError([problems.another_kind(kind)])
    if not content.strip():
        raise SubmissionError([problems.another_kind("empty")])
    demand_few_values(content, MAX_VALUES)
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
        problem = problems.endless_number()
    raise SubmissionError([problem])


def demand_few_values(content: bytes, limit: int) -> None:
    """Make sure that JSON text does not unfold to gigabytes.

    Every value but the first stands behind a comma or at the beginning of a list or an object.

    Raises
    ------
    SubmissionError
        If it may hold more values than so many.
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
