"""The description of a dataset: what ``describe --format json`` prints."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

from reverie_eval.version import __version__


class _Described(BaseModel):
    model_config = ConfigDict(
        frozen=True, use_attribute_docstrings=True, extra="forbid", from_attributes=True
    )


class DistributionReport(_Described):
    """One quantity over many tasks or instructions; nothing is rounded."""

    mean: float
    median: float
    minimum: float
    maximum: float
    counts: dict[int, int]
    """How many values there are from each whole number up to below the next."""


class AnswersReport(_Described):
    """What the tasks that name their target come to."""

    tasks: int
    """Tasks that name their target."""
    hidden_targets: int
    """Tasks whose target is not visible at the goal."""
    target_objects: int
    """Different targets; of several splits the sum."""
    target_categories: int
    """Different names of target objects."""
    category_counts: dict[str, int]
    """Target objects by category, the most frequent first."""
    path_steps: DistributionReport
    """Moves per annotated path."""
    path_length: DistributionReport
    """Metres per annotated path, along the navigation graph."""
    goal_objects: DistributionReport
    """Objects that are visible at the goal, per task."""
    goal_boxes: DistributionReport
    """Boxes of visible objects in all views of the goal, per task."""


class PartReport(_Described):
    """A split, or several taken together."""

    splits: list[str]
    tasks: int
    instructions: int
    """Episodes: a task has one for each of its instructions."""
    scans: int
    """Buildings that the tasks are in."""
    viewpoints: int
    """Included viewpoints of these buildings."""
    words: DistributionReport
    """Words per instruction."""
    vocabulary: int
    """Different words, in lower case."""
    frequent_vocabulary: int
    """Different words that occur at least five times."""
    answers: AnswersReport | None
    """Of the tasks that name their target; null if no task does."""


class ComparisonReport(_Described):
    """A number of the REVERIE paper beside the same number of this dataset."""

    quantity: str
    splits: list[str]
    """The splits that the paper's number covers; none if it is about the buildings."""
    covered: list[str]
    """Those of them that the number here covers; only if all do, the two compare."""
    here: float | None
    """Null if it covers none of them."""
    paper: float


class DescriptionReport(_Described):
    """What a dataset is made of, beside the REVERIE paper's own numbers."""

    schema_version: Literal[1] = 1
    version: str = __version__
    """Version of reverie-eval that described it."""
    buildings: int
    """Scans that have a navigation graph, whether tasks are in them or not."""
    viewpoints: int
    """Included viewpoints of these graphs: panoramas."""
    splits: dict[str, PartReport]
    """Each split by itself."""
    total: PartReport
    """All splits together."""
    paper: list[ComparisonReport]
    notes: list[str] = []
    """What a reader of the numbers should know, a sentence each."""
