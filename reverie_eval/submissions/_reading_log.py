"""What reading a submission found: problems, and differences from the official form."""

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
        "long hops": "{:,} hops with more than one viewpoint, all of them walked",
        "bare viewpoints": "{:,} poses that are bare viewpoint ids",
        "no angles": "{:,} poses without heading and elevation",
        "extra numbers": "{:,} poses with extra numbers after heading and elevation, ignored",
        "other key": "{:,} answers under another key than predObjId",
        "several answers": "{:,} records whose answers differ from key to key, the first one used",
        "text ids": "{:,} object ids written as text",
        "abstentions": "{:,} answers that predict no object, not written as -1",
        "navigation only": "{:,} records, none with an answer: navigation only",
        "scaled boxes": "{:,} boxes scaled from another image size to 640 x 480",
        "cut boxes": "{:,} boxes that reach beyond the image, cut to it",
        "boxes outside": "{:,} boxes wholly outside the image, which match nothing",
        "cameras off the grid": "{:,} boxes from cameras that are not one of the 36 views, warped "
        "to the nearest view",
        "far cameras": f"{{:,}} of these warped by more than {FAR_OFF:g} degrees, where exact "
        "boxes fail more often",
    }
)
"""How a file may differ from the official form and still mean the same, in the order of listing;
each is formatted with its count."""


@dataclass(frozen=True, slots=True)
class ReadingLog:
    """Filled while a submission is read."""

    problems: list[Problem] = field(default_factory=list)
    differences: Counter[str] = field(default_factory=Counter)
    """Counts by key of ``DIFFERENCES``."""
    unused_fields: Counter[str] = field(default_factory=Counter)
    """In how many records a field occurs that is not read."""

    def read_as(self) -> Sequence[str]:
        """Return the differences from the official form, one phrase each."""
        return [
            text.format(self.differences[key])
            for key, text in DIFFERENCES.items()
            if self.differences[key]
        ]
