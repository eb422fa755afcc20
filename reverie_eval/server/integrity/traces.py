"""Traces: an upload's predictions in each episode as numbers that are quick to compare.

They are computed without the solution, from the upload alone. Each is stored when it is first
needed, so they do not make uploads slower.
"""

import gzip
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import msgspec
import numpy as np
from isal import igzip
from sqlalchemy import ColumnElement, Select, and_, delete, insert, select
from sqlalchemy.orm import Session

from reverie_eval.arrays import Array, FloatArray, IntArray, last_of, row_of
from reverie_eval.errors import SubmissionError
from reverie_eval.metrics import jumps
from reverie_eval.scoring import Lookups, PreparedSubmission
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.scoring.contexts import Context, Scoring
from reverie_eval.server.store.database import Database
from reverie_eval.server.store.tables import Submission
from reverie_eval.server.store.tables import Trace as Row
from reverie_eval.server.store.uploads import UploadsError, stored_upload
from reverie_eval.submissions import SubmissionColumns

_EPISODE = np.dtype(
    [
        ("answer", "<i8"),
        ("stop", "<i4"),
        ("path", "<u4"),
        ("is_text", "?"),
        ("has_leading_zeros", "?"),
        ("is_box", "?"),
    ]
)
_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
"""An odd number whose bits have no pattern: 2^64 divided by the golden ratio."""
_LOADED_AT_ONCE = 100
"""Rows in memory while those of all submissions are read."""
_NONE: Mapping[str, bytes] = MappingProxyType({})


class Walks(NamedTuple):
    """What is unusual in the trajectories of a submission."""

    jumps: int
    """Moves between unconnected viewpoints."""
    episodes_with_jumps: int
    longest_jump: float
    """Metres along the graph."""
    mean_viewpoints: float
    """Different viewpoints in a trajectory, on average."""
    most_viewpoints: int
    longest_walk: float
    """Metres."""


@dataclass(frozen=True, eq=False)
class Trace:
    """The predictions of an upload."""

    episodes: Array
    """Shape (n_episodes,): the answer, the stop and the path of each episode, as numbers."""
    walks: Walks

    @classmethod
    def of(cls, board: Board, content: bytes) -> Self:
        """Compute the trace of a JSON text.

        Raises SubmissionError if it does not fit the split.
        """
        aligned = board.check(content).submission
        episodes = np.zeros(len(aligned.predicted_object), dtype=_EPISODE)
        episodes["answer"] = aligned.predicted_object
        episodes["is_text"] = aligned.answer_is_text
        episodes["has_leading_zeros"] = aligned.has_leading_zeros
        boxes = aligned.boxes
        drawn = np.column_stack([boxes.xywh, boxes.camera])
        episodes["answer"][boxes.row] = [zlib.crc32(row.tobytes()) for row in drawn]
        episodes["is_box"][boxes.row] = True
        episodes["stop"] = aligned.viewpoint[last_of(aligned.offsets)]
        episodes["path"] = _path_codes(aligned)
        return cls(episodes, _walks(aligned, Lookups(aligned, board.truth)))

    @classmethod
    def from_bytes(cls, content: bytes) -> Self:
        """Unpack a trace."""
        walks, episodes = msgspec.msgpack.decode(gzip.decompress(content), type=tuple[Walks, bytes])
        return cls(np.frombuffer(episodes, dtype=_EPISODE), walks)

    def to_bytes(self) -> bytes:
        """Pack the trace."""
        return igzip.compress(msgspec.msgpack.encode((self.walks, self.episodes.tobytes())))

    def equal(self, other: Self, *fields: str) -> float:
        """Return the share of episodes in which all of these fields are equal."""
        alike = [self.episodes[name] == other.episodes[name] for name in fields]
        return float(np.logical_and.reduce(alike).mean())

    @property
    def codes(self) -> IntArray:
        """Shape (n_episodes,): numbers that are equal if answer and stop are equal."""
        mixed = self.episodes["answer"].astype(np.uint64) * _MULTIPLIER
        mixed = (mixed ^ self.episodes["stop"].astype(np.uint64)) * _MULTIPLIER
        return (mixed >> np.uint64(32)).astype(np.uint32)

    def values(self, board: Board, metric: str) -> FloatArray | None:
        """Return ``success`` or ``rgs`` of every episode; None if it cannot be computed from this.

        Boxes cannot be scored without their views.
        """
        truth, track = board.truth, board.settings.track
        if metric == "rgs" and self.episodes["is_box"].any():
            return None
        stop = truth.require_solution().goal if track == "grounding" else self.episodes["stop"]
        answer = self.episodes["answer"]
        aligned = SubmissionColumns(
            viewpoint=stop.astype(np.int64),
            offsets=np.arange(len(stop) + 1),
            predicted_object=answer,
            answer_is_text=self.episodes["is_text"],
            has_leading_zeros=self.episodes["has_leading_zeros"],
            is_navigation_only=bool((answer == -1).all()),
        )
        reading = PreparedSubmission(aligned, truth, track)
        return board.score(reading).episodes.get(metric)


