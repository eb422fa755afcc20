"""What reading found: problems, and what was read although it is not the official form."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

from reverie_eval.errors import Problem
from reverie_eval.geometry import FAR_OFF

Difference = Literal[
    "keyed",
    "prefixed",
    "hops",
    "long hops",
    "bare viewpoints",
    "no angles",
    "further numbers",
    "other key",
    "several answers",
    "text ids",
    "abstentions",
    "navigation only",
    "scaled boxes",
    "cut boxes",
    "boxes outside",
    "cameras off the grid",
    "far cameras",
]
"""How a file may differ from the official form and still say the same."""


PosePath = tuple[int, ...]
"""Where a viewpoint is in its trajectory: the element's number, and its own within the element."""


class Place(NamedTuple):
    """Where a record is in its file: ``[3]``, or ``["4774_267_1"]`` in a file keyed by id."""

    number: int
    key: str | None = None

    def __str__(self) -> str:
        return f"[{self.number}]" if self.key is None else f'["{self.key}"]'


@dataclass(frozen=True, slots=True)
class Findings:
    """Collected while a file is read."""

    problems: list[Problem] = field(default_factory=list)
    differences: Counter[Difference] = field(default_factory=Counter)

    def read_as(self) -> Sequence[str]:
        """Say what was read differently from the official form, a phrase each."""
        return [
            _WORDS[difference].format(self.differences[difference])
            for difference in get_args(Difference)
            if self.differences[difference]
        ]


_WORDS: dict[Difference, str] = {
    "keyed": "{:,} records keyed by their instr_id",
    "prefixed": '{:,} instr_ids with the prefix "reverie_"',
    "hops": "{:,} trajectories of nested hops",
    "long hops": "{:,} hops with more than one viewpoint, all of them walked",
    "bare viewpoints": "{:,} poses that are bare viewpoint ids",
    "no angles": "{:,} poses without heading and elevation",
    "further numbers": "{:,} poses with numbers behind heading and elevation, left aside",
    "other key": "{:,} answers under another key than predObjId",
    "several answers": "{:,} records whose answers differ from key to key, the first one taken",
    "text ids": "{:,} object ids written as text",
    "abstentions": "{:,} answers that name no object, not written as -1",
    "navigation only": "{:,} records, none with an answer: navigation only",
    "scaled boxes": "{:,} boxes scaled from another size of picture to 640 x 480",
    "cut boxes": "{:,} boxes that reach beyond the picture, cut to it",
    "boxes outside": "{:,} boxes that lie wholly outside the picture, which match nothing",
    "cameras off the grid": "{:,} boxes drawn by a camera that is none of the 36 views, carried "
    "over to the nearest view",
    "far cameras": f"{{:,}} of these carried over by more than {FAR_OFF:g} degrees, where exact "
    "boxes fail more often",
}
