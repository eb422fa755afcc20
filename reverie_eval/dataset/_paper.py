"""The REVERIE paper's own numbers, beside those of the dataset that is described.

They are facts from section 3 of Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in
Real Indoor Environments", CVPR 2020 (arXiv:1904.10151), in the order in which they are shown. The
paper does not say how it counts. The definitions here are those that come nearest to it on the
published files; ``docs/dataset-description.md`` has the evidence.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from reverie_eval.dataset._description import AnswerDescription, SplitDescription

Measure = Callable[[SplitDescription], float | None]
"""Takes a number from splits; None if their tasks have no targets."""

_TRAIN, _VAL_UNSEEN, _TEST = ("train",), ("val_unseen",), ("test",)
_VAL = ("val_seen", "val_unseen")
_ALL = (*_TRAIN, *_VAL, *_TEST)


@dataclass(frozen=True, slots=True)
class PaperComparison:
    """A number of the paper beside the same number of the dataset that is described."""

    quantity: str
    splits: Sequence[str]
    """The splits that the paper's number covers; none if it is about the buildings."""
    covered: Sequence[str]
    """Those of them that the number here covers; only if all do, the two compare."""
    here: int | float | None
    """Null if it covers none of them."""
    paper: int | float


@dataclass(frozen=True, slots=True)
class _Published:
    """What the paper gives of one quantity, by the splits that each number covers."""

    quantity: str
    measure: Measure
    paper: Mapping[tuple[str, ...], float]


def _of_answers(measure: Callable[[AnswerDescription], float]) -> Measure:
    return lambda splits: None if splits.answers is None else measure(splits.answers)


_PUBLISHED = (
    _Published(
        "instructions",
        lambda splits: splits.instructions,
        {_ALL: 21_702, _TRAIN: 10_466, _VAL: 4_944, _VAL_UNSEEN: 3_573, _TEST: 6_292},
    ),
    _Published("words per instruction", lambda splits: splits.words.mean, {_ALL: 18}),
    _Published("frequent words", lambda splits: splits.frequent_vocabulary, {_ALL: 1_600}),
    _Published(
        "scans", lambda splits: splits.scans, {_TRAIN: 59, _VAL: 63, _VAL_UNSEEN: 10, _TEST: 16}
    ),
    _Published(
        "target objects",
        _of_answers(lambda answers: answers.target_objects),
        {_ALL: 4_140, _TRAIN: 2_353, _VAL: 953, _VAL_UNSEEN: 525, _TEST: 834},
    ),
    _Published(
        "target categories", _of_answers(lambda answers: answers.target_categories), {_ALL: 489}
    ),
    _Published(
        "objects at the goal", _of_answers(lambda answers: answers.goal_objects.mean), {_ALL: 7}
    ),
    _Published(
        "boxes at the goal", _of_answers(lambda answers: answers.goal_boxes.mean), {_ALL: 50}
    ),
)


def compare_with_paper(
    alone: Mapping[str, SplitDescription],
    together: Callable[[tuple[str, ...]], SplitDescription],
    *,
    buildings: int,
    viewpoints: int,
) -> Sequence[PaperComparison]:
    """Measure what the paper gives, as far as the splits are there.

    Parameters
    ----------
    parts : mapping
        The splits that are there, each by itself.
    together : callable
        Describes several of them as one splits.
    buildings, viewpoints : int
        How many there are, whether tasks are in them or not.
    """
    return [
        PaperComparison("buildings", (), (), buildings, 90),
        PaperComparison("viewpoints", (), (), viewpoints, 10_567),
        *(
            _compare(published, splits, alone, together)
            for published in _PUBLISHED
            for splits in published.paper
        ),
    ]


def _compare(
    published: _Published,
    splits: tuple[str, ...],
    alone: Mapping[str, SplitDescription],
    together: Callable[[tuple[str, ...]], SplitDescription],
) -> PaperComparison:
    covered = tuple(
        split for split in splits if split in alone and published.measure(alone[split]) is not None
    )
    return PaperComparison(
        quantity=published.quantity,
        splits=splits,
        covered=covered,
        here=published.measure(together(covered)) if covered else None,
        paper=published.paper[splits],
    )
