"""A whole dataset in numbers, beside those of the paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Self

from reverie_eval.description.paper import Comparison, compare_with_paper
from reverie_eval.description.part import Part
from reverie_eval.description.tasks import TaskFacts
from reverie_eval.wording import counted

if TYPE_CHECKING:
    from reverie_eval.schemas.description import DescriptionReport


@dataclass(frozen=True, eq=False, slots=True)
class DatasetDescription:
    """What a dataset is made of."""

    splits: Mapping[str, Part]
    """Each split by itself."""
    total: Part
    """All splits together."""
    buildings: int
    """Scans that have a navigation graph, whether tasks are in them or not."""
    viewpoints: int
    """Included viewpoints of these graphs: panoramas."""
    paper: Sequence[Comparison]
    """The paper's numbers, beside those here."""

    @classmethod
    def of(
        cls, facts: Mapping[str, Sequence[TaskFacts]], viewpoint_counts: Mapping[str, int]
    ) -> Self:
        """Describe a dataset.

        Parameters
        ----------
        facts : mapping
            The tasks of each split, of which there is at least one.
        viewpoint_counts : mapping
            How many included viewpoints each scan has.
        """

        @cache
        def together(splits: tuple[str, ...]) -> Part:
            return Part.of({split: facts[split] for split in splits}, viewpoint_counts)

        parts = {split: together((split,)) for split in facts}
        buildings, viewpoints = len(viewpoint_counts), sum(viewpoint_counts.values())
        return cls(
            splits=parts,
            total=together(tuple(facts)),
            buildings=buildings,
            viewpoints=viewpoints,
            paper=compare_with_paper(parts, together, buildings=buildings, viewpoints=viewpoints),
        )

    @property
    def notes(self) -> Sequence[str]:
        """What a reader of the numbers should know, a sentence each."""
        silent = [split for split, part in self.splits.items() if part.answers is None]
        return [
            *(f"{split} names no targets: its goals and paths are not known" for split in silent),
            *(
                f"{split}: the target is not visible at the goal in {hidden:,} of "
                f"{counted(part.tasks, 'task')}; `reverie-eval lint` names what is wrong"
                for split, part in self.splits.items()
                if part.answers and (hidden := part.answers.hidden_targets)
            ),
        ]

    def to_report(self) -> "DescriptionReport":
        """Return the description as the JSON of the command line."""
        from reverie_eval.schemas.description import DescriptionReport

        return DescriptionReport.model_validate(self)
