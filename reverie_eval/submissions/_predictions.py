"""What reading a submission gives: its content as columns, with what there is to say about it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, TypeAlias, TypeVar

import numpy as np

from reverie_eval.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    in_parts,
    last_of,
    offsets_of,
    take_rows,
)
from reverie_eval.errors import Problem
from reverie_eval.geometry import snap
from reverie_eval.metrics import ABSTAINED
from reverie_eval.submissions._problems import PoseLocation, RecordLocation
from reverie_eval.submissions._sources import Source

Records: TypeAlias = Sequence[Mapping[str, Any]] | Mapping[str, Mapping[str, Any]]
"""Records as Python objects, in a list or keyed by their instr_id."""

Submission: TypeAlias = Source | Records
"""What can be scored: a file, its content, or its records as Python objects."""

Content: TypeAlias = tuple[object, ...]
"""What a record predicts, for comparison with another record."""

MOST = 0.5
"""Share of answers or angles above which something is probably a mistake; in good submissions the
share is far lower."""


Id = TypeVar("Id")


class Numbering(dict[Id, int]):
    """Numbers ids in the order in which they are first asked for."""

    def __missing__(self, each: Id) -> int:
        number = self[each] = len(self)
        return number

    def numbers(self, ids: Iterable[Id]) -> IntArray:
        """Return the number of each id."""
        # `map` looks up from C: no Python frame for each of a hundred thousand poses.
        return np.fromiter(map(self.__getitem__, ids), np.int64)

    @staticmethod
    def columns(ids: Iterable[str | None]) -> Mapping[str, Any]:
        """Return ids of viewpoints as the columns of :class:`Predictions` that hold them."""
        numbering = Numbering[str | None]()
        number = numbering.numbers(ids)
        # A dictionary keeps the order in which ids were added, so each id is at the index of its
        # number.
        return {"viewpoint": number, "distinct_ids": list(numbering)}


@dataclass(frozen=True, slots=True)
class Signs:
    """What the form of a file's records says about the task that it is of."""

    id_key: str = "instr_id"
    """The field with the id of every record; empty if they differ."""
    has_items: bool = False
    """Whether every trajectory is an object with a path, or a list of such objects."""
    has_points: bool = False
    """Whether some of these have points, or a record has several of them."""
    has_answers: bool = False
    """Whether some record predicts an object or a box."""
    numbered: frozenset[int] = frozenset()
    """The rows of ids that are numbers, in a task whose ids are text."""


@dataclass(frozen=True, eq=False)
class BoxAnswers:
    """The predicted boxes, one row each."""

    row: IntArray
    """Shape (n_boxes,): the record of each box, or after alignment its episode; ascending."""
    xywh: FloatArray
    """Shape (n_boxes, 4): pixels of a 640 x 480 image, cut to it; area 0 if it was outside."""
    camera: FloatArray
    """Shape (n_boxes, 2): heading and elevation of the camera, radians."""
    is_cut: BoolArray
    """Shape (n_boxes,): whether the box reached beyond the image before it was cut."""
    uncut_xywh: FloatArray
    """Shape (n_boxes, 4): ``xywh`` before it was cut; only hints use it."""
    stop_angles: FloatArray
    """Shape (n_boxes, 2): heading and elevation of the last pose, radians; NaN if the file gives
    none. Only hints use it."""

    @cached_property
    def view(self) -> IntArray:
        """Shape (n_boxes,): the view that each camera snaps to."""
        return snap(self.camera)

    def take(self, rows: IntArray) -> "BoxAnswers":
        """Return some of the boxes, in the given order."""
        # `take` needs a tenth of the time of an index in brackets, for columns of several numbers.
        return BoxAnswers(*(getattr(self, field.name).take(rows, axis=0) for field in fields(self)))

    @classmethod
    def concatenate(cls, parts: "Sequence[BoxAnswers]") -> "BoxAnswers":
        """Return the boxes of several parts, one after the other."""
        columns = ([getattr(part, field.name) for part in parts] for field in fields(cls))
        return cls(*map(np.concatenate, columns))


