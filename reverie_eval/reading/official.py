"""The official result format, taken straight into its types: the fast lane.

Takes a submission only if every record is exactly ``{"instr_id": text, "trajectory": [[viewpoint,
heading, elevation], ...], "predObjId": integer}`` with nothing missing, repeated or added. What
it declines, :mod:`reverie_eval.reading.records` reads to the same result or explains.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import chain
from operator import itemgetter
from typing import Annotated, Any

import msgspec
import numpy as np

from reverie_eval.arrays import offsets_of
from reverie_eval.limits import LARGEST_OBJECT_ID
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading.predictions import ID_PREFIX, Predictions, Records
from reverie_eval.reading.trajectories import MAX_POSES


class _Record(msgspec.Struct, gc=False, forbid_unknown_fields=True):
    instr_id: str
    trajectory: Annotated[list[tuple[str, float, float]], msgspec.Meta(min_length=1)]
    predObjId: Annotated[int, msgspec.Meta(ge=ABSTAINED, le=LARGEST_OBJECT_ID)]  # noqa: N815


_FIELDS = _Record.__struct_fields__
_KEYS = frozenset(_FIELDS)
_LISTS = frozenset({list, tuple})
_NUMBERS = frozenset({float, int, np.float64, np.float32})
_WHOLE = frozenset({int, np.int64, np.int32})

_decode = msgspec.json.Decoder(list[_Record]).decode


def decode_official(content: bytes) -> Predictions | None:
    """Read a file in the plain official form; None if it is anything else."""
    try:
        records = _decode(content)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    # A colon for every field: one more, and some record may hold a field twice.
    if content.count(b":") != len(records) * len(_FIELDS):
        return None
    return _predictions(records)


def convert_official(submission: Records) -> Predictions | None:
    """Take Python objects in the plain official form; None if they are anything else.

    Angles and object ids may be numpy's, as agents have them.
    """
    if not _is_plain(submission):
        return None
    instr_ids, trajectories, answers = _columns(submission)
    if _have_endless(trajectories):
        return None
    viewpoint_ids, *angles = zip(*chain.from_iterable(trajectories), strict=True)
    try:
        angle = np.array(angles, dtype=np.float64).T
        predicted_object = np.array(answers, dtype=np.int64)
    except OverflowError:
        return None
    is_object = (predicted_object >= ABSTAINED) & (predicted_object <= LARGEST_OBJECT_ID)
    if not (np.isfinite(angle).all() and is_object.all()) or _have_prefixes(instr_ids):
        return None
    offsets = offsets_of(np.fromiter(map(len, trajectories), np.int64, len(trajectories)))
    return Predictions(
        instr_ids=instr_ids,
        viewpoint_ids=list(viewpoint_ids),
        offsets=offsets,
        stop_angles=angle[offsets[1:] - 1],
        predicted_object=predicted_object,
    )


def _is_plain(submission: Any) -> bool:
    """Whether all is of the official form and its very types: a subclass may mean another thing."""
    if not (submission and _are([submission], _LISTS) and _are(submission, {dict})):
        return False
    if any(record.keys() != _KEYS for record in submission):
        return False
    instr_ids, trajectories, answers = _columns(submission)
    if not (_are(instr_ids, {str}) and _are(trajectories, _LISTS) and _are(answers, _WHOLE)):
        return False
    poses = list(chain.from_iterable(trajectories))
    if not (all(trajectories) and _are(poses, _LISTS) and set(map(len, poses)) == {3}):
        return False
    viewpoint_ids, *angles = zip(*poses, strict=True)
    return _are(viewpoint_ids, {str}) and _are(chain(*angles), _NUMBERS)


def _columns(submission: Any) -> Iterator[list[Any]]:
    return (list(map(itemgetter(field), submission)) for field in _FIELDS)


def _are(values: Iterable[object], types: Collection[type]) -> bool:
    return set(map(type, values)).issubset(types)


def _have_prefixes(instr_ids: Sequence[str]) -> bool:
    return any(instr_id.startswith(ID_PREFIX) for instr_id in instr_ids)


def _have_endless(trajectories: Sequence[Sequence[object]]) -> bool:
    return max(map(len, trajectories), default=0) > MAX_POSES


def _predictions(records: list[_Record]) -> Predictions | None:
    instr_ids = [record.instr_id for record in records]
    if _have_prefixes(instr_ids):
        return None
    trajectories = [record.trajectory for record in records]
    if _have_endless(trajectories):
        return None
    stops = [trajectory[-1] for trajectory in trajectories]
    return Predictions(
        instr_ids=instr_ids,
        viewpoint_ids=list(map(itemgetter(0), chain.from_iterable(trajectories))),
        offsets=offsets_of(np.fromiter(map(len, trajectories), np.int64, len(records))),
        stop_angles=np.array([stop[1:] for stop in stops], dtype=np.float64).reshape(-1, 2),
        predicted_object=np.array([record.predObjId for record in records], dtype=np.int64),
    )
