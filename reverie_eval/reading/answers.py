"""Read which object an answer names, under any key and in any type that codebases write."""

from collections.abc import Mapping
from numbers import Integral
from typing import Any, NamedTuple

from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading import problems
from reverie_eval.reading.findings import Findings, Place

ANSWER_KEYS = ("predObjId", "pred_objid", "pred_obj_id")
"""The first that a record has is its answer: official, DUET, and an older spelling."""

LARGEST_OBJECT_ID = 2**31 - 1

_ABSTENTIONS = ("None", "-1", "")
"""What codebases write where the agent names no object, besides -1 and null."""


class Answer(NamedTuple):
    """The object that an agent names."""

    object_id: int
    """-1 where it names none."""
    is_text: bool = False
    """Whether the id is written as text, which one published evaluator never counts as right."""


def has_answer(record: Mapping[str, Any]) -> bool:
    """Whether a record has an answer under any key."""
    return any(key in record for key in ANSWER_KEYS)


def read_answer(place: Place, record: Mapping[str, Any], found: Findings) -> Answer:
    """Read a record's answer; what cannot be read is a problem and an abstention."""
    keys = [key for key in ANSWER_KEYS if key in record]
    if not keys:
        found.problems.append(problems.missing_field(place, ANSWER_KEYS[0]))
        return Answer(ABSTAINED)
    key, value = keys[0], record[keys[0]]
    found.differences["other key"] += key != ANSWER_KEYS[0]
    if len(keys) > 1:
        found.differences["several answers"] += len({_said(record[key]) for key in keys}) > 1
    if value is None or (isinstance(value, str) and value in _ABSTENTIONS):
        found.differences["abstentions"] += 1
        return Answer(ABSTAINED)
    is_text = isinstance(value, str) and value.isascii() and value.isdigit()
    if is_text and len(value) <= len(str(LARGEST_OBJECT_ID)):
        found.differences["text ids"] += 1
        value = int(value)
    if _is_object_id(value):
        return Answer(int(value), is_text)
    found.problems.append(problems.wrong_object(place, key, value))
    return Answer(ABSTAINED)


def _said(value: Any) -> str:
    """Return what an answer comes to, whatever its type."""
    return "None" if str(value) in _ABSTENTIONS else str(value)


def _is_object_id(value: Any) -> bool:
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    return is_whole and ABSTAINED <= value <= LARGEST_OBJECT_ID