NO_BOXES = BoxAnswers(
    np.zeros(0, dtype=np.int64),
    np.zeros((0, 4)),
    np.zeros((0, 2)),
    np.zeros(0, dtype=np.bool_),
    np.zeros((0, 4)),
    np.zeros((0, 2)),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class SubmissionColumns:
    """Trajectories and answers: a row per record, or after alignment per episode of the split."""

    viewpoint: IntArray
    """Shape (n_poses,): the index of each pose's viewpoint, trajectory after trajectory."""
    offsets: IntArray
    """Shape (n + 1,): where each trajectory begins in ``viewpoint``."""
    predicted_object: IntArray
    """Shape (n,): the object id of each answer, or -1."""
    answer_is_text: BoolArray
    """Shape (n,): whether the object id is written as text."""
    has_leading_zeros: BoolArray
    """Shape (n,): whether that text has leading zeros."""
    boxes: BoxAnswers = NO_BOXES
    """The predicted boxes, in the order of their rows."""
    is_navigation_only: bool = False
    """Whether no record has an answer."""
    point: FloatArray | None = None
    """Shape (n, 2): heading and elevation of each predicted point, in turns, or NaN for no point.
    None in a task without points."""

    @property
    def stop(self) -> IntArray:
        """Shape (n,): the index of the last viewpoint of each trajectory; none is empty."""
        return self.viewpoint[last_of(self.offsets)]

    @property
    def abstained(self) -> BoolArray:
        """Shape (n,): whether the answer predicts neither an object nor a box."""
        abstained = np.equal(self.predicted_object, ABSTAINED)
        # An answer with a box has the object id -1.
        abstained[self.boxes.row] = False
        return abstained

    def take(self, rows: IntArray) -> "SubmissionColumns":
        """Return some of the rows, in the given order."""
        box = np.full(len(self.predicted_object), -1)  # of rows without one
        box[self.boxes.row] = np.arange(len(self.boxes.row))
        has_box = np.flatnonzero(box[rows] >= 0)
        return SubmissionColumns(
            viewpoint=in_parts(lambda part: self.viewpoint[take_rows(part, self.offsets)], rows),
            offsets=offsets_of(np.diff(self.offsets)[rows]),
            predicted_object=self.predicted_object[rows],
            answer_is_text=self.answer_is_text[rows],
            has_leading_zeros=self.has_leading_zeros[rows],
            boxes=replace(self.boxes.take(box[rows[has_box]]), row=has_box),
            is_navigation_only=self.is_navigation_only,
            point=None if self.point is None else self.point[rows],
        )

    @classmethod
    def concatenate(cls, parts: Sequence["SubmissionColumns"]) -> "SubmissionColumns":
        """Return the rows of several submissions, one after the other."""
        counts = offsets_of(np.array([len(part.predicted_object) for part in parts]))[:-1]
        boxes = [
            replace(part.boxes, row=part.boxes.row + count)
            for part, count in zip(parts, counts, strict=True)
        ]
        points = [part.point for part in parts if part.point is not None]
        return cls(
            viewpoint=np.concatenate([part.viewpoint for part in parts]),
            offsets=offsets_of(np.concatenate([np.diff(part.offsets) for part in parts])),
            predicted_object=np.concatenate([part.predicted_object for part in parts]),
            answer_is_text=np.concatenate([part.answer_is_text for part in parts]),
            has_leading_zeros=np.concatenate([part.has_leading_zeros for part in parts]),
            boxes=BoxAnswers.concatenate(boxes),
            is_navigation_only=all(part.is_navigation_only for part in parts),
            point=np.concatenate(points) if points else None,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Predictions(SubmissionColumns):
    """A submission as it was read: one row per record that could be, in the order of the file.

    The defaults are those of a file in the plain official form.
    """

    instr_ids: Sequence[str | None]
    """None for an id that could not be read; ``problems`` says why."""
    distinct_ids: Sequence[str | None]
    """The viewpoint ids, each once, that ``viewpoint`` indexes; None if one could not be read."""
    has_degrees: bool
    """Whether most angles look like degrees."""
    locate: Callable[[int], RecordLocation] | None = None
    """Returns the location of a record in the file, by its row; None for a list of records."""
    pose_locations: Sequence[PoseLocation] | IntArray | None = None
    """The location of each pose in its trajectory, or an array with -1 for what it lacks."""
    continues_hop: BoolArray | None = None
    """Shape (n_poses,): whether evaluators that read only the first viewpoint of each hop miss the
    pose."""
    read_as: Sequence[str] = ()
    """How the file differs from the official form, a phrase each."""
    ignored_fields: Mapping[str, int] = field(default_factory=dict)
    """The fields that are not read, with the number of records that have them."""
    differences: Mapping[str, int] = field(default_factory=dict)
    """How often each difference from the official form occurs, by its key."""
    problems: Sequence[Problem] = ()
    """What could not be read."""
    signs: Signs = Signs()

    @property
    def has_long_hops(self) -> bool:
        """Whether a hop has several viewpoints, of which some evaluators read only the first."""
        return self.continues_hop is not None and bool(self.continues_hop.any())

    @property
    def viewpoint_ids(self) -> Sequence[str | None]:
        """The viewpoint id of every pose, trajectory after trajectory."""
        return list(map(self.distinct_ids.__getitem__, self.viewpoint.tolist()))

    def viewpoint_id(self, pose: int) -> str | None:
        """Return the viewpoint id of a pose."""
        return self.distinct_ids[int(self.viewpoint[pose])]

    def location(self, record: int) -> RecordLocation:
        """Return the location of a record in the file."""
        if self.locate is None:
            return RecordLocation(record, id_key=self.signs.id_key)
        return self.locate(record)

    def pose_location(self, record: int, pose: int) -> PoseLocation:
        """Return the location of a pose in its trajectory.

        Poses are numbered over all records.
        """
        if self.pose_locations is None:
            return pose - int(self.offsets[record]), 0
        return tuple(int(index) for index in self.pose_locations[pose] if index >= 0)

    def content(self, record: int) -> Content:
        """Return what a record predicts, for comparison with another record."""
        # Compared as lists and bytes: of arrays, `==` gives an array, and NaN does not equal NaN.
        begin, end = self.offsets[record : record + 2]
        box = slice(*np.searchsorted(self.boxes.row, [record, record + 1]))
        return (
            [self.distinct_ids[number] for number in self.viewpoint[begin:end].tolist()],
            int(self.predicted_object[record]),
            self.boxes.xywh[box].tolist(),
            self.boxes.camera[box].tolist(),
            None if self.point is None else self.point[record].tobytes(),
        )

    def first_of_hops(self) -> "Predictions":
        """Return the predictions as read by an evaluator that takes only the first of each hop."""
        if self.continues_hop is None or self.pose_locations is None:
            return self
        begins_hop = ~self.continues_hop
        poses = np.flatnonzero(begins_hop).tolist()
        # No trajectory is empty, so `reduceat` sums each one by itself.
        lengths = np.add.reduceat(begins_hop, self.offsets[:-1], dtype=np.int64)
        return replace(
            self,
            viewpoint=self.viewpoint[poses],
            offsets=offsets_of(lengths),
            pose_locations=[self.pose_location(-1, pose) for pose in poses],
            continues_hop=self.continues_hop[poses],
        )

    def without_trajectories(self) -> "Predictions":
        """Return only the answers."""
        offsets = np.zeros_like(self.offsets)
        none = self.viewpoint[:0]
        return replace(
            self,
            viewpoint=none,
            distinct_ids=(),
            offsets=offsets,
            has_degrees=False,
            pose_locations=None,
            continues_hop=None,
        )


def look_like_degrees(stop_angles: FloatArray) -> bool:
    """Whether most headings or elevations of last poses exceed a full turn in radians.

    ``stop_angles`` has shape (n_records, 2), with NaN where the file gives none.
    """
    # NaN exceeds nothing. Sums of turns in radians may exceed a full turn too, but not most of
    # them.
    exceeding = np.logical_or(*(np.abs(stop_angles) > 2 * np.pi).T).sum()
    return bool(exceeding > MOST * len(stop_angles))
