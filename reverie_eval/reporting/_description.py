"""A dataset's description as two tables: its splits, and the paper's numbers beside its own."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from reverie_eval.dataset import DatasetDescription, Distribution, PaperComparison, SplitDescription
from reverie_eval.dataset._description import of_answers
from reverie_eval.reporting._table import Table, cell_of, print_table

if TYPE_CHECKING:
    from rich.console import Console


_SOURCE = "paper: Qi et al., REVERIE, CVPR 2020, section 3"
_GROUPS: Mapping[tuple[str, ...], str] = MappingProxyType(
    {
        (): "",
        ("val_seen", "val_unseen"): "val",
        ("train", "val_seen", "val_unseen", "test"): "all",
    }
)
"""Names for the splits that a number of the paper covers."""


def description_text(description: DatasetDescription) -> str:
    """Return the tables in aligned columns, for a pipe or a file."""
    return "\n\n".join(table.to_text() for table in _tables(description))


def print_description(console: "Console", description: DatasetDescription) -> None:
    """Print the tables on a terminal."""
    for table in _tables(description):
        print_table(console, table)


def _tables(description: DatasetDescription) -> Sequence[Table]:
    """Return the splits side by side, and the paper's numbers beside the dataset's, if any."""
    has_several = len(description.splits) > 1
    parts = {**description.splits, **({"total": description.total} if has_several else {})}
    rows = [(label, list(map(measure, parts.values())), text) for label, measure, text in _ROWS]
    if not description.paper:  # a task without target objects has no rows about them
        rows = [row for row in rows if any(value is not None for value in row[1])]
    splits = Table(
        headings=["", *parts],
        rows=[[label, *(cell_of(value, text) for value in values)] for label, values, text in rows],
        text_columns=frozenset({0}),
    )
    if not description.paper:
        return [splits]
    paper = Table(
        headings=["", "splits", "dataset", "paper", ""],
        rows=[_compared(comparison) for comparison in description.paper],
        text_columns=frozenset({0, 1, 4}),
        notes=[_SOURCE, *(f"note: {note}" for note in description.notes)],
    )
    return [splits, paper]


def _compared(comparison: PaperComparison) -> Sequence[str]:
    missing = [split for split in comparison.splits if split not in comparison.covered]
    partly = comparison.covered and missing
    return [
        comparison.quantity,
        _GROUPS.get(tuple(comparison.splits), ", ".join(comparison.splits)),
        cell_of(comparison.here, _number),
        _number(comparison.paper),
        f"without {', '.join(missing)}" if partly else "",
    ]


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.1f}"


def _mean(values: Distribution) -> str:
    return f"{values.mean:.1f}"


def _range(values: Distribution) -> str:
    ends = (values.minimum, values.maximum)
    return "-".join(f"{end:.0f}" if end.is_integer() else f"{end:.1f}" for end in ends)


_RANGE = "    range"
GOAL_OBJECTS = of_answers(lambda answers: answers.goal_objects)
GOAL_BOXES = of_answers(lambda answers: answers.goal_boxes)
PATH_STEPS = of_answers(lambda answers: answers.path_steps)
PATH_LENGTH = of_answers(lambda answers: answers.path_length)
_ROWS: Sequence[tuple[str, Callable[[SplitDescription], Any], Callable[[Any], str]]] = (
    ("items", lambda part: part.items, _number),
    ("instructions", lambda part: part.instructions, _number),
    ("scans", lambda part: part.scans, _number),
    ("viewpoints in scans", lambda part: part.viewpoints, _number),
    ("words per instruction", lambda part: part.words, _mean),
    (_RANGE, lambda part: part.words, _range),
    ("distinct words", lambda part: part.vocabulary, _number),
    ("frequent words", lambda part: part.frequent_vocabulary, _number),
    ("target objects", of_answers(lambda answers: answers.target_objects), _number),
    ("target categories", of_answers(lambda answers: answers.target_categories), _number),
    ("objects at the goal", GOAL_OBJECTS, _mean),
    (_RANGE, GOAL_OBJECTS, _range),
    ("boxes at the goal", GOAL_BOXES, _mean),
    (_RANGE, GOAL_BOXES, _range),
    ("path steps", PATH_STEPS, _mean),
    (_RANGE, PATH_STEPS, _range),
    ("path length (m)", PATH_LENGTH, _mean),
    (_RANGE, PATH_LENGTH, _range),
)
"""The rows of the table of splits: label, value, and how it is shown."""
