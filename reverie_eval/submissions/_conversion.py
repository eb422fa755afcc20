"""Convert a submission to the official form, from any form whose meaning is clear."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from os import PathLike
from typing import Any

from reverie_eval.errors import Problem, SubmissionError
from reverie_eval.ground_truth import GroundTruth, find_ground_truth
from reverie_eval.submissions import _faults as faults
from reverie_eval.submissions import _problems as problems
from reverie_eval.submissions._alignment import align
from reverie_eval.submissions._answers import Answer, has_answer, official_point
from reverie_eval.submissions._document import are_records, parse_document, parse_python_literal
from reverie_eval.submissions._faults import ReadingLog
from reverie_eval.submissions._fields import ANSWER_KEYS
from reverie_eval.submissions._hints import UNNAMED_ANSWERS
from reverie_eval.submissions._predictions import Signs, Submission
from reverie_eval.submissions._recognition import fix_viewpoint_ids, recognise, recognise_task
from reverie_eval.submissions._records import ReadRecord, read_predictions, read_records
from reverie_eval.submissions._sources import is_python_literal, read_bytes
from reverie_eval.submissions._trajectories import join_items
from reverie_eval.tasks import DEFAULT_TASK, Task, find_task
from reverie_eval.text import count_text


@dataclass(frozen=True, slots=True)
class Conversion:
    """A submission in the official form, and what the conversion changed."""

    records: Sequence[Mapping[str, Any]]
    """Only ``instr_id``, ``trajectory`` with full poses, and either ``predObjId`` as a number or
    ``predBox`` with its view and image size; no answers if the file has none."""
    read_as: Sequence[str]
    """How the file differs from the official form, a phrase each."""
    fixed: Sequence[str]
    """The mistakes for which the file would be rejected, a phrase each."""
    dropped: Mapping[str, int]
    """Fields that the official form does not have, with the number of records that had them."""
    poses_without_angles: int
    """Poses whose heading and elevation are written as 0, because the file does not give them."""
    remaining: Sequence[Problem] = ()
    """Why the converted file is still rejected, if a split was given."""

    has_targets: bool = True
    """Whether the task has target objects, so that answers are expected."""

    @property
    def notes(self) -> Sequence[str]:
        """What a reader of the converted file should know, a sentence each."""
        lacks_answers = self.has_targets and not any(map(has_answer, self.records))
        without_angles = (
            f"{self.poses_without_angles:,} poses without heading and elevation; both are written "
            "as 0"
        )
        return [
            *([f"read as: {'; '.join(self.read_as)}"] if self.read_as else []),
            *(f"fixed: {mistake}" for mistake in self.fixed),
            *(f"dropped: {name}, in {count:,} records" for name, count in self.dropped.items()),
            *([UNNAMED_ANSWERS] if self.dropped and lacks_answers else []),
            *([without_angles] if self.poses_without_angles else []),
            *([_remaining_note(self.remaining)] if self.remaining else []),
        ]


def convert(
    submission: Submission,
    *,
    split: str | None = None,
    ground_truth: str | PathLike[str] | GroundTruth | None = None,
    task: str | None = None,
) -> Conversion:
    """Read a submission in any form and convert it to the official one.

    Mistakes for which the submission would be rejected are fixed if their meaning is clear.

    Parameters
    ----------
    submission
        As for :func:`reverie_eval.evaluate`.
    split, ground_truth, task : optional
        With a split, ids that its ground truth does not have are fixed too. A public bundle is
        enough. Without one, any ids and viewpoints are accepted.

    Raises
    ------
    SubmissionError
        If it cannot be read; lists every problem with its location.
    GroundTruthError
        If there is no ground truth for the split.
    OSError
        If the file cannot be read.
    """
    truth = None if split is None else find_ground_truth(ground_truth, split, task)
    log = ReadingLog()
    of_task = find_task(task or DEFAULT_TASK) if truth is None else truth.task
    given = submission if are_records(submission) else _parse(read_bytes(submission), log)
    records, signs = read_records(given, log, of_task)
    if truth is not None:
        records = _with_known_ids(records, signs, truth, log)
    else:
        recognise_task(
            [record.instr_id for record in records],
            signs,
            of_task,
            log,
            lambda row: (records[row].location, ".instr_id"),
        )
    written = _without_repeats(records, log, of_task)
    if log.has_unfixable:
        raise SubmissionError(faults.limit_problems(log.all_problems()))
    converted = join_items(written) if of_task.has_items else written
    return Conversion(
        records=converted,
        read_as=log.read_as(),
        fixed=log.fixed(),
        dropped=dict(log.ignored_fields),
        poses_without_angles=sum(record.trajectory.headings.count(None) for record in records),
        has_targets=of_task.has_targets,
        remaining=() if truth is None else _problems_of(converted, truth),
    )


def _problems_of(records: Sequence[Mapping[str, Any]], truth: GroundTruth) -> Sequence[Problem]:
    try:
        # What was written is read again, as by anyone who scores it.
        align(read_predictions(records, truth.task), truth)
    except SubmissionError as error:
        return error.problems
    return ()


def _remaining_note(problems: Sequence[Problem]) -> str:
    count = count_text(len(problems), "problem")
    return f"still rejected, {count}, which `reverie-eval validate` lists; the first: {problems[0]}"


def _parse(content: bytes, log: ReadingLog) -> Any:
    # Python text is not read when scoring: evaluating it takes a hundred times its size.
    if is_python_literal(content):
        return parse_python_literal(content, log)
    return parse_document(content, log)


def _with_known_ids(
    records: Sequence[ReadRecord], signs: Signs, truth: GroundTruth, log: ReadingLog
) -> Sequence[ReadRecord]:
    """Fix the ids that the ground truth does not have, and leave out records of other splits."""
    found = recognise(
        [record.instr_id for record in records],
        signs,
        truth,
        log,
        lambda row: (records[row].location, ".instr_id"),
    )
    if found.problem is not None:
        raise SubmissionError([found.problem])
    others = set(found.others)
    instr_ids = [each for row, each in enumerate(found.instr_ids) if row not in others]
    records = [record for row, record in enumerate(records) if row not in others]
    walks = [record.trajectory for record in records]
    locations = [
        (record.location, problems.pose_field(within))
        for record in records
        for within in record.trajectory.locations
    ]
    given = [viewpoint_id for walk in walks for viewpoint_id in walk.viewpoint_ids]
    meant = iter(fix_viewpoint_ids(given, truth, log, locations.__getitem__))
    return [
        record._replace(
            instr_id=instr_id,
            trajectory=walk._replace(viewpoint_ids=list(islice(meant, len(walk.locations)))),
        )
        for record, instr_id, walk in zip(records, instr_ids, walks, strict=True)
    ]


def _without_repeats(
    records: Sequence[ReadRecord], log: ReadingLog, task: Task
) -> Sequence[Mapping[str, Any]]:
    """Write records in the official form, and leave out those that repeat an earlier one."""
    earlier: dict[str | None, Mapping[str, Any]] = {}
    written = []
    for record in records:
        official = _official(record, task)
        # As when repeats are reported, the angles of poses do not count, but a box's camera does.
        content = {**official, "trajectory": record.trajectory.viewpoint_ids}
        if record.answer is not None and record.answer.box is not None:
            content["camera"] = record.answer.box.camera
        if record.instr_id is not None and earlier.get(record.instr_id) == content:
            log.add_fault(faults.REPEATED_RECORDS, record.location, ".instr_id", record.instr_id)
        else:
            earlier.setdefault(record.instr_id, content)
            written.append(official)
    return written


def _official(record: ReadRecord, task: Task) -> dict[str, Any]:
    _, viewpoint_ids, headings, elevations, *_ = record.trajectory
    return {
        **task.official_id(record.instr_id or ""),
        "trajectory": [
            [viewpoint_id, float(heading or 0), float(elevation or 0)]
            for viewpoint_id, heading, elevation in zip(
                viewpoint_ids, headings, elevations, strict=True
            )
        ],
        **_official_answer(record.answer),
        **(official_point(record.point) if task.has_items else {}),
    }


def _official_answer(answer: Answer | None) -> Mapping[str, Any]:
    if answer is None:
        return {}
    return {ANSWER_KEYS[0]: answer.object_id} if answer.box is None else answer.box.fields
