"""Predictions: what a submission says, in columns, not yet held against any ground truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from reverie_eval.arrays import IntArray
from reverie_eval.errors import Problem
from reverie_eval.reading.sources import Source

Submission: TypeAlias = Source | Sequence[Mapping[str, Any]]
"""What can be scored: where a file is, its content, or its records as Python objects."""

LARGEST_OBJECT_ID = 2**31 - 1


@dataclass(frozen=True, eq=False)
class Predictions:
    """One row per record that could be read, in the order of the file."""

    rows: Sequence[int]
    """The number of each record in the file, for messages."""
    instr_ids: Sequence[str | None]
    """None where it could not be read, which ``problems`` tells."""
    viewpoint_ids: Sequence[str | None]
    """Every pose's viewpoint, trajectory after trajectory; None as above."""
    offsets: IntArray
    """Shape (n_records + 1,): where each trajectory begins in ``viewpoint_ids``."""
    predicted_object: IntArray
    """Shape (n_records,): the object that each answer names, or -1."""
    problems: Sequence[Problem] = ()
    """What could not be read."""
