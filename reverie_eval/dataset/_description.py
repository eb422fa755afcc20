"""What a dataset contains, in numbers, beside those in the REVERIE paper.

The paper's numbers are from section 3 of Qi et al., "REVERIE: Remote Embodied Visual Referring
Expression in Real Indoor Environments", CVPR 2020 (arXiv:1904.10151), in the order in which they
are shown. The paper does not say how it counts. The definitions used here come closest to its
numbers on the published files; ``docs/how-to/describe-a-dataset.md`` has the evidence.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import ConfigDict, Field
from typing_extensions import Self

from reverie_eval.arrays import FloatArray, frozen
from reverie_eval.dataset._boxes import Boxes
from reverie_eval.dataset._dataset import DatasetFiles, Split, read_dataset
from reverie_eval.dataset._lint import check_sound
from reverie_eval.dataset._reader import viewpoints_of
from reverie_eval.ground_truth import NavigationGraph
from reverie_eval.processes import Progress, no_progress
from reverie_eval.tasks import DEFAULT_TASK
from reverie_eval.text import category_text, count_text, tokenize
from reverie_eval.version import __version__

T = TypeVar("T")

# A word is frequent if it occurs at least so often in the instructions that are described.
#
# The dataset's own training vocabulary uses the same limit: `build_vocab(min_count=5)` in
# `tasks/REVERIE/utilsFast.py` of its repository.
_FREQUENT = 5


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
        # By object, not by item: several items may have one target.
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


# The paper's numbers.


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
    """The splits that the dataset's number covers; the paper's compares with it only if these are
    all."""
    here: int | float | None
    """The dataset's number; null if it covers none of the splits."""
    paper: int | float


# The paper's numbers for each quantity, by the splits that each covers.
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


def _compare_with_paper(
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


# A dataset.


@dataclass(frozen=True, eq=False)
class DatasetDescription:
    """What a dataset contains, for REVERIE compared with the numbers in its paper."""

    __pydantic_config__: ClassVar = ConfigDict(
        use_attribute_docstrings=True, extra="forbid", arbitrary_types_allowed=True
    )

    splits: Mapping[str, SplitDescription]
    """Each split by itself."""
    total: SplitDescription
    """All splits together."""
    buildings: int
    """Scans that have a navigation graph, with or without items."""
    viewpoints: int
    """Included viewpoints of these graphs: panoramas."""
    paper: Sequence[PaperComparison]
    """The paper's numbers and those of this dataset; only for REVERIE."""
    notes: Sequence[str] = ()
    """What readers of the numbers should know, a sentence each."""
    schema_version: Literal[1] = 1
    version: str = __version__
    """Version of reverie-eval that described it."""


def describe_dataset(
    files: DatasetFiles, *, progress: Progress = no_progress
) -> DatasetDescription:
    """Describe the splits of a dataset.

    A target that is not visible at its goal is counted and noted, but is not an error: the
    published train split has one.

    Parameters
    ----------
    files : DatasetFiles
        Where the published files are.
    progress : callable, optional
        Shows progress; called with the files about to be read, a description and their number.

    Raises
    ------
    DatasetError
        Listing all other problems that ``reverie-eval lint`` calls errors.
    """
    dataset = read_dataset(files, progress)
    check_sound(dataset, "describe")
    graph, boxes, task = dataset.graphs.ground_truth(), dataset.boxes, files.task
    facts = {split.name: list(_item_facts(split, graph, boxes)) for split in dataset.splits}
    viewpoint_counts = {
        scan_id: len(scan.viewpoint_ids) for scan_id, scan in dataset.graphs.scans.items()
    }

    # The paper gives several numbers for the same groups of splits.
    @cache
    def describe(splits: tuple[str, ...]) -> SplitDescription:
        return SplitDescription.of({split: facts[split] for split in splits}, viewpoint_counts)

    # The splits that were found; the paper's numbers are compared as far as these go.
    alone = {split: describe((split,)) for split in facts}
    buildings, viewpoints = len(viewpoint_counts), sum(viewpoint_counts.values())
    paper: Sequence[PaperComparison] = ()
    if task.name == DEFAULT_TASK:
        paper = _compare_with_paper(alone, describe, buildings=buildings, viewpoints=viewpoints)
    return DatasetDescription(
        splits=alone,
        total=describe(tuple(facts)),
        buildings=buildings,
        viewpoints=viewpoints,
        paper=paper,
        notes=_notes(alone) if task.has_targets else (),
    )


def _notes(splits: Mapping[str, SplitDescription]) -> Sequence[str]:
    without = [name for name, split in splits.items() if split.targets is None]
    return [
        *(f"{name} has no targets: its goals and paths are unknown" for name in without),
        *(
            f"{name}: the target is not visible at the goal in {hidden:,} of "
            f"{count_text(split.items, 'item')}; `reverie-eval lint` lists them"
            for name, split in splits.items()
            if split.targets and (hidden := split.targets.hidden_targets)
        ),
    ]


def _item_facts(split: Split, graph: NavigationGraph, boxes: Boxes) -> Iterator[ItemFacts]:
    """Yield what each item adds to the description of its split."""
    # The same object is listed at several viewpoints; annotated targets have the scan and the id
    # alone.
    names = {
        (boxes.viewpoints[viewpoint].scan_id, object_id): category_text(record.name)
        for viewpoint, object_id, record in boxes.entries
    }
    size = len(boxes.viewpoints)
    n_objects = np.bincount(boxes.viewpoint[boxes.is_visible], minlength=size).tolist()
    n_boxes = np.bincount(boxes.viewpoint[boxes.box_entry], minlength=size).tolist()
    visible_at = dict(zip(boxes.viewpoints, zip(n_objects, n_boxes, strict=True), strict=True))
    for item in split.items:
        target = None
        if item.target is not None:
            goal = viewpoints_of(item)[-1]
            entry = boxes.entry_at.get((goal, item.target))
            # DUET's single file leaves out viewpoints without objects.
            goal_objects, goal_boxes = visible_at.get(goal, (0, 0))
            path = np.array([graph.index[viewpoint_id] for viewpoint_id in item.reference])
            target = TargetFacts(
                object_key=(split.name, item.scan, item.target),
                category=names.get((item.scan, item.target), ""),
                is_visible=entry is not None and bool(boxes.is_visible[entry]),
                path_steps=len(item.reference) - 1,
                path_length=float(graph.distance_between(path[:-1], path[1:]).sum()),
                goal_objects=goal_objects,
                goal_boxes=goal_boxes,
            )
        yield ItemFacts(item.scan, [tokenize(text) for text in item.texts], target)
