"""The fast lane: decode the plain official form straight into columns.

A submission takes this lane only if every record is exactly ``{"instr_id": text, "trajectory":
[[viewpoint, heading, elevation], ...], "predObjId": integer}``, with nothing missing, repeated or
added; in a task without target objects, there is no ``predObjId``. Nearly all files are, and
decoding them is ten times faster than reading value by value. Any other submission is declined here
and read by :mod:`reverie_eval.submissions._records`, which must give the same columns for the same
content: this lane never reports a problem of its own.
"""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import chain, repeat
from operator import itemgetter
from typing import Annotated, Any, ClassVar, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from reverie_eval.arrays import LARGEST_OBJECT_ID, FloatArray, IntArray, offsets_of
from reverie_eval.geometry import N_VIEWS
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions._predictions import (
    ID_PREFIX,
    IdColumn,
    Numbering,
    Predictions,
    Records,
    look_like_degrees,
)
from reverie_eval.submissions._trajectories import MAX_POSES

# The descriptions are those of the published JSON Schema.
_InstrId = Annotated[
    str,
    Meta(description="The episode: the task's id, an underscore, the instruction's index from 0."),
]
_Trajectory = Annotated[
    list[tuple[str, float, float]],
    Meta(
        min_length=1,
        description="The agent's poses from the episode's start to its stop: viewpoint id, heading "
        "and elevation in radians.",
    ),
]
_ObjectId = Annotated[
    int,
    Meta(
        ge=ABSTAINED,
        le=LARGEST_OBJECT_ID,
        description="The predicted object, by its id within the building; -1 for none.",
    ),
]
_Extent = Annotated[float, Meta(gt=0)]
_Side = Annotated[float, Meta(ge=1)]


# With gc=False the garbage collector does not walk through a hundred thousand tuples of poses.
class _Record(msgspec.Struct, gc=False, forbid_unknown_fields=True):
    instr_id: _InstrId
    trajectory: _Trajectory
    predObjId: _ObjectId  # noqa: N815  # the published name


class _NavigationRecord(msgspec.Struct, gc=False, forbid_unknown_fields=True):
    instr_id: _InstrId
    trajectory: _Trajectory
    predObjId: ClassVar[int] = ABSTAINED  # noqa: N815  # what a record without the field predicts


# The official form with all its options. It is never decoded into: answers by box take the careful
# lane, and this class exists for the JSON Schema.
class Prediction(msgspec.Struct):
    """What an agent did in one episode."""

    instr_id: _InstrId
    trajectory: _Trajectory
    predObjId: _ObjectId = ABSTAINED  # noqa: N815
    predBox: Annotated[  # noqa: N815
        tuple[float, float, _Extent, _Extent] | None,
        Meta(
            description="Instead of predObjId: left, top, width and height of a box around the "
            "target, in pixels."
        ),
    ] = None
    predView: Annotated[  # noqa: N815
        Annotated[int, Meta(ge=0, lt=N_VIEWS)] | None,
        Meta(
            description="The index of the view that predBox is in; without it, the camera of the "
            "last pose."
        ),
    ] = None
    predImageSize: Annotated[  # noqa: N815
        tuple[_Side, _Side] | None,
        Meta(description="Width and height of the image of predBox, if not 640 x 480."),
    ] = None


_LISTS = frozenset({list, tuple})
_NUMBERS = frozenset({float, int, np.float64, np.float32})
_INTEGERS = frozenset({int, np.int64, np.int32})

_decode = msgspec.json.Decoder(list[_Record]).decode
_decode_navigation = msgspec.json.Decoder(list[_NavigationRecord]).decode

_CHUNK = 1 << 16
"""Bytes that are decoded at once. The objects of so many stay in the processor's cache, and memory
is used again: the time for each episode and the memory do not grow with the file."""
_BETWEEN_RECORDS = re.compile(rb"\}[ \t\r\n]*,[ \t\r\n]*\{")


def decode_official(content: bytes, *, has_answers: bool = True) -> Predictions | None:
    """Read a file in the plain official form; return None if it has any other form."""
    fields = _fields(has_answers=has_answers)
    decode = _decode if has_answers else _decode_navigation
    numbering = Numbering()
    try:
        parts = [_read(decode(chunk), numbering) for chunk in _chunks(content)]
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    instr_ids = list(chain.from_iterable(part.instr_ids for part in parts))
    lengths = np.concatenate([part.lengths for part in parts])
    # One colon for each field. If there are more, a record may have a field twice, which msgspec
    # accepts silently. An id with a colon looks the same here; the careful lane tells them apart.
    if content.count(b":") != len(instr_ids) * len(fields):
        return None
    if _any_prefixed(instr_ids) or lengths.max(initial=0) > MAX_POSES:
        return None
    return Predictions(
        instr_ids=instr_ids,
        viewpoint_ids=IdColumn(
            list(numbering), np.concatenate([part.viewpoints for part in parts])
        ),
        offsets=offsets_of(lengths),
        predicted_object=np.concatenate([part.predicted_object for part in parts]),
        has_degrees=look_like_degrees(np.concatenate([part.stop_angles for part in parts])),
        answer_is_text=np.zeros(len(instr_ids), dtype=np.bool_),
        has_leading_zeros=np.zeros(len(instr_ids), dtype=np.bool_),
        is_navigation_only=not has_answers,
    )


