"""Ids that are not in the ground truth: what many of them have in common."""

import re
from collections.abc import Callable, Container, Sequence
from typing import TypeAlias

from reverie_eval.ground_truth import GroundTruth
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._problems import Fault, RecordLocation
from reverie_eval.submissions._reading_log import ReadingLog

_Ids: TypeAlias = Sequence[str | None]

_Correction: TypeAlias = Callable[[str], str]
_Place: TypeAlias = Callable[[int], tuple[RecordLocation, str]]
"""Returns the record of an id, and where in it the id is."""

_PREFIX = re.compile(r"^(?:[A-Za-z][A-Za-z0-9]*[_-])+")
_INSTRUCTION = re.compile(r"\d{1,9}$")


def _counted_from_zero(instr_id: str) -> str:
    return _INSTRUCTION.sub(lambda index: str(int(index[0]) - 1), instr_id)


# Each cause with what the id would be without the mistake.
_INSTR_ID_CAUSES: Sequence[tuple[Fault, _Correction]] = (
    (problems.PADDED_IDS, str.strip),
    (problems.PREFIXED_IDS, lambda instr_id: _PREFIX.sub("", instr_id)),
    (problems.IDS_FROM_ONE, _counted_from_zero),
    (problems.IDS_OF_TASKS, lambda task_id: f"{task_id}_0"),
)
_VIEWPOINT_CAUSES: Sequence[tuple[Fault, _Correction]] = (
    (problems.PADDED_VIEWPOINTS, str.strip),
    (problems.VIEWPOINTS_WITH_SCANS, lambda named: named.rpartition("_")[2]),
)


def fix_instr_ids(ids: _Ids, ground_truth: GroundTruth, log: ReadingLog, place: _Place) -> _Ids:
    """Return the ids without the mistake that unknown ones have in common, and note it in the log.

    Ids stay as they are if no mistake explains at least half of the unknown ones.
    """
    return _fix(ids, ground_truth.episodes.index, _INSTR_ID_CAUSES, log, place)


def fix_viewpoint_ids(ids: _Ids, ground_truth: GroundTruth, log: ReadingLog, place: _Place) -> _Ids:
    """Find what unknown viewpoint ids have in common, as :func:`fix_instr_ids` does."""
    return _fix(ids, ground_truth.graph.index, _VIEWPOINT_CAUSES, log, place)


def _fix(
    ids: _Ids,
    known: Container[str],
    causes: Sequence[tuple[Fault, _Correction]],
    log: ReadingLog,
    place: _Place,
) -> _Ids:
    unknown = _count_unknown(ids, known)
    if not unknown:
        return ids
    for fault, correct in causes:
        # In a file whose instructions are counted from 1, most ids are known: of other episodes.
        is_right = known if fault is not problems.IDS_FROM_ONE else ()
        fixed = [each if each is None or each in is_right else correct(each) for each in ids]
        if 2 * _count_unknown(fixed, known) <= unknown:
            for row, (given, meant) in enumerate(zip(ids, fixed, strict=True)):
                if given != meant:
                    log.add_fault(fault, *place(row), given)
            return fixed
    return ids


def _count_unknown(ids: _Ids, known: Container[str]) -> int:
    return sum(each is not None and each not in known for each in ids)
