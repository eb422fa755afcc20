"""Compare a dataset with the numbers in the REVERIE paper.

The numbers are from section 3 of Qi et al., "REVERIE: Remote Embodied Visual Referring Expression
in Real Indoor Environments", CVPR 2020 (arXiv:1904.10151), in the order in which they are shown.
The paper does not say how it counts. The definitions used here come closest to its numbers on the
published files; ``docs/how-to/describe-a-dataset.md`` has the evidence.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from reverie_eval.dataset._description import SplitDescription, of_targets

Measure = Callable[[SplitDescription], float | None]
"""Returns one number of a description; None if the items have no targets."""

_TRAIN, _VAL_UNSEEN, _TEST = ("train",), ("val_unseen",), ("test",)
_VAL = ("val_seen", "val_unseen")
_ALL = (*_TRAIN, *_VAL, *_TEST)


@dataclass(frozen=True, slots=True)
class PaperComparison:
    """A number of the paper, and the same number of the dataset that is described."""

    quantity: str
    splits: Sequence[str]
    """The splits that the paper's number covers; empty if it is about the buildings."""
    covered: Sequence[str]
    """Those of them that the dataset's number covers; the two compare only if it covers all."""
    here: int | float | None
    """The dataset's number; null if it covers none of the splits."""
    paper: int | float


_PUBLISHED: Sequence[tuple[str, Measure, Mapping[tuple[str, ...], float]]] = (
    (
        "instructions",
        lambda split: split.instructions,
        {_ALL: 21_702, _TRAIN: 10_466, _VAL: 4_944, _VAL_UNSEEN: 3_573, _TEST: 6_292},
    ),
    ("words per instruction", lambda split: split.words.mean, {_ALL: 18}),
    ("frequent words", lambda split: split.frequent_vocabulary, {_ALL: 1_600}),
    ("scans", lambda split: split.scans, {_TRAIN: 59, _VAL: 63, _VAL_UNSEEN: 10, _TEST: 16}),
    (
        "target objects",
        of_targets(lambda targets: targets.target_objects),
        {_ALL: 4_140, _TRAIN: 2_353, _VAL: 953, _VAL_UNSEEN: 525, _TEST: 834},
    ),
    ("target categories", of_targets(lambda targets: targets.target_categories), {_ALL: 489}),
    ("objects at the goal", of_targets(lambda targets: targets.goal_objects.mean), {_ALL: 7}),
    ("boxes at the goal", of_targets(lambda targets: targets.goal_boxes.mean), {_ALL: 50}),
)
"""The paper's numbers for each quantity, by the splits that each covers."""


def compare_with_paper(
    alone: Mapping[str, SplitDescription],
    describe: Callable[[tuple[str, ...]], SplitDescription],
    *,
    buildings: int,
    viewpoints: int,
) -> Sequence[PaperComparison]:
    """Compare the dataset with the paper, as far as it has the splits.

    ``alone`` has the description of each split; ``describe`` describes several of them as one.
    """
    comparisons = [
        PaperComparison("buildings", (), (), buildings, 90),
        PaperComparison("viewpoints", (), (), viewpoints, 10_567),
    ]
    for quantity, measure, paper in _PUBLISHED:
        for splits, number in paper.items():
            covered = tuple(
                split for split in splits if split in alone and measure(alone[split]) is not None
            )
            here = measure(describe(covered)) if covered else None
            comparisons.append(PaperComparison(quantity, splits, covered, here, number))
    return comparisons