class _Part(NamedTuple):
    """The columns of some records."""

    instr_ids: Sequence[str]
    lengths: IntArray
    """Shape (n_records,): poses of each trajectory."""
    viewpoints: IntArray
    """Shape (n_poses,): the number of each viewpoint id."""
    predicted_object: IntArray
    """Shape (n_records,)."""
    stop_angles: FloatArray
    """Shape (n_records, 2): heading and elevation of the last poses."""


def _chunks(content: bytes) -> Iterator[bytes]:
    """Cut a list of records into shorter lists.

    If all of them are lists of records, so is the whole. Where a cut is not between records after
    all, but in a text, the lists on either side of it are not JSON.
    """
    begin, opening = 0, b""
    while cut := _BETWEEN_RECORDS.search(content, begin + _CHUNK):
        yield opening + content[begin : cut.start() + 1] + b"]"
        begin, opening = cut.end() - 1, b"["
    yield opening + content[begin:]


def _read(records: Sequence[_Record | _NavigationRecord], numbering: Numbering) -> _Part:
    # C loops only, and no object outlives its chunk but for the ids of episodes.
    trajectories = [record.trajectory for record in records]
    stops = [trajectory[-1] for trajectory in trajectories]
    angles = chain.from_iterable(map(itemgetter(1, 2), stops))
    count = len(records)
    return _Part(
        instr_ids=[record.instr_id for record in records],
        lengths=np.fromiter(map(len, trajectories), np.int64, count),
        viewpoints=numbering.numbers(map(itemgetter(0), chain.from_iterable(trajectories))),
        predicted_object=np.fromiter((record.predObjId for record in records), np.int64, count),
        stop_angles=np.fromiter(angles, np.float64, 2 * count).reshape(-1, 2),
    )


def convert_official(submission: Records, *, has_answers: bool = True) -> Predictions | None:
    """Read Python objects in the plain official form; return None if they have any other form.

    Angles and object ids may be numpy numbers, which agents often produce.
    """
    fields = _fields(has_answers=has_answers)
    if not _is_plain(submission, fields):
        return None
    instr_ids, trajectories, *given = _columns(submission, fields)
    answers = given[0] if given else [ABSTAINED] * len(instr_ids)
    if _any_too_long(trajectories):
        return None
    viewpoint_ids, *angles = zip(*chain.from_iterable(trajectories), strict=True)
    try:
        angle = np.array(angles, dtype=np.float64).T
        predicted_object = np.array(answers, dtype=np.int64)
    except OverflowError:  # an integer that does not fit: the careful lane reports it
        return None
    is_object = (predicted_object >= ABSTAINED) & (predicted_object <= LARGEST_OBJECT_ID)
    if not (np.isfinite(angle).all() and is_object.all()) or _any_prefixed(instr_ids):
        return None
    offsets = offsets_of(np.fromiter(map(len, trajectories), np.int64, len(trajectories)))
    return Predictions(
        instr_ids=instr_ids,
        viewpoint_ids=IdColumn.of(viewpoint_ids),
        offsets=offsets,
        predicted_object=predicted_object,
        has_degrees=look_like_degrees(angle[offsets[1:] - 1]),
        answer_is_text=np.zeros(len(instr_ids), dtype=np.bool_),
        has_leading_zeros=np.zeros(len(instr_ids), dtype=np.bool_),
        is_navigation_only=not has_answers,
    )


def submission_schema() -> dict[str, Any]:
    """Return the JSON Schema of the official form."""
    schema: dict[str, Any] = msgspec.json.schema(list[Prediction])
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


def _fields(*, has_answers: bool) -> Sequence[str]:
    record = _Record if has_answers else _NavigationRecord
    return record.__struct_fields__


def _is_plain(submission: Any, fields: Sequence[str]) -> bool:
    """Whether everything has the official form, and exactly its types.

    Comparing sets of types takes C loops only. Subclasses do not pass, as they may behave in their
    own way; the careful lane reads them.
    """
    if not (submission and _have_types([submission], _LISTS) and _have_types(submission, {dict})):
        return False
    if any(record.keys() != set(fields) for record in submission):
        return False
    instr_ids, trajectories, *answers = _columns(submission, fields)
    if not (
        _have_types(instr_ids, {str})
        and _have_types(trajectories, _LISTS)
        and all(_have_types(each, _INTEGERS) for each in answers)
    ):
        return False
    poses = list(chain.from_iterable(trajectories))
    if not (all(trajectories) and _have_types(poses, _LISTS) and set(map(len, poses)) == {3}):
        return False
    viewpoint_ids, *angles = zip(*poses, strict=True)
    return _have_types(viewpoint_ids, {str}) and _have_types(chain(*angles), _NUMBERS)


def _columns(submission: Any, fields: Sequence[str]) -> Iterator[list[Any]]:
    return (list(map(itemgetter(field), submission)) for field in fields)


def _have_types(values: Iterable[object], types: Collection[type]) -> bool:
    return set(map(type, values)).issubset(types)


def _any_prefixed(instr_ids: Sequence[str]) -> bool:
    return any(map(str.startswith, instr_ids, repeat(ID_PREFIX)))


def _any_too_long(trajectories: Sequence[Sequence[object]]) -> bool:
    return max(map(len, trajectories), default=0) > MAX_POSES
