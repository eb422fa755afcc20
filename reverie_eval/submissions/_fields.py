"""The fields of a record and their values, as they are and as people write them.

A misspelt name is recognised. A value that was not written as JSON has it (a tensor, a list of one,
a line end) tells what was meant, whatever field it is in, but no published evaluator reads it.
"""

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from numbers import Integral, Real
from typing import Any, TypeGuard

import msgspec

from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._faults import Fault
from reverie_eval.tasks import (
    ANSWER,
    BOX,
    BUILT_IN,
    IMAGE_SIZE,
    INSTR_ID,
    OBJECT,
    POINT,
    TRAJECTORY,
    VIEW,
    Field,
    Task,
    find_task,
)

INSTR_ID_KEY = INSTR_ID.name
TRAJECTORY_KEY = TRAJECTORY.name
ANSWER_KEYS = OBJECT.names
BOX_KEY, VIEW_KEY, IMAGE_SIZE_KEY = BOX_KEYS = (BOX.name, VIEW.name, IMAGE_SIZE.name)
POINT_KEYS = tuple(field.name for field in POINT)

ID_KEYS = frozenset(key for name in BUILT_IN for key in find_task(name).id_field.names)
"""The fields in which any of the tasks has its ids."""
RECORD_FIELDS = ID_KEYS.union({TRAJECTORY_KEY, *ANSWER_KEYS, *BOX_KEYS})
"""The fields by which a record of any task is recognised."""
# What codebases write besides -1 and null where the agent predicts no object.
_ABSTENTIONS = ("None", "-1", "")

# Names that resemble an id's, but are an index where a record has the path id beside them.
_INDICES = ("instr_idx", "instrIdx", "instruction_idx", "instruction_index")
# Names that resemble a spelling, but mean something else in the dataset's own files.
_UNRELATED = ("instruction", "instructions")

_MARKS = re.compile(r"[\W_]+")
_SHORT = 5
# Longer names are not compared: no spelling of a known field is half as long.
_LONGEST = 40
MAX_COMPARED = 1_000
"""Different names that are compared with the known ones in a file: each takes a tenth of a
millisecond."""
# How similar a name must be to a spelling: one letter more, less, or in the wrong place.
_CLOSE = 0.87


def is_abstention(value: Any) -> bool:
    """Whether a value under an answer key predicts no object."""
    if isinstance(value, str):
        return value in _ABSTENTIONS
    return value is None or (is_integer(value) and value == ABSTAINED)


@dataclass(frozen=True, eq=False)
class Fields:
    """The fields that are read in a record of a task; all others are ignored."""

    id: Field
    others: Sequence[Field]

    @cached_property
    def all(self) -> frozenset[str]:
        """Every name that is read."""
        return frozenset(name for field in (self.id, *self.others) for name in field.names)

    @property
    def has_answers(self) -> bool:
        """Whether a record predicts an object or a box."""
        return OBJECT in self.others

    @cached_property
    def meant_by(self) -> Mapping[str, str]:
        """The field that each spelling means."""
        return {each: field.name for field in (self.id, *self.others) for each in field.spellings}

    @cached_property
    def long_spellings(self) -> Sequence[str]:
        """The spellings that are compared with other names.

        Short ones such as "bbox" and "path" resemble too much that has nothing to do with them.
        """
        return [spelling for spelling in self.meant_by if len(spelling) > _SHORT]


@cache
def fields_of(task: Task) -> Fields:
    """Return the fields of a task's records: of an item's, those beside its trajectories."""
    return Fields(task.id_field, (TRAJECTORY, *task.answer_fields))


PART_OF_ITEM = Fields(INSTR_ID, (TRAJECTORY, *POINT))
"""The fields of one of an item's trajectories, once it is a record of its own."""


def submission_schema() -> dict[str, Any]:
    """Return the JSON Schema of the official form."""
    fields = [
        (each.name, each.type) if each.default is ... else (each.name, each.type, each.default)
        for each in (INSTR_ID, TRAJECTORY, *ANSWER)
    ]
    prediction = msgspec.defstruct(
        "Prediction", fields, namespace={"__doc__": "What an agent did in one episode."}
    )
    schema: dict[str, Any] = msgspec.json.schema(list[prediction])  # type: ignore[valid-type]
    # What types cannot express: an answer is an object or a box, but not both.
    schema["$defs"]["Prediction"] |= {
        "anyOf": [
            {"required": ["predObjId"]},
            {"required": ["predBox"], "properties": {"predBox": {"type": "array"}}},
        ],
        "not": {
            "required": ["predObjId", "predBox"],
            "properties": {"predObjId": {"minimum": 0}, "predBox": {"type": "array"}},
        },
    }
    return schema


