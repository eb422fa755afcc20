"""The official result format, decoded straight into its types: the fast lane.

Takes a file only if every record is exactly ``{"instr_id": text, "trajectory": [[viewpoint,
heading, elevation], ...], "predObjId": integer}`` with nothing missing, repeated or added. What
it declines, :mod:`reverie_eval.reading.records` reads to the same result or explains.
"""

from itertools import chain
from operator import itemgetter
from typing import Annotated

import msgspec
import numpy as np

from reverie_eval.arrays import offsets_of
from reverie_eval.metrics import ABSTAINED
from reverie_eval.reading.answers import LARGEST_OBJECT_ID
from reverie_eval.reading.predictions import ID_PREFIX, Predictions


class _Record(msgspec.Struct, gc=False, forbid_unknown_fields=True):
    instr_id: str
    trajectory: Annotated[list[tuple[str, float, float]], msgspec.Meta(min_length=1)]
    predObjId: Annotated[int, msgspec.Meta(ge=ABSTAINED, le=LARGEST_OBJECT_ID)]  # noqa: N815


_decode = msgspec.json.Decoder(list[_Record]).decode


def decode_official(content: bytes) -> Predictions | None:
    """Read a file in the plain official form; None if it is anything else."""
    try:
        records = _decode(content)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    # A colon for every field: one more, and some record may hold a field twice.
    if content.count(b":") != len(records) * len(_Record.__struct_fields__):
        return None
    instr_ids = [record.instr_id for record in records]
    if any(instr_id.startswith(ID_PREFIX) for instr_id in instr_ids):
        return None
    trajectories = [record.trajectory for record in records]
    stops = [trajectory[-1] for trajectory in trajectories]
    return Predictions(
        instr_ids=instr_ids,
        viewpoint_ids=list(map(itemgetter(0), chain.from_iterable(trajectories))),
        offsets=offsets_of(np.fromiter(map(len, trajectories), np.int64, len(records))),
        stop_angles=np.array([stop[1:] for stop in stops], dtype=np.float64).reshape(-1, 2),
        predicted_object=np.array([record.predObjId for record in records], dtype=np.int64),
    )
