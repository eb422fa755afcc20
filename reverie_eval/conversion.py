"""Convert a submission from any readable form to the official one."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from reverie_eval.errors import SubmissionError
from reverie_eval.reading import Submission
from reverie_eval.reading.document import read_document
from reverie_eval.reading.findings import Findings
from reverie_eval.reading.records import FIELDS, ReadRecord, read_each
from reverie_eval.reading.trajectories import Pose


@dataclass(frozen=True, slots=True)
class Conversion:
    """A submission in the official form, and what it took to get there."""

    records: Sequence[Mapping[str, Any]]
    """``instr_id``, ``trajectory`` of full poses, ``predObjId`` as a number, and nothing else."""
    read_as: Sequence[str]
    """What was read although it is not the official form, a phrase each."""
    dropped: Mapping[str, int]
    """In how many records a field was left out that the official form does not have."""
    poses_without_angles: int
    """How many poses have heading and elevation 0 because the file does not give them."""

    @property
    def notes(self) -> Sequence[str]:
        """What the reader of the converted file should know, a sentence each."""
        return list(self._notes())

    def _notes(self) -> Iterator[str]:
        if self.read_as:
            yield f"read as: {'; '.join(self.read_as)}"
        for name, count in self.dropped.items():
            yield f"dropped: {name}, in {count:,} records"
        if self.poses_without_angles:
            yield (
                f"{self.poses_without_angles:,} poses come without heading and elevation; both "
                "are written as 0"
            )


def convert(submission: Submission) -> Conversion:
    """Read a submission in any form and put it in the official one.

    Nothing is checked against a split: any ids and viewpoints will do.

    Raises
    ------
    SubmissionError
        If it cannot be read; lists every problem with its place.
    OSError
        If the file cannot be read.
    """
    document = read_document(submission)
    found = Findings()
    records = read_each(document, found)
    if found.problems:
        raise SubmissionError(found.problems)
    originals = document.values() if isinstance(document, Mapping) else document
    fields = Counter(field for original in originals for field in original)
    poses = [pose for record in records for pose in record.poses]
    return Conversion(
        records=[_official(record) for record in records],
        read_as=found.read_as(),
        dropped={name: count for name, count in fields.items() if name not in FIELDS},
        poses_without_angles=sum(pose.heading is None for pose in poses),
    )


def _official(record: ReadRecord) -> dict[str, Any]:
    return {
        "instr_id": record.instr_id,
        "trajectory": [_full_pose(pose) for pose in record.poses],
        "predObjId": record.answer.object_id,
    }


def _full_pose(pose: Pose) -> list[str | float | None]:
    return [pose.viewpoint_id, float(pose.heading or 0), float(pose.elevation or 0)]