def id_key_of(record: Mapping[str, Any], task: Task) -> str:
    """Return the field with a record's id, or that in which the task has it."""
    named = (key for key in task.id_field.names if record.get(key) is not None)
    return next(named, task.id_field.name)


@lru_cache(maxsize=1024)
def means_trajectory(field: object) -> bool:
    """Whether a name is a spelling of a trajectory's field."""
    return isinstance(field, str) and _MARKS.sub("", field.lower()) in TRAJECTORY.spellings


def has_spelling(record: Mapping[str, Any], fields: Fields) -> bool:
    """Whether some field of a record is a known one, or a spelling of one."""
    return not fields.all.isdisjoint(record) or any(
        _spelling(field) in fields.meant_by for field in record
    )


def find_misspelt(
    record: Mapping[str, Any], fields: Fields, optional: AbstractSet[str] = frozenset()
) -> Mapping[str, str]:
    """Return the misspelt fields of a record, with the known fields that they must mean.

    A field that resembles a known one is left alone if the record has that one as well: codebases
    keep notes of their own beside the official fields. So is one that resembles a field
    which is ``optional`` in this record. A known field that is null counts as missing if another
    spelling of the same name has a value.
    """
    unknown = {field: field_meant_by(field, fields) for field in record if field not in fields.all}
    if None in map(record.get, fields.all & record.keys()):
        record = _without_respelt_nulls(record, unknown)
    missing = {meant for meant in unknown.values() if meant and not _has(record, meant, fields)}
    if BOX_KEY not in missing and not _has_box(record):
        missing -= {VIEW_KEY, IMAGE_SIZE_KEY}
    missing -= optional
    if "path_id" in record:  # then it counts the instructions of a path
        unknown = {field: meant for field, meant in unknown.items() if field not in _INDICES}
    if list(unknown.values()).count(fields.id.name) > 1:
        unknown.pop("id", None)  # the weakest of the spellings: ids of other things have it too
    if list(unknown.values()).count(TRAJECTORY_KEY) > 1:
        unknown.pop("path", None)  # beside another it is the annotated one
    # Of two fields that mean the same, the first counts, as it would under its right name.
    first = {meant: field for field, meant in reversed(unknown.items()) if meant in missing}
    return {field: meant for meant, field in first.items()}


def _without_respelt_nulls(record: Mapping[str, Any], unknown: Iterable[str]) -> Mapping[str, Any]:
    """Return a record without null where another spelling of the same name has a value."""
    respelt = {_spelling(field) for field in unknown if record[field] is not None}
    return {
        field: value
        for field, value in record.items()
        if value is not None or _spelling(field) not in respelt
    }


@lru_cache(maxsize=1024)
def answers_spelt_like(field: str) -> Sequence[str]:
    """Return the known fields of answers from which a name differs only in case and marks.

    >>> answers_spelt_like("pred_box")
    ['predBox']
    """
    return [key for key in (*ANSWER_KEYS, *BOX_KEYS) if _spelling(key) == _spelling(field)]


def _has(record: Mapping[str, Any], key: str, fields: Fields) -> bool:
    """Whether a record gives what a known field is for."""
    if key == fields.id.name:
        return any(each in record for each in fields.id.names)
    if key == ANSWER_KEYS[0]:
        return any(answer in record for answer in ANSWER_KEYS) or _has_box(record)
    if key in BOX_KEYS:
        return key in record or not all(is_abstention(record.get(key)) for key in ANSWER_KEYS)
    return key in record


def _has_box(record: Mapping[str, Any]) -> bool:
    return record.get(BOX_KEY) is not None


@lru_cache(maxsize=1024)
def _spelling(field: object) -> str | None:
    """Return a name in lower case and without marks; None if it is too long to be compared."""
    if not isinstance(field, str) or len(field) > _LONGEST:
        return None
    return _MARKS.sub("", field.lower())


@lru_cache(maxsize=1024)
def field_meant_by(field: object, fields: Fields) -> str | None:
    """Return the known field that a name resembles, if any."""
    spelling = _spelling(field)
    if spelling is None:
        return None
    from difflib import get_close_matches  # slow to import, and rarely needed

    if spelling in fields.meant_by:
        return fields.meant_by[spelling]
    if spelling in _UNRELATED:
        return None
    close = get_close_matches(spelling, fields.long_spellings, 1, _CLOSE)
    return fields.meant_by[close[0]] if close else None


# The common types come first: checking against an abstract class takes ten times as long.
_NUMBER_TYPES = (float, int, Real)


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


