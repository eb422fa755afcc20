"""Saved scores: the aligned predictions and how they were scored, without any answers.

Scores are computed again from them, which takes milliseconds and gives the same digits.
"""

from dataclasses import dataclass, fields
from operator import attrgetter
from os import PathLike
from pathlib import Path

import msgspec
import numpy as np

from reverie_eval.arrays import frozen, read_arrays, take_prefixed
from reverie_eval.errors import ReverieEvalError
from reverie_eval.files import staged_file
from reverie_eval.submissions import BoxAnswers, SubmissionColumns

FORMAT_VERSION = 1
_HEADER = "header"
_BOXES = "boxes/"
_POINT = "point"
"""Only of a task with points."""
_COLUMNS = (
    *("viewpoint", "offsets", "predicted_object", "answer_is_text", "has_leading_zeros"),
    *(f"{_BOXES}{field.name}" for field in fields(BoxAnswers)),
)


@dataclass(frozen=True)
class IntervalSettings:
    """How intervals were computed, as :meth:`Scores.with_intervals` takes it."""

    cluster: str
    confidence: float
    resamples: int
    seed: int


@dataclass(frozen=True)
class SavedHeader:
    """How the predictions were scored."""

    task: str
    split: str
    protocol: str
    qualifier: str
    fingerprint: str
    """The fingerprint of the ground truth, whose viewpoints and episodes the columns index."""
    subset: tuple[str, ...] | None
    """The instr_ids of a declared subset."""
    hints: tuple[str, ...]
    intervals: IntervalSettings | None
    is_navigation_only: bool
    format_version: int = FORMAT_VERSION


def write_saved(
    file: str | PathLike[str], header: SavedHeader, submission: SubmissionColumns
) -> None:
    """Write what scores are computed from; the file appears complete or not at all."""
    columns = {name: attrgetter(name.replace("/", "."))(submission) for name in _COLUMNS}
    if submission.point is not None:
        columns[_POINT] = submission.point
    columns[_HEADER] = np.frombuffer(msgspec.json.encode(header), np.uint8)
    with staged_file(Path(file)) as staged:
        np.savez_compressed(staged, **columns)


def read_saved(file: str | PathLike[str]) -> tuple[SavedHeader, SubmissionColumns]:
    """Read what :func:`write_saved` wrote; errors are those of :meth:`Scores.load`."""
    try:
        arrays = read_arrays(Path(file))
        names = [*_COLUMNS, *({_POINT} & arrays.keys())]
        columns = {name: frozen(arrays[name]) for name in names}
        header = msgspec.json.decode(arrays[_HEADER].tobytes(), type=SavedHeader)
    except (ValueError, KeyError, msgspec.DecodeError) as error:
        raise ReverieEvalError(
            f"{file} has no saved scores, or is damaged; `Scores.save` writes such files, and "
            "`rv.evaluate` scores a result file"
        ) from error
    if header.format_version != FORMAT_VERSION:
        raise ReverieEvalError(
            f"{file} has format {header.format_version} of saved scores, this version of "
            f"reverie-eval reads format {FORMAT_VERSION}; load it with the version that wrote it"
        )
    boxes = BoxAnswers(**take_prefixed(columns, _BOXES))
    is_navigation_only = header.is_navigation_only
    aligned = SubmissionColumns(**columns, boxes=boxes, is_navigation_only=is_navigation_only)
    return header, aligned
