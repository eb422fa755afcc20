"""A dataset's description as two tables: its splits, and the paper's numbers beside its own."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from reverie_eval.dataset import (
    AnswerDescription,
    DatasetDescription,
    Distribution,
    PaperComparison,
    SplitDescription,
)
from reverie_eval.reporting._table import MISSING, Table, print_table

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
    splits, paper = _tables(description)
    return f"{splits.to_text()}\n\n{paper.to_text()}"


def print_description(console: "Console", description: DatasetDescription) -> None:
    """Print the tables on a terminal."""
    for table in _tables(description):
        print_table(console, table)


def _tables(description: DatasetDescription) -> tuple[Table, Table]:
    """Return the splits side by side, and the paper's numbers beside the dataset's."""
    has_several = len(description.splits) > 1
    parts = {**description.splits, **({"total": description.total} if has_several else {})}
    splits = Table(
        headings=["", *parts],
        rows=[[label, *map(cell, parts.values())] for label, cell in _ROWS],
        text_columns=frozenset({0}),
    )
    paper = Table(
        headings=["", "splits", "dataset", "paper", ""],
        rows=[_compared(comparison) for comparison in description.paper],
        text_columns=frozenset({0, 1, 4}),
        notes=[_SOURCE, *(f"note: {note}" for note in description.notes)],
    )
    return splits, paper


def _compared(comparison: PaperComparison) -> Sequence[str]:
    missing = [split for split in comparison.splits if split not in comparison.covered]
    partly = comparison.covered and missing
    return [
        comparison.quantity,
        _GROUPS.get(tuple(comparison.splits), ", ".join(comparison.splits)),
        MISSING if comparison.here is None else _number(comparison.here),
        _number(comparison.paper),
        f"without {', '.join(missing)}" if partly else "",
    ]


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.1f}"


_Cell = Callable[[SplitDescription], str]


def _count(number: Callable[[SplitDescription], int]) -> _Cell:
    return lambda part: f"{number(part):,}"


def _count_of(number: Callable[[AnswerDescription], int]) -> _Cell:
    return lambda part: MISSING if part.answers is None else f"{number(part.answers):,}"


def _spread_of(
    label: str, values: Callable[[AnswerDescription], Distribution]
) -> Sequence[tuple[str, _Cell]]:
    """Return two rows of a quantity: its mean, and its range."""

    def cell(text: Callable[[Distribution], str]) -> _Cell:
        return lambda part: MISSING if part.answers is None else text(values(part.answers))

    return [(label, cell(_mean)), (_RANGE, cell(_range))]


def _mean(values: Distribution) -> str:
    return f"{values.mean:.1f}"


def _range(values: Distribution) -> str:
    return f"{_short(values.minimum)}-{_short(values.maximum)}"


def _short(value: float) -> str:
    return f"{value:.0f}" if value.is_integer() else f"{value:.1f}"


_RANGE = "    range"
_ROWS: Sequence[tuple[str, _Cell]] = (
    ("tasks", _count(lambda part: part.tasks)),
    ("instructions", _count(lambda part: part.instructions)),
    ("scans", _count(lambda part: part.scans)),
    ("viewpoints in scans", _count(lambda part: part.viewpoints)),
    ("words per instruction", lambda part: _mean(part.words)),
    (_RANGE, lambda part: _range(part.words)),
    ("distinct words", _count(lambda part: part.vocabulary)),
    ("frequent words", _count(lambda part: part.frequent_vocabulary)),
    ("target objects", _count_of(lambda answers: answers.target_objects)),
    ("target categories", _count_of(lambda answers: answers.target_categories)),
    *_spread_of("objects at the goal", lambda answers: answers.goal_objects),
    *_spread_of("boxes at the goal", lambda answers: answers.goal_boxes),
    *_spread_of("path steps", lambda answers: answers.path_steps),
    *_spread_of("path length (m)", lambda answers: answers.path_length),
)
"""The rows of the table of splits: labels and cells."""
