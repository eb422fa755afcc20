"""Convert a submission from any form that can be read to the official one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from reverie_eval.errors import SubmissionError
from reverie_eval.submissions._document import are_records, parse_document
from reverie_eval.submissions._predictions import Submission
from reverie_eval.submissions._reading_log import ReadingLog
from reverie_eval.submissions._records import ReadRecord, read_records
from reverie_eval.submissions._sources import read_bytes


@dataclass(frozen=True, slots=True)
class Conversion:
    """A submission in the official form, and what the conversion changed."""

    records: Sequence[Mapping[str, Any]]
    """Only ``instr_id``, ``trajectory`` with full poses, and either ``predObjId`` as a number or
    ``predBox`` with its view and image size."""
    read_as: Sequence[str]
    """How the file differs from the official form, a phrase each."""
    dropped: Mapping[str, int]
    """Fields that the official form does not have, with the number of records that had them."""
    poses_without_angles: int
    """Poses whose heading and elevation are written as 0, because the file does not give them."""

    @property
    def notes(self) -> Sequence[str]:
        """What a reader of the converted file should know, a sentence each."""
        without_angles = (
            f"{self.poses_without_angles:,} poses without heading and elevation; both are written "
            "as 0"
        )
        return [
            *([f"read as: {'; '.join(self.read_as)}"] if self.read_as else []),
            *(f"dropped: {name}, in {count:,} records" for name, count in self.dropped.items()),
            *([without_angles] if self.poses_without_angles else []),
        ]


def convert(submission: Submission) -> Conversion:
    """Read a submission in any form and convert it to the official one.

    No split is needed: any ids and viewpoints are accepted.

    Raises
    ------
    SubmissionError
        If it cannot be read; lists every problem with its location.
    OSError
        If the file cannot be read.
    """
    log = ReadingLog()
    given = submission if are_records(submission) else parse_document(read_bytes(submission))
    records = read_records(given, log)
    if log.problems:
        raise SubmissionError(log.problems)
    poses = [pose for record in records for pose in record.poses]
    return Conversion(
        records=list(map(_official, records)),
        read_as=log.read_as(),
        dropped=dict(log.unused_fields),
        poses_without_angles=sum(pose.heading is None for pose in poses),
    )


def _official(record: ReadRecord) -> dict[str, Any]:
    box = record.answer.box
    return {
        "instr_id": record.instr_id,
        "trajectory": [
            [pose.viewpoint_id, float(pose.heading or 0), float(pose.elevation or 0)]
            for pose in record.poses
        ],
        **({"predObjId": record.answer.object_id} if box is None else box.fields),
    }
