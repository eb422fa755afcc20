"""Scores computed again, from a file or from parts, which takes milliseconds: the same digits.

A file has the aligned predictions and how they were scored, without any answers.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from operator import attrgetter
from os import PathLike
from pathlib import Path

import msgspec
import numpy as np
from typing_extensions import Self

from reverie_eval.arrays import frozen, read_arrays, take_prefixed
from reverie_eval.errors import GroundTruthError, ProtocolError, ReverieEvalError
from reverie_eval.files import staged_file
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.scoring._intervals import Intervals
from reverie_eval.scoring._lookups import Lookups
from reverie_eval.scoring._scored import Scored
from reverie_eval.submissions import BoxAnswers, SubmissionColumns
from reverie_eval.text import count_text, first_few, short_digest

FORMAT_VERSION = 1
_HEADER = "header"
_BOXES = "boxes/"
# Only of a task with points.
_POINT = "point"
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

    @classmethod
    def of(cls, scores: Scored, submission: SubmissionColumns, hints: Sequence[str]) -> Self:
        """Describe how a submission was scored."""
        truth, intervals = scores.ground_truth, scores.intervals
        settings = None
        if isinstance(intervals, Intervals):
            settings = IntervalSettings(
                intervals.cluster, intervals.confidence, intervals.resamples, intervals.seed
            )
        return cls(
            task=truth.task.name,
            split=truth.split,
            protocol=scores.protocol.name,
            qualifier=scores.qualifier,
            fingerprint=truth.fingerprint,
            # The ids themselves: the digest of a subset cannot be turned back into its episodes.
            subset=tuple(scores.instr_ids) if truth.subset_digest else None,
            hints=tuple(hints),
            intervals=settings,
            is_navigation_only=submission.is_navigation_only,
        )


def write_saved(
    file: str | PathLike[str], header: SavedHeader, submission: SubmissionColumns
) -> None:
    """Write what scores are computed from; the file appears complete or not at all."""
    columns = {name: attrgetter(name.replace("/", "."))(submission) for name in _COLUMNS}
    if submission.point is not None:
        columns[_POINT] = submission.point
    columns[_HEADER] = np.frombuffer(msgspec.json.encode(header), np.uint8)
    # A training that is killed while it saves leaves the earlier file.
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


def find_saved_truth(
    file: str | PathLike[str],
    header: SavedHeader,
    given: str | PathLike[str] | GroundTruth | None,
) -> GroundTruth:
    """Find the ground truth that saved scores were computed with, reduced to their episodes."""
    truth = find_ground_truth(given, header.split, header.task)
    if truth.fingerprint != header.fingerprint:
        raise GroundTruthError(
            f"{file} was scored with ground truth {short_digest(header.fingerprint)}, "
            f"but {truth.origin} is {short_digest(truth.fingerprint)}; pass "
            "ground_truth=, or score the result file again"
        )
    return truth if header.subset is None else truth.subset(header.subset)


def join_parts(parts: Sequence[Scored], submissions: Sequence[SubmissionColumns]) -> Lookups:
    """Join what was scored in several parts of a split, in the order of the whole.

    Raises
    ------
    ProtocolError
        If there are no parts, they were not scored alike, or they share episodes.
    """
    if not parts:
        raise ProtocolError("there are no scores to concatenate")
    first = parts[0]
    for part in parts:
        if part.conditions != first.conditions:
            raise ProtocolError(
                f"these scores are not of one split under one protocol: {first.signature} and "
                f"{part.signature}"
            )
    # Whether answers are scored is a property of the whole table, not of a row.
    if len({each.is_navigation_only for each in submissions}) > 1:
        raise ProtocolError("some of these scores have answers and others have none")
    whole = first.ground_truth.whole.scored_by(first.protocol)
    instr_ids = [instr_id for part in parts for instr_id in part.instr_ids]
    repeated = [instr_id for instr_id, count in Counter(instr_ids).items() if count > 1]
    if repeated:
        raise ProtocolError(
            f"{count_text(len(repeated), 'episode')} in several parts, such as "
            f"{first_few(repeated)}; give each episode once"
        )
    is_whole = len(instr_ids) == len(whole.episodes.instr_ids)
    order = np.argsort([whole.episodes.index[instr_id] for instr_id in instr_ids])
    submission = SubmissionColumns.concatenate(list(submissions))
    return Lookups(submission.take(order), whole if is_whole else whole.subset(instr_ids))