NUMBER_AS_TEXT = re.compile(r"\s*-?\d{1,12}(\.\d{0,20})?(e[+-]?\d{1,2})?\s*")
"""A number written as text. Viewpoint ids are 32 hexadecimal digits."""

# What `str` and `repr` give for the arrays and numbers of PyTorch, TensorFlow, JAX and numpy:
# "tensor([3], device='cuda:0')", "<tf.Tensor: shape=(), dtype=int64, numpy=3>", "np.float64(0.5)".
# They take time in proportion to the text, whatever it is.
_TENSOR = re.compile(
    r"(?:Parameter containing:\s)?(?:(?:torch|tf|jnp|np|numpy)\.)?"
    r"(?:[Tt]ensor|[Aa]rray|DeviceArray|u?int\d+|float\d+|str_)"
    r"\((?P<value>.*?)(?:,\s*[a-z_]+=.*)?\)",
    re.DOTALL,
)
_TENSORFLOWS = re.compile(r"<tf\.(?:Tensor|Variable)[ :].*?\bnumpy=(?P<value>.*)>", re.DOTALL)
# A text as Python prints it, or bytes.
_QUOTED = re.compile(r"b?(?P<quote>['\"])(?P<value>.*)(?P=quote)", re.DOTALL)
_POINT_WITHOUT_DIGITS = re.compile(r"(?<=\d)\.(?!\d)")
_BETWEEN_NUMBERS = re.compile(r"(?<=[\d\]])\s+(?=[-\d\[])")
_TO_JSON = str.maketrans("'()", '"[]')
_MOST_LEVELS = 32


def unwrap(value: Any) -> tuple[Any, Fault | None]:
    r"""Return the value that was meant, and the mistake with which it is written, if any.

    >>> unwrap([["402\n"]])[0], unwrap("tensor([0.5], device='cuda:0')")[0], unwrap(7)[0]
    ('402', 0.5, 7)
    """
    fault: Fault | None = None
    for _ in range(_MOST_LEVELS):
        if is_list(value) and len(value) == 1:
            (value,), found = value, faults.LISTED_VALUES
        elif problems.size_of_array(value) == 1:
            value, found = value.tolist(), faults.ARRAYS_OF_ONE
        elif not isinstance(value, str):
            break
        elif (printed := read_printed(value)) is not None:
            value, found = printed, faults.PRINTED_VALUES
        elif (stripped := value.strip()) != value:
            value, found = stripped, faults.PADDED_VALUES
        else:
            break
        fault = fault or found
    return value, fault


def unwrap_number(value: Any) -> tuple[Any, Fault | None]:
    """Return the number that was meant, as :func:`unwrap` does; also from a number as text."""
    if isinstance(value, str) and NUMBER_AS_TEXT.fullmatch(value):
        return float(value), faults.NUMBERS_AS_TEXT
    meant, fault = unwrap(value)
    is_text = isinstance(meant, str) and NUMBER_AS_TEXT.fullmatch(meant)
    return (float(meant), fault or faults.NUMBERS_AS_TEXT) if is_text else (meant, fault)


def unwrap_numbers(value: Any) -> tuple[Any, Fault | None]:
    """Return the list of numbers that was meant, and the first mistake in it."""
    meant, fault = unwrap(value)
    if not is_list(meant):
        return meant, fault
    numbers = [(each, None) if is_number(each) else unwrap_number(each) for each in meant]
    first = next((found for _, found in numbers if found is not None), None)
    return [number for number, _ in numbers], fault or first


def is_number_as_text(text: str) -> bool:
    """Whether a text is a number, also one in a printed tensor; a viewpoint id is neither."""
    return NUMBER_AS_TEXT.fullmatch(text) is not None or is_number(unwrap(text)[0])


def read_printed(text: str) -> Any:
    """Return what a printed tensor, array, list or byte string holds; None for other text."""
    text = text.strip()
    if not text.endswith((")", "]", ">", "'", '"')):
        return None  # nearly always
    if match := _QUOTED.fullmatch(text):
        return match["value"]
    match = _TENSORFLOWS.fullmatch(text) or _TENSOR.fullmatch(text)
    if match:
        text = match["value"]
        inner = read_printed(text)
        return _read_literal(text) if inner is None else inner
    return _read_literal(text) if text.startswith(("[", "(")) else None


def _read_literal(text: str) -> Any:
    """Return the number, the text or the list that Python or numpy prints so."""
    text = _POINT_WITHOUT_DIGITS.sub(".0", text.translate(_TO_JSON))
    for each in (text, _BETWEEN_NUMBERS.sub(", ", text)):
        try:
            value = json.loads(each)
        except (ValueError, RecursionError):
            continue
        return value if isinstance(value, str | list) or is_number(value) else None
    return None
