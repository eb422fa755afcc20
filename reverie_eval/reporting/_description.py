"""A dataset's description as people and programs read it: tables, JSON."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from pydantic import TypeAdapter

from reverie_eval.dataset import (
    AnswerDescription,
    DatasetDescription,
    Distribution,
    PaperComparison,
    SplitDescription,
)
from reverie_eval.reporting._grids import Grid, aligned, rich_table, room_for

if TYPE_CHECKING:
    from rich.console import Console


UNKNOWN = "-"
_SOURCE = "paper: Qi et al., REVERIE, CVPR 2020, section 3"
_GROUPS: Mapping[tuple[str, ...], str] = MappingProxyType(
    {
        (): "",
        ("val_seen", "val_unseen"): "val",
        ("train", "val_seen", "val_unseen", "test"): "all",
    }
)
"""What the table calls the splits that a number of the paper covers."""


def plain(description: DatasetDescription) -> str:
    """Aligned columns without decoration, for a pipe or a file."""
    tables = map(aligned, grids_of(description))
    return "\n\n".join([*tables, "\n".join(captions_of(description))])


def json_report(description: DatasetDescription) -> str:
    """Render the description as JSON."""
    return TypeAdapter(DatasetDescription).dump_json(description, indent=2).decode()


def show(description: DatasetDescription, console: "Console") -> None:
    """Print the tables on a terminal; where one does not fit, its lines wrap and nothing is cut."""
    for grid in grids_of(description):
        table = rich_table(grid)
        if room_for(table, console).maximum <= console.width:
            console.print(table)
        else:
            console.print(aligned(grid), end="\n\n", markup=False, highlight=False, soft_wrap=True)
    for caption in captions_of(description):
        console.print(caption, style="dim", markup=False, highlight=False, soft_wrap=True)


def grids_of(description: DatasetDescription) -> Sequence[Grid]:
    """Word a description: the splits side by side, and what the paper says."""
    several = len(description.splits) > 1
    parts = {**description.splits, **({"together": description.total} if several else {})}
    return [
        Grid(
            headings=["", *parts],
            rows=[[label, *map(cell, parts.values())] for label, cell in _ROWS],
            to_the_left=frozenset({0}),
        ),
        Grid(
            headings=["", "splits", "here", "paper", ""],
            rows=[_compared(comparison) for comparison in description.paper],
            to_the_left=frozenset({0, 1, 4}),
        ),
    ]


def captions_of(description: DatasetDescription) -> Sequence[str]:
    """Say where the paper's numbers are from, and what a reader should know."""
    return [_SOURCE, *(f"note: {note}" for note in description.notes)]


def _compared(comparison: PaperComparison) -> Sequence[str]:
    missing = [split for split in comparison.splits if split not in comparison.covered]
    partly = comparison.covered and missing
    return [
        comparison.quantity,
        _GROUPS.get(tuple(comparison.splits), ", ".join(comparison.splits)),
        UNKNOWN if comparison.here is None else _number(comparison.here),
        _number(comparison.paper),
        f"without {', '.join(missing)}" if partly else "",
    ]


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.1f}"


Cell = Callable[[SplitDescription], str]


def _count(number: Callable[[SplitDescription], int]) -> Cell:
    return lambda part: f"{number(part):,}"


def _count_of(number: Callable[[AnswerDescription], int]) -> Cell:
    return lambda part: UNKNOWN if part.answers is None else f"{number(part.answers):,}"


def _spread_of(
    label: str, values: Callable[[AnswerDescription], Distribution]
) -> Sequence[tuple[str, Cell]]:
    """Make two rows of a quantity: its mean, and from where to where it goes."""

    def cell(word: Callable[[Distribution], str]) -> Cell:
        return lambda part: UNKNOWN if part.answers is None else word(values(part.answers))

    return [(label, cell(_mean)), (_RANGE, cell(_range))]


def _mean(values: Distribution) -> str:
    return f"{values.mean:.1f}"


def _range(values: Distribution) -> str:
    return f"{_short(values.minimum)}-{_short(values.maximum)}"


def _short(value: float) -> str:
    return f"{value:.0f}" if value.is_integer() else f"{value:.1f}"


_RANGE = "    range"
_ROWS: Sequence[tuple[str, Cell]] = (
    ("tasks", _count(lambda part: part.tasks)),
    ("instructions", _count(lambda part: part.instructions)),
    ("scans", _count(lambda part: part.scans)),
    ("viewpoints of them", _count(lambda part: part.viewpoints)),
    ("words per instruction", lambda part: _mean(part.words)),
    (_RANGE, lambda part: _range(part.words)),
    ("different words", _count(lambda part: part.vocabulary)),
    ("frequent words", _count(lambda part: part.frequent_vocabulary)),
    ("target objects", _count_of(lambda answers: answers.target_objects)),
    ("target categories", _count_of(lambda answers: answers.target_categories)),
    *_spread_of("objects at the goal", lambda answers: answers.goal_objects),
    *_spread_of("boxes at the goal", lambda answers: answers.goal_boxes),
    *_spread_of("path steps", lambda answers: answers.path_steps),
    *_spread_of("path length m", lambda answers: answers.path_length),
)
"""The rows of the table of splits, with what stands in them."""


FORMATS: Mapping[str, Callable[[DatasetDescription], str]] = MappingProxyType(
    {"table": plain, "json": json_report}
)
"""What ``--format`` offers."""
