"""Read an answer: an object under any key and in any type that codebases write, or a box."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from reverie_eval.limits import LARGEST_OBJECT_ID
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading import problems
from reverie_eval.reading.boxes import BOX_KEY, BoxAnswer, read_box
from reverie_eval.reading.findings import Findings, Place
from reverie_eval.reading.trajectories import Pose
from reverie_eval.reading.values import is_whole

ANSWER_KEYS = ("predObjId", "pred_objid", "pred_obj_id")
"""The first that a record has names its object: official, DUET, and an older spelling."""

_ABSTENTIONS = ("None", "-1", "")
"""What codebases write where the agent names no object, besides -1 and null."""


class Answer(NamedTuple):
    """The object that an agent names, or the box that it draws."""

    object_id: int
    """-1 where it names none."""
    is_text: bool = False
    """Whether the id is written as text, which one published evaluator never counts as right."""
    box: BoxAnswer | None = None


def has_answer(record: Mapping[str, Any]) -> bool:
    """Whether a record has an answer under any key."""
    return any(key in record for key in (*ANSWER_KEYS, BOX_KEY))


def read_answer(
    place: Place, record: Mapping[str, Any], poses: Sequence[Pose] | None, found: Findings
) -> Answer:
    """Read a record's answer; what cannot be read is a problem and an abstention.

    ``poses`` is the record's trajectory; None where trajectories are not looked at.
    """
    keys = [key for key in ANSWER_KEYS if key in record]
    if record.get(BOX_KEY) is not None:
        for key in keys:
            if not _is_abstention(record[key]):
                found.problems.append(problems.two_answers(place, key, record[key]))
        return Answer(ABSTAINED, box=read_box(place, record, poses, found))
    if not keys and BOX_KEY in record:
        found.differences["abstentions"] += 1
        return Answer(ABSTAINED)
    if not keys:
        found.problems.append(problems.no_answer(place, ANSWER_KEYS[0], BOX_KEY))
        return Answer(ABSTAINED)
    key, value = keys[0], record[keys[0]]
    found.differences["other key"] += key != ANSWER_KEYS[0]
    if len(keys) > 1:
        found.differences["several answers"] += len({_said(record[key]) for key in keys}) > 1
    if _is_abstention(value):
        found.differences["abstentions"] += not is_whole(value)
        return Answer(ABSTAINED)
    is_text = isinstance(value, str) and value.isascii() and value.isdigit()
    if is_text and len(value) <= len(str(LARGEST_OBJECT_ID)):
        found.differences["text ids"] += 1
        value = int(value)
    if _is_object_id(value):
        return Answer(int(value), is_text)
    found.problems.append(problems.wrong_object(place, key, value))
    return Answer(ABSTAINED)


def _is_abstention(value: Any) -> bool:
    if is_whole(value):
        return value == ABSTAINED
    return value is None or (isinstance(value, str) and value in _ABSTENTIONS)


def _said(value: Any) -> str:
    """Return what an answer comes to, whatever its type."""
    return "None" if str(value) in _ABSTENTIONS else str(value)


def _is_object_id(value: Any) -> bool:
    return is_whole(value) and ABSTAINED <= value <= LARGEST_OBJECT_ID
