"""The problems, and the differences from the official form, that reading a submission finds."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from reverie_eval.errors import Problem
from reverie_eval.geometry import FAR_OFF

DIFFERENCES: Mapping[str, str] = MappingProxyType(
    {
        "keyed": "{:,} records keyed by their instr_id",
        "prefixed": '{:,} instr_ids with the prefix "reverie_"',
        "hops": "{:,} trajectories of nested hops",
        "empty hops": "{:,} empty hops, skipped",
        "long hops": "{:,} hops with more than one viewpoint, every viewpoint counted",
        "bare viewpoints": "{:,} poses that are bare viewpoint ids",
        "no angles": "{:,} poses without heading and elevation",
        "extra numbers": "{:,} poses with extra numbers after heading and elevation, ignored",
        "other key": "{:,} answers under a key other than predObjId",
        "several answers": "{:,} records with different answers under several keys, the first "
        "one used",
        "text ids": "{:,} object ids written as text",
        "abstentions": "{:,} answers that predict no object, not written as -1",
        "navigation only": "{:,} records, none with an answer: navigation only",
        "scaled boxes": "{:,} boxes scaled from another image size to 640 x 480",
        "cut boxes": "{:,} boxes that reach beyond the image, cut to it",
        "boxes outside": "{:,} boxes entirely outside the image, which match nothing",
        "cameras off the grid": "{:,} boxes from cameras that are not one of the 36 views, warped "
        "to the nearest view",
        "far cameras": f"{{:,}} of these warped by more than {FAR_OFF:g} degrees, where exact "
        "boxes fail more often",
    }
)
"""How a file may differ from the official form without changing its meaning, in the order in which
differences are listed; each text is formatted with its count."""


@dataclass(frozen=True, slots=True)
class ReadingLog:
    """What is noted while a submission is read."""

    problems: list[Problem] = field(default_factory=list)
    differences: Counter[str] = field(default_factory=Counter)
    """How often each key of ``DIFFERENCES`` occurs."""
    unused_fields: Counter[str] = field(default_factory=Counter)
    """How many records have each of the fields that are not read."""

    def read_as(self) -> Sequence[str]:
        """Return the differences from the official form, a phrase each."""
        return [
            text.format(self.differences[key])
            for key, text in DIFFERENCES.items()
            if self.differences[key]
        ]