def _path_codes(aligned: SubmissionColumns) -> IntArray:
    """Return a number for each trajectory; numbers of different ones nearly always differ."""
    begin = aligned.offsets[:-1]
    step = np.arange(len(aligned.viewpoint)) - begin[row_of(aligned.offsets)]
    mixed = (aligned.viewpoint.astype(np.uint64) + np.uint64(1)) * _MULTIPLIER
    mixed = (mixed ^ (mixed >> np.uint64(29))) * (2 * step.astype(np.uint64) + np.uint64(3))
    return np.add.reduceat(mixed * _MULTIPLIER, begin) >> np.uint64(32)


def _walks(aligned: SubmissionColumns, lookups: Lookups) -> Walks:
    is_jump, row = lookups.is_jump, row_of(aligned.offsets)
    number = jumps(is_jump, aligned.offsets)
    pairs = np.unique(np.column_stack([row, aligned.viewpoint]), axis=0)
    different = np.bincount(pairs[:, 0])
    return Walks(
        jumps=int(number.sum()),
        episodes_with_jumps=int((number > 0).sum()),
        longest_jump=float(lookups.leg_length[is_jump].max(initial=0.0)),
        mean_viewpoints=float(different.mean()),
        most_viewpoints=int(different.max()),
        longest_walk=float(np.bincount(row, lookups.leg_length).max()),
    )


def trace_of(context: Context, split: str, sha256: str) -> bytes:
    """Return the packed trace of a stored upload."""
    content = stored_upload(context.uploads, sha256)
    return Trace.of(context.boards[split], content).to_bytes()


class Read(NamedTuple):
    """What was read of some uploads."""

    contents: Mapping[str, bytes]
    """Packed traces, by the SHA-256 of the upload."""
    unreadable: Mapping[str, str]
    """Why others have none."""


@dataclass(frozen=True, slots=True)
class Traces:
    """The stored traces of a split."""

    board: Board
    database: Database
    scoring: Scoring

    @property
    def basis(self) -> str:
        """What the numbers in a trace depend on."""
        episodes = len(self.board.truth.episodes.instr_ids)  # protocols may leave some out
        return f"{self.board.settings.track}:{self.board.public_fingerprint}:{episodes}"

    def marked(
        self, session: Session, submissions: Select[*tuple[Any, ...]]
    ) -> Iterator[tuple[Any, bool]]:
        """Yield submissions, in their order, each with whether its upload has a trace."""
        for row in session.execute(self._joined(submissions).add_columns(Row.sha256.is_not(None))):
            yield row[:-1], row[-1]

    def read(self, digests: Sequence[str], most: int) -> "Read":
        """Compute the traces of uploads; of ``most`` uploads, at most."""
        contents: dict[str, bytes] = {}
        unreadable: dict[str, str] = {}
        for sha256 in digests:
            if len(contents) == most:
                break
            try:
                contents[sha256] = self.scoring.run(trace_of, self.board.split, sha256)
            except SubmissionError as error:
                unreadable[sha256] = f"rejected: {error.problems[0]}"
            except UploadsError as error:
                unreadable[sha256] = str(error)
        return Read(contents, unreadable)

    def store(self, contents: Mapping[str, bytes]) -> None:
        """Store traces that were computed, in one transaction.

        It is not that of a request's snapshot, which only reads, and it comes after that: to wait
        for the turn to write with a connection in hand could stop all other requests.
        """
        if not contents:
            return
        known = {"split": self.board.split, "basis": self.basis}
        rows = [
            {**known, "sha256": sha256, "content": content} for sha256, content in contents.items()
        ]
        with self.database.writing() as session:
            # Of another bundle, or of a request that computed them at the same time.
            session.execute(delete(Row).where(self._is_of(contents)))
            session.execute(insert(Row), rows)

    def of_each(
        self, session: Session, submissions: Select[*tuple[Any, ...]], read: Mapping[str, bytes]
    ) -> Iterator[tuple[Any, Trace]]:
        """Yield the submissions whose uploads have a trace, in their order, each with it.

        ``read`` are those that the request has computed. The others are loaded by one statement,
        few at a time.
        """
        rows = self._joined(submissions).add_columns(Row.content)
        for row in session.execute(rows.execution_options(yield_per=_LOADED_AT_ONCE)):
            content = read.get(row.sha256, row.content)
            if content is not None:
                yield row[:-1], Trace.from_bytes(content)

    def load(
        self, session: Session, digests: Collection[str], read: Mapping[str, bytes] = _NONE
    ) -> Mapping[str, Trace]:
        """Return the traces of a few uploads; ``read`` is as in :meth:`of_each`."""
        stored = session.execute(select(Row.sha256, Row.content).where(self._is_of(digests)))
        contents = {**{row.sha256: row.content for row in stored}, **read}
        return {sha256: Trace.from_bytes(contents[sha256]) for sha256 in digests}

    def _joined(self, submissions: Select[*tuple[Any, ...]]) -> Select[*tuple[Any, ...]]:
        is_current = and_(
            Row.split == Submission.split,
            Row.sha256 == Submission.sha256,
            Row.basis == self.basis,
        )
        return submissions.outerjoin(Row, is_current)

    def _is_of(self, digests: Collection[str]) -> ColumnElement[bool]:
        return and_(Row.split == self.board.split, Row.sha256.in_(digests))
