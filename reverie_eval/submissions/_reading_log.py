"""The problems, and the differences from the official form, that reading a submission finds."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from reverie_eval.errors import Problem
from reverie_eval.geometry import FAR_OFF
from reverie_eval.submissions._problems import WHOLE_FILE, Fault, RecordLocation

DIFFERENCES: Mapping[str, str] = MappingProxyType(
    {
        "keyed": "{:,} records keyed by their instr_id",
        "prefixed": '{:,} instr_ids with the prefix "reverie_"',
        "hops": "{:,} trajectories of nested hops",
        "long hops": "{:,} hops with more than one viewpoint, every viewpoint counted",
        "bare viewpoints": "{:,} poses that are bare viewpoint ids",
        "no angles": "{:,} poses without heading and elevation",
        "extra numbers": "{:,} poses with extra numbers after heading and elevation, ignored",
        "other key": "{:,} answers under a key other than predObjId",
        "text ids": "{:,} object ids written as text",
        "leading zeros": "{:,} of these with leading zeros, which no published evaluator counts "
        "as correct",
        "abstentions": "{:,} answers that predict no object, not written as -1",
        "null predObjId": "{:,} records with null under predObjId, beside an answer",
        "null pred_objid": "{:,} records with null under pred_objid, beside an answer",
        "null pred_obj_id": "{:,} records with null under pred_obj_id, beside an answer",
        "navigation only": "{:,} records, none with an answer: navigation only",
        "scaled boxes": "{:,} boxes scaled from another image size to 640 x 480",
        "upright images": "{:,} of these from images taller than wide; predImageSize is [width, "
        "height]",
        "cut boxes": "{:,} boxes that reach beyond the image, cut to it",
        "boxes outside": "{:,} boxes entirely outside the image, which match nothing",
        "cameras off the grid": "{:,} boxes from cameras that are not one of the 36 views, warped "
        "to the nearest view",
        "far cameras": f"{{:,}} of these warped by more than {FAR_OFF:g} degrees, where exact "
        "boxes fail more often",
        "single trajectories": "{:,} records with a single trajectory instead of a list",
        "listed angles": "{:,} angles in lists of one",
        "no point": "{:,} trajectories without a point",
    }
)
"""How a file may differ from the official form without changing its meaning, in the order in which
differences are listed; each text is formatted with its count."""


@dataclass(slots=True)
class _Occurrences:
    """Where a mistake that many records share is."""

    where: str
    row: int
    example: object
    rows: set[int] = field(default_factory=set)

    @property
    def count(self) -> int:
        """How many records have it."""
        return max(len(self.rows), 1)


@dataclass(frozen=True, slots=True)
class ReadingLog:
    """What is noted while a submission is read."""

    problems: list[Problem] = field(default_factory=list)
    """Problems of single records."""
    differences: Counter[str] = field(default_factory=Counter)
    """How often each key of ``DIFFERENCES`` occurs; also "empty hops", which are not listed."""
    ignored_fields: Counter[str] = field(default_factory=Counter)
    """How many records have each of the fields that are not read."""
    _faults: dict[Fault, _Occurrences] = field(default_factory=dict)

    def add_fault(self, fault: Fault, location: RecordLocation, path: str, example: object) -> None:
        """Note that a record has a mistake which others may share; only the first is shown."""
        occurrences = self._faults.get(fault)
        if occurrences is None:
            occurrences = _Occurrences(location.at(path), location.row, example)
            self._faults[fault] = occurrences
        occurrences.rows.add(location.row)

    def add_whole_file_fault(self, fault: Fault, example: object) -> None:
        """Note a mistake that the file as a whole has."""
        self._faults[fault] = _Occurrences(WHOLE_FILE, -1, example)

    def all_problems(self) -> Sequence[Problem]:
        """Return the problems of single records, and one for each mistake that records share."""
        faults = [
            fault.problem(found.count, found.where, (found.row,), found.example)
            for fault, found in self._faults.items()
        ]
        return [*self.problems, *faults]

    @property
    def unknown_fields(self) -> int:
        """At most how many different fields were found that the official form does not have."""
        return len(self.ignored_fields) + len(self._faults)

    @property
    def has_unfixable(self) -> bool:
        """Whether some mistake does not have a clear meaning."""
        return bool(self.problems) or not all(fault.convert for fault in self._faults)

    def fixed(self) -> Sequence[str]:
        """Return the mistakes whose meaning is clear, a phrase each."""
        return [
            fault.fixed(found.count, found.where, found.example)
            for fault, found in self._faults.items()
            if fault.convert
        ]

    def read_as(self) -> Sequence[str]:
        """Return the differences from the official form, a phrase each."""
        return [
            text.format(self.differences[key])
            for key, text in DIFFERENCES.items()
            if self.differences[key]
        ]
