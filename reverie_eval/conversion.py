"""Convert a submission from any readable form to the official one."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from reverie_eval.errors import SubmissionError
from reverie_eval.reading import Submission
from reverie_eval.reading.boxes import BOX_KEY, IMAGE_SIZE_KEY, VIEW_KEY
from reverie_eval.reading.document import read_document
from reverie_eval.reading.findings import Findings
from reverie_eval.reading.records import FIELDS, ReadRecord, read_each
from reverie_eval.reading.trajectories import Pose


@dataclass(frozen=True, slots=True)
class Conversion:
    """A submission in the official form, and what it took to get there."""

    records: Sequence[Mapping[str, Any]]
    """``instr_id``, ``trajectory`` of full poses, ``predObjId`` as a number or ``predBox`` with its
    view and size of picture, and nothing else."""
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
    originals = list(document.values() if isinstance(document, Mapping) else document)
    fields = Counter(field for original in originals for field in original)
    poses = [pose for record in records for pose in record.poses]
    return Conversion(
        records=list(map(_official, records, originals)),
        read_as=found.read_as(),
        dropped={name: count for name, count in fields.items() if name not in FIELDS},
        poses_without_angles=sum(pose.heading is None for pose in poses),
    )


def _official(record: ReadRecord, original: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "instr_id": record.instr_id,
        "trajectory": [_full_pose(pose) for pose in record.poses],
        **_official_answer(record, original),
    }


def _official_answer(record: ReadRecord, original: Mapping[str, Any]) -> dict[str, Any]:
    if record.answer.box is None:
        return {"predObjId": record.answer.object_id}
    answer: dict[str, Any] = {BOX_KEY: list(map(float, original[BOX_KEY]))}
    if original.get(VIEW_KEY) is not None:
        answer[VIEW_KEY] = int(original[VIEW_KEY])
    if original.get(IMAGE_SIZE_KEY) is not None:
        answer[IMAGE_SIZE_KEY] = list(map(float, original[IMAGE_SIZE_KEY]))
    return answer


def _full_pose(pose: Pose) -> list[str | float | None]:
    return [pose.viewpoint_id, float(pose.heading or 0), float(pose.elevation or 0)]
