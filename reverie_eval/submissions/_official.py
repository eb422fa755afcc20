"""The fast lane: decode the plain official form, and what HAMT and DUET write, into columns.

A submission takes this lane only if every record is exactly ``{"instr_id": text, "trajectory":
[[viewpoint, heading, elevation], ...], "predObjId": integer}``, with nothing missing, repeated or
added. The integer may be text, as HAMT writes it, and the trajectory hops without angles,
``[[viewpoint], [viewpoint, viewpoint], ...]``, as DUET writes it. In a task without target objects,
there is no ``predObjId``. Nearly all files are like that, and decoding them is several times
faster than reading value by value. Any other submission is declined here and read by
:mod:`reverie_eval.submissions._records`, which must give the same columns for the same content:
this lane never reports a problem of its own.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Sized
from itertools import chain, repeat
from operator import itemgetter
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from reverie_eval.arrays import LARGEST_OBJECT_ID, BoolArray, FloatArray, IntArray, offsets_of
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._fields import is_number_as_text
from reverie_eval.submissions._predictions import (
    Numbering,
    Predictions,
    Records,
    Signs,
    look_like_degrees,
)
from reverie_eval.submissions._trajectories import MAX_POSES, have_types
from reverie_eval.tasks import ANSWER, ID_PREFIX, INSTR_ID, OBJECT, TRAJECTORY

_HOPS = Annotated[list[list[str]], Meta(min_length=1)]
# A pattern without leading zeros, and with as many digits as an id may have.
_OBJECT_AS_TEXT = Annotated[
    str, Meta(pattern=rf"^(0|[1-9][0-9]{{0,{len(str(LARGEST_OBJECT_ID)) - 1}}})\Z")
]
_LISTS = frozenset({list, tuple})
_NUMBERS = frozenset({float, int, np.float64, np.float32})
_INTEGERS = frozenset({int, np.int64, np.int32})

# Bytes that are decoded at once. The objects of so many stay in the processor's cache, and memory
# is used again: the time for each episode and the memory do not grow with the file.
_CHUNK = 1 << 16
_BETWEEN_RECORDS = re.compile(rb"\}[ \t\r\n]*,[ \t\r\n]*\{")


class _Part(NamedTuple):
    """The columns of some records."""

    instr_ids: Sequence[str]
    lengths: IntArray
    """Shape (n_records,): viewpoints of each trajectory."""
    viewpoints: IntArray
    """Shape (n_poses,): the number of each viewpoint id."""
    predicted_object: IntArray
    """Shape (n_records,)."""
    answer_is_text: BoolArray
    """Shape (n_records,)."""
    stop_angles: FloatArray
    """Shape (n_records, 2): heading and elevation of the last poses; NaN for hops."""
    n_hops: IntArray
    """Shape (n_records,): hops of each trajectory. For poses, shape (0,)."""
    hop_lengths: IntArray
    """Shape (n_hops,): viewpoints of each hop. For poses, shape (0,)."""


def decode_official(content: bytes, *, has_answers: bool = True) -> Predictions | None:
    """Read a file in one of the forms of this lane; return None if it has any other form."""
    for decode, read in _FORMS if has_answers else _NAVIGATION_FORMS:
        numbering = Numbering()
        try:
            parts = [read(decode(chunk), numbering) for chunk in _chunks(content)]
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            continue
        # The numbering is one for all chunks, so the numbers of viewpoints can simply be joined.
        whole = _Part(*map(_joined, zip(*parts, strict=True)))
        # One colon for each field. If there are more, a record may have a field twice, which
        # msgspec accepts silently. An id with a colon looks the same here; the careful lane tells
        # them apart.
        n_fields = len(whole.instr_ids) * len(_fields(has_answers=has_answers))
        is_read = content.count(b":") == n_fields and _is_faultless(whole, numbering)
        return _predictions(whole, numbering, has_answers=has_answers) if is_read else None
    return None


def _joined(columns: Sequence[Any]) -> Any:
    if isinstance(columns[0], np.ndarray):
        return np.concatenate(columns)
    return list(chain.from_iterable(columns))


def _is_faultless(part: _Part, numbering: Numbering) -> bool:
    """Whether the careful lane would find nothing to say that types do not express."""
    return not (
        _any_prefixed(part.instr_ids)
        or part.lengths.max(initial=0) > MAX_POSES
        or part.lengths.min(initial=1) == 0
        or part.predicted_object.max(initial=ABSTAINED) > LARGEST_OBJECT_ID  # written as text
        or (len(part.n_hops) and any(map(is_number_as_text, numbering)))
    )


def _predictions(part: _Part, numbering: Numbering, *, has_answers: bool) -> Predictions:
    log = ReadingLog()
    log.differences.update({"text ids": int(part.answer_is_text.sum())})
    locations = _locations(part, log) if len(part.n_hops) else {}
    return Predictions(
        instr_ids=part.instr_ids,
        viewpoint=part.viewpoints,
        distinct_ids=list(numbering),
        offsets=offsets_of(part.lengths),
        predicted_object=part.predicted_object,
        has_degrees=look_like_degrees(part.stop_angles),
        answer_is_text=part.answer_is_text,
        has_leading_zeros=np.zeros(len(part.instr_ids), dtype=np.bool_),
        is_navigation_only=not has_answers,
        read_as=log.read_as(),
        differences=log.differences,
        signs=_signs(part.predicted_object),
        **locations,
    )


def _signs(predicted_object: IntArray) -> Signs:
    return Signs(has_answers=bool((predicted_object != ABSTAINED).any()))


def _locations(part: _Part, log: ReadingLog) -> Mapping[str, Any]:
    """Return where each viewpoint is in its hop, and note how hops differ from poses."""
    first_hops = offsets_of(part.n_hops)[:-1]
    hops = np.arange(len(part.hop_lengths)) - np.repeat(first_hops, part.n_hops)
    first_poses = np.repeat(offsets_of(part.hop_lengths)[:-1], part.hop_lengths)
    steps = np.arange(len(part.viewpoints)) - first_poses
    are_other = part.hop_lengths != 1
    log.differences.update(
        {
            "hops": int(np.logical_or.reduceat(are_other, first_hops).sum()),
            "empty hops": int((part.hop_lengths == 0).sum()),
            "long hops": int((part.hop_lengths > 1).sum()),
            "no angles": len(part.viewpoints),
        }
    )
    locations = zip(np.repeat(hops, part.hop_lengths).tolist(), steps.tolist(), strict=True)
    return {"pose_locations": list(locations), "continues_hop": steps > 0}


def _chunks(content: bytes) -> Iterator[bytes]:
    """Cut a list of records into shorter lists.

    If all of them are lists of records, so is the whole. Where a cut is not between records after
    all, but in a text, the lists on either side of it are not JSON.
    """
    begin, opening = 0, b""
    while cut := _BETWEEN_RECORDS.search(content, begin + _CHUNK):
        # The cut is between two braces: the list is closed behind the first and opened before the
        # second.
        yield opening + content[begin : cut.start() + 1] + b"]"
        begin, opening = cut.end() - 1, b"["
    yield opening + content[begin:]


# In the two functions below are C loops only, and no object outlives its chunk but for the ids of
# episodes.


def _read_poses(records: Sequence[Any], numbering: Numbering) -> _Part:
    trajectories = [record.trajectory for record in records]
    stops = [trajectory[-1] for trajectory in trajectories]
    angles = chain.from_iterable(map(itemgetter(1, 2), stops))
    return _Part(
        instr_ids=[record.instr_id for record in records],
        lengths=_lengths(trajectories),
        viewpoints=numbering.numbers(map(itemgetter(0), chain.from_iterable(trajectories))),
        **_answers(records),
        stop_angles=np.fromiter(angles, np.float64, 2 * len(records)).reshape(-1, 2),
        n_hops=_lengths([]),
        hop_lengths=_lengths([]),
    )


def _read_hops(records: Sequence[Any], numbering: Numbering) -> _Part:
    trajectories = [record.trajectory for record in records]
    hops = list(chain.from_iterable(trajectories))
    n_hops, hop_lengths = _lengths(trajectories), _lengths(hops)
    return _Part(
        instr_ids=[record.instr_id for record in records],
        # Every trajectory has a hop, as its type says, so reduceat meets no empty row.
        lengths=np.add.reduceat(hop_lengths, offsets_of(n_hops)[:-1]),
        viewpoints=numbering.numbers(chain.from_iterable(hops)),
        **_answers(records),
        stop_angles=np.full((len(records), 2), np.nan),
        n_hops=n_hops,
        hop_lengths=hop_lengths,
    )


def _lengths(values: Sequence[Sized]) -> IntArray:
    return np.fromiter(map(len, values), np.int64, len(values))


def _answers(records: Sequence[Any]) -> Mapping[str, Any]:
    answers = [record.predObjId for record in records]
    return {
        "predicted_object": np.fromiter(map(int, answers), np.int64, len(answers)),
        "answer_is_text": np.fromiter(
            map(isinstance, answers, repeat(str)), np.bool_, len(answers)
        ),
    }


def _decoder(trajectory: Any, *, has_answers: bool) -> Callable[[bytes], list[Any]]:
    """Return the decoder of records with such trajectories."""
    fields = [(INSTR_ID.name, INSTR_ID.type), (TRAJECTORY.name, trajectory)]
    if has_answers:
        fields.append((OBJECT.name, OBJECT.type | _OBJECT_AS_TEXT))
    # With gc=False the garbage collector does not walk through a hundred thousand tuples of poses.
    record = msgspec.defstruct(
        "Record",
        fields,
        namespace={} if has_answers else {OBJECT.name: OBJECT.default},
        gc=False,
        forbid_unknown_fields=True,
    )
    return msgspec.json.Decoder(list[record]).decode  # type: ignore[valid-type]


_FORMS, _NAVIGATION_FORMS = (
    (
        (_decoder(TRAJECTORY.type, has_answers=has_answers), _read_poses),
        (_decoder(_HOPS, has_answers=has_answers), _read_hops),
    )
    for has_answers in (True, False)
)


def convert_official(submission: Records, *, has_answers: bool = True) -> Predictions | None:
    """Read Python objects in the plain official form; return None if they have any other form.

    Angles and object ids may be numpy numbers, which agents often produce.
    """
    plain = _plain_columns(submission, _fields(has_answers=has_answers))
    if plain is None:
        return None
    instr_ids, trajectories, viewpoint_ids, angles, given = plain
    answers = given[0] if given else [ABSTAINED] * len(instr_ids)
    if max(map(len, trajectories)) > MAX_POSES:
        return None
    try:
        angle = np.array(angles, dtype=np.float64).T
        predicted_object = np.array(answers, dtype=np.int64)
    except OverflowError:  # an integer that does not fit: the careful lane reports it
        return None
    is_object = (predicted_object >= ABSTAINED) & (predicted_object <= LARGEST_OBJECT_ID)
    if not (np.isfinite(angle).all() and is_object.all()) or _any_prefixed(instr_ids):
        return None
    offsets = offsets_of(_lengths(trajectories))
    return Predictions(
        instr_ids=instr_ids,
        **Numbering.columns(viewpoint_ids),
        offsets=offsets,
        predicted_object=predicted_object,
        has_degrees=look_like_degrees(angle[offsets[1:] - 1]),
        # Integers alone come this far: text takes the careful lane.
        answer_is_text=np.zeros(len(instr_ids), dtype=np.bool_),
        has_leading_zeros=np.zeros(len(instr_ids), dtype=np.bool_),
        is_navigation_only=not has_answers,
        signs=_signs(predicted_object),
    )


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


def _fields(*, has_answers: bool) -> Sequence[str]:
    fields = (INSTR_ID, TRAJECTORY, OBJECT) if has_answers else (INSTR_ID, TRAJECTORY)
    return [field.name for field in fields]


def _plain_columns(submission: Any, fields: Sequence[str]) -> Sequence[Sequence[Any]] | None:
    """Return ids, trajectories, viewpoint ids, angles and answers, if all have exactly their types.

    Comparing sets of types takes C loops only. Subclasses do not pass, as they may behave in their
    own way; the careful lane reads them.
    """
    if not (submission and have_types([submission], _LISTS) and have_types(submission, {dict})):
        return None
    # Keys in another order are equal, and a missing or further one is not.
    if any(record.keys() != set(fields) for record in submission):
        return None
    columns = (list(map(itemgetter(field), submission)) for field in fields)
    instr_ids, trajectories, *answers = columns
    if not (
        have_types(instr_ids, {str})
        and have_types(trajectories, _LISTS)
        and all(have_types(each, _INTEGERS) for each in answers)
    ):
        return None
    poses = list(chain.from_iterable(trajectories))
    if not (all(trajectories) and have_types(poses, _LISTS) and set(map(len, poses)) == {3}):
        return None
    viewpoint_ids, *angles = zip(*poses, strict=True)
    if not (have_types(viewpoint_ids, {str}) and have_types(chain(*angles), _NUMBERS)):
        return None
    return instr_ids, trajectories, viewpoint_ids, angles, answers


def _any_prefixed(instr_ids: Sequence[str]) -> bool:
    return any(map(str.startswith, instr_ids, repeat(ID_PREFIX)))
