"""A split in numbers."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np
from pydantic import Field
from typing_extensions import Self

from reverie_eval.arrays import FloatArray, frozen

T = TypeVar("T")

_FREQUENT = 5
"""A word is frequent if it occurs at least so often in the instructions that are described.

The dataset's own training vocabulary uses the same limit: ``build_vocab(min_count=5)`` in
``tasks/REVERIE/utilsFast.py`` of its repository.
"""


@dataclass(frozen=True, slots=True)
class TargetFacts:
    """What the description uses of an item that has a target."""

    object_key: tuple[str, str, int]
    """Split, scan and object id."""
    category: str
    """The target's name; empty if no viewpoint lists it."""
    is_visible: bool
    """Whether the target is visible at the goal."""
    path_steps: int
    """Moves of the annotated path: one less than its viewpoints."""
    path_length: float
    """Metres of the annotated path along the navigation graph."""
    goal_objects: int
    """Objects that are visible at the goal."""
    goal_boxes: int
    """Boxes of these objects in all views of the goal."""


@dataclass(frozen=True, slots=True)
class ItemFacts:
    """What the description uses of an item."""

    scan: str
    words: Sequence[Sequence[str]]
    """The words of each instruction."""
    target: TargetFacts | None
    """None if the item has no target."""


@dataclass(frozen=True, eq=False)
class Distribution:
    """One quantity over many items or instructions; nothing is rounded."""

    mean: float
    median: float
    """The middle value; for an even number of values, the mean of the middle two."""
    minimum: float
    maximum: float
    counts: Mapping[int, int]
    """The number of values from each whole number up to, but not including, the next."""
    values: Annotated[FloatArray, Field(exclude=True)]
    """Shape (n,), n > 0; read-only."""

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Describe one or more values.

        >>> lengths = Distribution.of([2.0, 2.9, 5.0, 11.0])
        >>> lengths.mean, lengths.median, lengths.minimum, lengths.maximum
        (5.225, 3.95, 2.0, 11.0)
        >>> lengths.counts
        {2: 2, 5: 1, 11: 1}
        """
        array = frozen(np.fromiter(values, dtype=np.float64))
        return cls(
            mean=float(array.mean()),
            median=float(np.median(array)),
            minimum=float(array.min()),
            maximum=float(array.max()),
            counts=dict(sorted(Counter(np.floor(array).astype(int).tolist()).items())),
            values=array,
        )


@dataclass(frozen=True, eq=False)
class TargetDescription:
    """The items that have a target, in numbers."""

    items: int
    """Items that have a target."""
    hidden_targets: int
    """Items whose target is not visible at the goal."""
    target_objects: int
    """Distinct targets. For several splits it is the sum over them, as in the paper: its 4,140 are
    2,353 of train, 953 of val_seen and val_unseen, and 834 of test."""
    target_categories: int
    """Distinct categories of target objects."""
    category_counts: Mapping[str, int]
    """Target objects by category, the most frequent first; those without a name are left out."""
    path_steps: Distribution
    """Moves per annotated path."""
    path_length: Distribution
    """Metres per annotated path, along the navigation graph."""
    goal_objects: Distribution
    """Objects that are visible at the goal, per item."""
    goal_boxes: Distribution
    """Boxes of visible objects in all views of the goal, per item."""

    @classmethod
    def of(cls, facts: Sequence[TargetFacts]) -> Self:
        """Describe one or more items."""
        category = {each.object_key: each.category for each in facts}
        named = Counter(name for name in category.values() if name)
        return cls(
            items=len(facts),
            hidden_targets=sum(not each.is_visible for each in facts),
            target_objects=len(category),
            target_categories=len(named),
            category_counts=dict(sorted(named.items(), key=lambda item: (-item[1], item[0]))),
            path_steps=Distribution.of(each.path_steps for each in facts),
            path_length=Distribution.of(each.path_length for each in facts),
            goal_objects=Distribution.of(each.goal_objects for each in facts),
            goal_boxes=Distribution.of(each.goal_boxes for each in facts),
        )


@dataclass(frozen=True, eq=False)
class SplitDescription:
    """A split in numbers, or several taken together."""

    splits: Sequence[str]
    items: int
    instructions: int
    """Episodes: an item has one for each of its instructions."""
    scans: int
    """Buildings that the items are in."""
    viewpoints: int
    """Included viewpoints of these buildings."""
    words: Distribution
    """Words per instruction."""
    vocabulary: int
    """Distinct words, in lower case."""
    frequent_vocabulary: int
    """Distinct words that occur at least five times."""
    targets: TargetDescription | None
    """About the items that have a target; null if no item does."""

    @classmethod
    def of(
        cls, facts: Mapping[str, Sequence[ItemFacts]], viewpoint_counts: Mapping[str, int]
    ) -> Self:
        """Describe one split, or several together, each with at least one item.

        ``viewpoint_counts`` has the number of included viewpoints of each scan.
        """
        items = [item for split in facts.values() for item in split]
        instructions = [words for item in items for words in item.words]
        word_counts = Counter(word for words in instructions for word in words)
        scans = {item.scan for item in items}
        targets = [item.target for item in items if item.target]
        return cls(
            splits=list(facts),
            items=len(items),
            instructions=len(instructions),
            scans=len(scans),
            viewpoints=sum(viewpoint_counts[scan] for scan in scans),
            words=Distribution.of(len(words) for words in instructions),
            vocabulary=len(word_counts),
            frequent_vocabulary=sum(count >= _FREQUENT for count in word_counts.values()),
            targets=TargetDescription.of(targets) if targets else None,
        )


def of_targets(
    measure: Callable[[TargetDescription], T],
) -> Callable[[SplitDescription], T | None]:
    """Return a measure of targets as a measure of splits; None if no item has a target."""
    return lambda split: None if split.targets is None else measure(split.targets)
