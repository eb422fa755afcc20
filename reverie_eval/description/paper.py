"""The REVERIE paper's own numbers, beside the same numbers of the dataset that is described.

They are facts from section 3 of Qi et al., "REVERIE: Remote Embodied Visual Referring Expression in
Real Indoor Environments", CVPR 2020 (arXiv:1904.10151), in the order in which they are shown. The
paper does not say how it counts. The definitions here are those that come nearest to it on the
published files; ``docs/dataset-description.md`` has the evidence.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from reverie_eval.description.part import Answers, Part

Measure = Callable[[Part], float | None]
"""Takes a number from a part; None if it has none, for its tasks name no targets."""

_TRAIN, _VAL_UNSEEN, _TEST = ("train",), ("val_unseen",), ("test",)
_VAL = ("val_seen", "val_unseen")
_ALL = (*_TRAIN, *_VAL, *_TEST)


@dataclass(frozen=True, slots=True)
class Comparison:
    """A number of the paper beside the same number of the dataset that is described."""

    quantity: str
    splits: tuple[str, ...]
    """The splits that the paper's number covers; none if it is about the buildings."""
    covered: tuple[str, ...]
    """Those of them that the number here covers."""
    here: float | None
    """None if it covers none of them. A count is an int, and a mean is not."""
    paper: float


@dataclass(frozen=True, slots=True)
class _Published:
    """What the paper gives of one quantity, by the splits that each number covers."""

    quantity: str
    measure: Measure
    paper: Mapping[tuple[str, ...], float]


def _of_answers(measure: Callable[[Answers], float]) -> Measure:
    return lambda part: None if part.answers is None else measure(part.answers)


_PUBLISHED = (
    _Published(
        "instructions",
        lambda part: part.instructions,
        {_ALL: 21_702, _TRAIN: 10_466, _VAL: 4_944, _VAL_UNSEEN: 3_573, _TEST: 6_292},
    ),
    _Published("words per instruction", lambda part: part.words.mean, {_ALL: 18}),
    _Published("frequent words", lambda part: part.frequent_vocabulary, {_ALL: 1_600}),
    _Published(
        "scans", lambda part: part.scans, {_TRAIN: 59, _VAL: 63, _VAL_UNSEEN: 10, _TEST: 16}
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
    parts: Mapping[str, Part],
    together: Callable[[tuple[str, ...]], Part],
    *,
    buildings: int,
    viewpoints: int,
) -> Sequence[Comparison]:
    """Measure what the paper gives, as far as the splits are there.

    Parameters
    ----------
    parts : mapping
        The splits that are there, each by itself.
    together : callable
        Describes several of them as one part.
    buildings, viewpoints : int
        How many there are, whether tasks are in them or not.
    """
    return [
        Comparison("buildings", (), (), buildings, 90),
        Comparison("viewpoints", (), (), viewpoints, 10_567),
        *(
            _compare(published, splits, parts, together)
            for published in _PUBLISHED
            for splits in published.paper
        ),
    ]


def _compare(
    published: _Published,
    splits: tuple[str, ...],
    parts: Mapping[str, Part],
    together: Callable[[tuple[str, ...]], Part],
) -> Comparison:
    covered = tuple(
        split for split in splits if split in parts and published.measure(parts[split]) is not None
    )
    return Comparison(
        quantity=published.quantity,
        splits=splits,
        covered=covered,
        here=published.measure(together(covered)) if covered else None,
        paper=published.paper[splits],
    )
