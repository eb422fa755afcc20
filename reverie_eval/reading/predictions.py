"""Predictions: what a submission says, in columns, not yet held against any ground truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from reverie_eval.arrays import BoolArray, FloatArray, IntArray, offsets_of
from reverie_eval.errors import Problem
from reverie_eval.reading.findings import Place, PosePath
from reverie_eval.reading.sources import Source

Records: TypeAlias = Sequence[Mapping[str, Any]] | Mapping[str, Mapping[str, Any]]
"""Records as Python objects, in a list or keyed by their instr_id."""

Submission: TypeAlias = Source | Records
"""What can be scored: where a file is, its content, or its records as Python objects."""

ID_PREFIX = "reverie_"
"""What NaviLLM puts before ids while it mixes datasets; no part of the id."""


@dataclass(frozen=True, eq=False)
class BoxAnswers:
    """The answers that are boxes, one row each."""

    row: IntArray
    """Shape (n_boxes,): which record, or after alignment which episode, is answered so."""
    xywh: FloatArray
    """Shape (n_boxes, 4): pixels of a 640 x 480 picture, within it; area 0 if drawn outside."""
    camera: FloatArray
    """Shape (n_boxes, 2): heading and elevation that the picture was taken to, radians."""
    is_cut: BoolArray
    """Shape (n_boxes,): whether the box reached beyond the picture before it was cut."""

    def take(self, rows: IntArray) -> "BoxAnswers":
        """Return some of the boxes, in the given order."""
        return BoxAnswers(self.row[rows], self.xywh[rows], self.camera[rows], self.is_cut[rows])


NO_BOXES = BoxAnswers(
    np.zeros(0, dtype=np.int64), np.zeros((0, 4)), np.zeros((0, 2)), np.zeros(0, dtype=np.bool_)
)


@dataclass(frozen=True, eq=False)
class Predictions:
    """One row per record that could be read, in the order of the file."""

    instr_ids: Sequence[str | None]
    """None where it could not be read, which ``problems`` tells."""
    viewpoint_ids: Sequence[str | None]
    """Every pose's viewpoint, trajectory after trajectory; None as above."""
    offsets: IntArray
    """Shape (n_records + 1,): where each trajectory begins in ``viewpoint_ids``."""
    predicted_object: IntArray
    """Shape (n_records,): the object that each answer names, or -1."""
    stop_angles: FloatArray
    """Shape (n_records, 2): heading and elevation of the last pose, radians; NaN if not given."""
    aside: "Aside | None" = None
    """What else there is to know of a file that is not in the plain official form."""
    problems: Sequence[Problem] = ()
    """What could not be read."""

    @property
    def read_as(self) -> Sequence[str]:
        """What was read although it is not the official form, a phrase each."""
        return self.aside.read_as if self.aside else ()

    @property
    def answer_is_text(self) -> BoolArray:
        """Shape (n_records,): whether the object id is written as text."""
        is_number = np.zeros(len(self.instr_ids), dtype=np.bool_)
        return self.aside.answer_is_text if self.aside else is_number

    @property
    def boxes(self) -> "BoxAnswers":
        """The answers that are boxes."""
        return self.aside.boxes if self.aside else NO_BOXES

    def place(self, record: int) -> Place:
        """Return where a record is in the file."""
        return self.aside.places[record] if self.aside else Place(record)

    def pose_path(self, record: int, pose: int) -> PosePath:
        """Return where a pose of the record, counted over all records, is in its trajectory."""
        return self.aside.pose_paths[pose] if self.aside else (pose - int(self.offsets[record]), 0)

    def first_of_hops(self) -> "Predictions":
        """Return what a reader of each hop's first viewpoint alone would see."""
        if self.aside is None:
            return self
        kept = np.flatnonzero(~self.aside.continues_hop)
        lengths = np.add.reduceat(~self.aside.continues_hop, self.offsets[:-1], dtype=np.int64)
        return replace(
            self,
            viewpoint_ids=[self.viewpoint_ids[pose] for pose in kept.tolist()],
            offsets=offsets_of(lengths),
            aside=replace(
                self.aside,
                pose_paths=[self.aside.pose_paths[pose] for pose in kept.tolist()],
                continues_hop=self.aside.continues_hop[kept],
            ),
        )


@dataclass(frozen=True, eq=False)
class Aside:
    """What the columns of predictions do not say, and the official form does not need."""

    places: Sequence[Place]
    """Where each record is in the file."""
    pose_paths: Sequence[PosePath]
    """Where each pose is in its trajectory."""
    continues_hop: BoolArray
    """Shape (n_poses,): whether a reader of each hop's first viewpoint would miss the pose."""
    answer_is_text: BoolArray
    """Shape (n_records,): whether the object id is written as text."""
    boxes: BoxAnswers
    read_as: Sequence[str]
    """What was read although it is not the official form, a phrase each."""
