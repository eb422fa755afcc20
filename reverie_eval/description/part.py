"""A part of a dataset in numbers: a split, or several taken together."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from reverie_eval.description.distribution import Distribution
from reverie_eval.description.tasks import AnswerFacts, TaskFacts
from reverie_eval.words import FREQUENT


@dataclass(frozen=True, eq=False, slots=True)
class Answers:
    """What the tasks that name their target come to."""

    tasks: int
    """How many tasks name their target."""
    hidden_targets: int
    """Tasks whose target is not visible at the goal; published evaluators stumble over them."""
    target_objects: int
    """Different targets; of several splits the sum, as in the paper, whose 4,140 are the 2,353 of
    train, the 953 of val_seen and val_unseen, and the 834 of test."""
    category_counts: Mapping[str, int]
    """Target objects by category, the most frequent first; those without a name in none."""
    path_steps: Distribution
    """Moves per annotated path."""
    path_length: Distribution
    """Metres per annotated path."""
    goal_objects: Distribution
    """Objects that are visible at the goal, per task."""
    goal_boxes: Distribution
    """Boxes of visible objects in all views of the goal, per task."""

    @classmethod
    def of(cls, facts: Sequence[AnswerFacts]) -> Self:
        """Add up tasks, of which there is at least one."""
        category = {answer.target: answer.category for answer in facts}
        named = Counter(name for name in category.values() if name)
        return cls(
            tasks=len(facts),
            hidden_targets=sum(not answer.is_visible for answer in facts),
            target_objects=len(category),
            category_counts=dict(sorted(named.items(), key=lambda item: (-item[1], item[0]))),
            path_steps=Distribution.of(answer.path_steps for answer in facts),
            path_length=Distribution.of(answer.path_length for answer in facts),
            goal_objects=Distribution.of(answer.goal_objects for answer in facts),
            goal_boxes=Distribution.of(answer.goal_boxes for answer in facts),
        )

    @property
    def target_categories(self) -> int:
        """Different categories of target objects."""
        return len(self.category_counts)


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """A split, or several taken together."""

    splits: tuple[str, ...]
    tasks: int
    instructions: int
    """Episodes: a task has one for each of its instructions."""
    scans: int
    """Buildings that the tasks are in."""
    viewpoints: int
    """Included viewpoints of these buildings."""
    words: Distribution
    """Words per instruction."""
    word_counts: Mapping[str, int]
    """How often each word occurs."""
    answers: Answers | None
    """Of the tasks that name their target; None if no task does."""

    @classmethod
    def of(
        cls, facts: Mapping[str, Sequence[TaskFacts]], viewpoint_counts: Mapping[str, int]
    ) -> Self:
        """Describe splits together.

        Parameters
        ----------
        facts : mapping
            The tasks of each split that is meant; at least one split, and each with a task.
        viewpoint_counts : mapping
            How many included viewpoints each scan has.
        """
        tasks = [task for split in facts.values() for task in split]
        instructions = [words for task in tasks for words in task.words]
        scans = {task.scan for task in tasks}
        answers = [task.answer for task in tasks if task.answer]
        return cls(
            splits=tuple(facts),
            tasks=len(tasks),
            instructions=len(instructions),
            scans=len(scans),
            viewpoints=sum(viewpoint_counts[scan] for scan in scans),
            words=Distribution.of(len(words) for words in instructions),
            word_counts=Counter(word for words in instructions for word in words),
            answers=Answers.of(answers) if answers else None,
        )

    @property
    def vocabulary(self) -> int:
        """Different words."""
        return len(self.word_counts)

    @property
    def frequent_vocabulary(self) -> int:
        """Different words that occur at least five times."""
        return sum(count >= FREQUENT for count in self.word_counts.values())
