"""Ids that are not in the ground truth: what many of them have in common."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from itertools import permutations
from typing import NamedTuple, Protocol, TypeAlias

from reverie_eval.ground_truth import GroundTruth
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._problems import Fault, RecordLocation
from reverie_eval.submissions._reading_log import ReadingLog
from reverie_eval.submissions._values import unwrap

Ids: TypeAlias = Sequence[str | None]
Place: TypeAlias = Callable[[int], tuple[RecordLocation, str]]
"""Returns the record of an id, and where in it the id is."""


class Known(Protocol):
    """Ids that the ground truth has."""

    def __contains__(self, instr_id: object, /) -> bool: ...


_Correction: TypeAlias = Callable[[str, Known], str]
"""Returns what an id would be without a mistake, given the ids that are known."""

_MARK = re.compile(r"[^A-Za-z0-9]+")
"""What stands between the parts of an id."""
_INSTRUCTION = re.compile(r"\d{1,9}$")
_VIEWPOINT = re.compile(r"(?<![0-9a-f])[0-9a-f]{32}(?![0-9a-f])")
_DIGITS = re.compile(r"\d+")
_DECIMALS = re.compile(r"(\d+)(?:\.0+(?!\d))?")
_LONGEST = 60
"""Longer ids are not compared; Python refuses to convert thousands of digits."""
_MOST_PARTS = 3


class Corrected(NamedTuple):
    """Ids without the mistake that unknown ones have in common."""

    ids: Ids
    fault: Fault | None = None
    """None if no mistake explains at least half of the unknown ids."""

    def note(self, given: Ids, log: ReadingLog, place: Place) -> None:
        """Note the mistake of each id that was corrected."""
        if self.fault is not None:
            for row, (each, meant) in enumerate(zip(given, self.ids, strict=True)):
                if each != meant:
                    log.add_fault(self.fault, *place(row), each)


def _stripped(instr_id: str, _: Known) -> str:
    item, mark, start = instr_id.partition("#")
    return f"{item.strip()}{mark}{start}"


def _unprinted(instr_id: str, __: Known) -> str:
    item, mark, start = instr_id.partition("#")
    meant, _ = unwrap(item)
    text = int(meant) if isinstance(meant, float) and meant.is_integer() else meant
    return f"{text}{mark}{start}"


def _without_prefix(instr_id: str, known: Known) -> str:
    """Return an id without what is before a known one: NaviLLM's ``cvdn_0_1196`` is 1196 [1]_.

    References
    ----------
    .. [1] zd11024/NaviLLM a221f42, tasks/datasets/cvdn.py, load_data
    """
    ends = (instr_id[mark.end() :] for mark in _MARK.finditer(instr_id))
    return next((end for end in ends if end in known), instr_id)


def _without_suffix(instr_id: str, known: Known) -> str:
    item, mark, start = instr_id.partition("#")
    ends = [found.start() for found in _MARK.finditer(item)]
    cut = (f"{item[:end]}{mark}{start}" for end in reversed(ends))
    return next((each for each in cut if each in known), instr_id)


def _rewritten(instr_id: str, known: Known) -> str:
    """Return an id by its numbers: ``4774-267-1``, ``(4774, 267, 1)`` and ``4774_0267.0_1``."""
    item, mark, start = instr_id.partition("#")
    for pattern in (_DIGITS, _DECIMALS) if len(item) <= _LONGEST else ():
        rewritten = "_".join(str(int(number)) for number in pattern.findall(item))
        if f"{rewritten}{mark}{start}" in known:
            return f"{rewritten}{mark}{start}"
    return instr_id


def _reordered(order: Sequence[int], instr_id: str, _: Known) -> str:
    parts = instr_id.split("_")
    return "_".join(map(parts.__getitem__, order)) if len(parts) == len(order) else instr_id


def _counted_from_zero(instr_id: str, _: Known) -> str:
    return _INSTRUCTION.sub(lambda index: str(int(index[0]) - 1), instr_id)


def _without_scan(viewpoint_id: str, _: Known) -> str:
    return viewpoint_id.rpartition("_")[2]


def _bare_viewpoint(viewpoint_id: str, _: Known) -> str:
    """Return the one viewpoint id in a text such as ``4BC2...AB71`` or ``4bc2...ab71_12.jpg``."""
    found = _VIEWPOINT.findall(viewpoint_id.lower())
    return found[0] if len(found) == 1 else viewpoint_id


_INSTR_ID_CAUSES: Sequence[tuple[Fault, _Correction]] = (
    (problems.PADDED_IDS, _stripped),
    (problems.PRINTED_IDS, _unprinted),
    (problems.PREFIXED_IDS, _without_prefix),
    (problems.IDS_FROM_ONE, _counted_from_zero),
    *(
        (problems.REORDERED_IDS, partial(_reordered, order))
        for count in range(2, _MOST_PARTS + 1)
        for order in list(permutations(range(count)))[1:]
    ),
    (problems.SUFFIXED_IDS, _without_suffix),
    (problems.REWRITTEN_IDS, _rewritten),
)
_VIEWPOINT_CAUSES: Sequence[tuple[Fault, _Correction]] = (
    (problems.PADDED_VIEWPOINTS, _stripped),
    (problems.PRINTED_VIEWPOINTS, _unprinted),
    (problems.VIEWPOINTS_WITH_SCANS, _without_scan),
    (problems.SURROUNDED_VIEWPOINTS, _bare_viewpoint),
)


def is_viewpoint_id(text: str | None) -> bool:
    """Whether a text has the form of Matterport3D's viewpoint ids."""
    return text is not None and _VIEWPOINT.fullmatch(text) is not None


def correct_instr_ids(ids: Ids, known: Known) -> Corrected:
    """Return ids without the mistake that unknown ones have in common, if there is one.

    Different ids stay different: where they do not, the mistake is another one.
    """
    return _correct(ids, known, _INSTR_ID_CAUSES, count=len(set(ids)))


def fix_viewpoint_ids(ids: Ids, ground_truth: GroundTruth, log: ReadingLog, place: Place) -> Ids:
    """Return viewpoint ids without the mistake that unknown ones have in common, and note it."""
    corrected = _correct(ids, ground_truth.graph.index, _VIEWPOINT_CAUSES)
    corrected.note(ids, log, place)
    return corrected.ids


def _correct(
    ids: Ids, known: Known, causes: Sequence[tuple[Fault, _Correction]], count: int = 0
) -> Corrected:
    """Return ids without the first mistake that explains them, of which so many stay different."""
    unknown = count_unknown(ids, known)
    for fault, correct in causes if unknown else ():
        # In a file whose instructions are counted from 1, most ids are known: of other episodes.
        is_right = known if fault is not problems.IDS_FROM_ONE else ()
        fixed = [each if each is None or each in is_right else correct(each, known) for each in ids]
        if 2 * count_unknown(fixed, known) <= unknown and len(set(fixed)) >= count:
            return Corrected(fixed, fault)
    return Corrected(ids)


def count_unknown(ids: Ids, known: Known) -> int:
    """Return how many ids are not known."""
    return sum(each is not None and each not in known for each in ids)
