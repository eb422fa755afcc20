"""Snapshots: numbered, signed states of a leaderboard, which never change.

The organiser can take one at any time. When a phase has ended, the server takes one before it
writes anything else, so it shows the leaderboard exactly as it was when the phase ended, even if it
is taken much later. If that fails, writing goes on. It is tried again, and still exact, until
something is logged that may change a leaderboard; from then on, no snapshot is taken, nor for a
phase that received nothing, or whose end was set after it had passed.
"""

import logging
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from functools import partial
from typing import Self

from sqlalchemy import func, select
from sqlalchemy.orm import Session, load_only

from reverie_eval.errors import ReverieEvalError
from reverie_eval.schemas.organising import NewSnapshot
from reverie_eval.schemas.service import Envelope, Leaderboard, Snapshot, SnapshotEntry
from reverie_eval.server.audit.log import INSPECTED, SERVER
from reverie_eval.server.audit.transactions import Transaction, Transactions
from reverie_eval.server.boards.entries import EntriesCache, count_submissions
from reverie_eval.server.boards.leaderboard import as_json, leaderboard
from reverie_eval.server.boards.news import corrections_of
from reverie_eval.server.boards.schedules import SCHEDULE_SET, Schedules
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.scoring.boards import Board, find_board
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import is_unreachable
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import (
    IS_CHANGE,
    SAME_FILE,
    SNAPSHOT_TAKEN,
    UPLOAD_DELETED,
    AuditEntry,
    StoredSnapshot,
    Submission,
    read_stored,
)

_ENTRIES = select(StoredSnapshot).options(
    load_only(
        StoredSnapshot.split,
        StoredSnapshot.number,
        StoredSnapshot.title,
        StoredSnapshot.as_of,
        raiseload=True,
    )
)
"""Without the envelope, which has the whole leaderboard."""
_LOGGER = logging.getLogger("reverie_eval.server")


@dataclass(frozen=True, slots=True)
class Closing:
    """A phase that has ended."""

    split: str
    phase: str
    at: datetime
    """The first instant after it."""


class SnapshotError(ReverieEvalError):
    """The snapshot of a phase that has ended cannot be taken."""

    def __init__(self, closing: Closing, cause: Exception) -> None:
        super().__init__(
            f"the snapshot of {closing.split} at the end of phase {closing.phase!r} cannot be "
            f"taken ({type(cause).__name__}); `server doctor` finds damaged rows"
        )


@dataclass(frozen=True)
class Snapshots:
    """Takes and finds snapshots."""

    boards: Callable[[], Mapping[str, Board]]
    """Loads the ground truth, if it is needed."""
    schedules: Schedules
    organiser: str
    """The public name that reviews in a snapshot are signed with."""
    _done: set[Closing] = field(default_factory=set, init=False)
    """Closings whose snapshots are stored, or will never be taken."""
    _failed: dict[Closing, SnapshotError] = field(default_factory=dict, init=False)
    """Closings whose snapshots could not be taken; only :meth:`take_if_due` tries again."""

    @classmethod
    def of(cls, server: ServerState) -> Self:
        """Return the snapshots of a server."""
        return cls(lambda: server.boards, server.get(Schedules), server.settings.organiser)

    def take(self, transaction: Transaction, new: NewSnapshot) -> SnapshotEntry:
        """Take a snapshot of a leaderboard as it is now.

        Raises NotFoundError if there is no such split.
        """
        return self._take(transaction, new.split, new.title, transaction.now)

    def take_due(self, transaction: Transaction) -> None:
        """Take the snapshots of all phases that have ended, before anything else is changed.

        What fails is only logged, because the change may have nothing to do with it. But without a
        connection to the database, the change cannot be made either.
        """
        session, actor = transaction.session, transaction.as_actor(SERVER)
        try:
            due = self.due(session, transaction.now, self._failed)
        except Exception as error:  # whatever it is, the change goes on
            if is_unreachable(error):
                raise
            _LOGGER.warning("the schedules cannot be read: %s", type(error).__name__)
            return
        for closing in due:
            try:
                with session.begin_nested():
                    self._take(actor, closing.split, closing.phase, closing.at, closing)
            except Exception as error:
                if is_unreachable(error):
                    raise
                self._failed[closing] = failure = SnapshotError(closing, error)
                _LOGGER.warning("%s", failure)

    def take_if_due(self, transactions: Transactions) -> None:
        """Take the snapshots of all phases that have ended, also if that has failed before.

        Raises SnapshotError if one of them cannot be taken.
        """
        with transactions.database.reading() as session:
            is_due = bool(self.due(session, transactions.clock()))
        self._failed.clear()
        if is_due:
            with transactions.begin(SERVER):
                pass  # they are taken first
        for failure in [*self._failed.values()]:
            raise failure

    def due(
        self, session: Session, now: datetime, but: Collection[Closing] = ()
    ) -> Sequence[Closing]:
        """Return the closings whose snapshots are still to be taken, the earliest first."""
        ended = {*self._ended(session, now)} - self._done - {*but}
        due = [each for each in _lacking(session, ended) if not _is_changed(session, each)]
        self._done.update(ended.difference(due))
        return due

    def missed(self, session: Session, now: datetime) -> Sequence[Closing]:
        """Return the closings whose leaderboard may have changed before a snapshot was taken.

        They are left out once there is a later snapshot of the split.
        """
        lacking = _lacking(session, set(self._ended(session, now)))
        return [
            each
            for each in lacking
            if _is_changed(session, each) and not _has_later_snapshot(session, each)
        ]

    def _ended(self, session: Session, now: datetime) -> Iterator[Closing]:
        for split, schedule in self.schedules.in_effect(session).items():
            for phase in schedule.phases:
                if phase.last_moment is not None and phase.last_moment < now:
                    yield Closing(split, phase.name, phase.last_moment + timedelta.resolution)

    def _take(
        self,
        transaction: Transaction,
        split: str,
        title: str,
        as_of: datetime,
        closing: Closing | None = None,
    ) -> SnapshotEntry:
        session, board = transaction.session, find_board(self.boards(), split)
        entries = EntriesCache(self.schedules).entries(session, board, as_of)
        ranking = replace(
            leaderboard(board, entries, board.primary.key, as_of),
            counts=count_submissions(session, split, closing.at if closing else None),
        )
        corrections = corrections_of(session, board)
        last = select(func.max(StoredSnapshot.number)).where(StoredSnapshot.split == split)
        signer = transaction.audit_log.signer
        snapshot = Snapshot(
            server=signer.server,
            split=split,
            number=(session.scalar(last) or 0) + 1,
            title=title,
            as_of=as_of,
            leaderboard=Leaderboard.model_validate_json(
                as_json(ranking, corrections, self.organiser)
            ),
        )
        row = StoredSnapshot(
            split=split,
            number=snapshot.number,
            title=title,
            phase=closing and closing.phase,
            as_of=as_of,
            envelope=signer.sign(snapshot).model_dump(mode="json"),
            created_at=transaction.now,
        )
        transaction.record(
            SNAPSHOT_TAKEN, row, split, number=row.number, title=title, as_of=as_of.isoformat()
        )
        return SnapshotEntry.model_validate(row)


def _taken(session: Session) -> set[Closing]:
    """Return the closings that have a snapshot."""
    chosen = select(StoredSnapshot.split, StoredSnapshot.phase, StoredSnapshot.as_of)
    rows = session.execute(chosen.where(StoredSnapshot.phase.is_not(None)))
    return {Closing(split, phase or "", as_of) for split, phase, as_of in rows}


def _lacking(session: Session, ended: set[Closing]) -> Sequence[Closing]:
    """Return the closings that have no snapshot, though their phases received something."""
    lacking = ended - _taken(session) if ended else ended
    if lacking:
        received = _first_received(session)
        lacking = {each for each in lacking if received.get(each.split, each.at) < each.at}
    return sorted(lacking, key=lambda closing: (closing.at, closing.split))


def _is_changed(session: Session, closing: Closing) -> bool:
    """Whether a leaderboard may have changed after a phase.

    Uploads do not change it, nor does deleting or inspecting the files of submissions.
    """
    is_later = AuditEntry.at > closing.at
    # At that moment, the phase itself may have been closed by hand.
    is_another = (AuditEntry.at == closing.at) & (AuditEntry.action != SCHEDULE_SET)
    changes = select(AuditEntry.id).where(
        is_later | is_another,
        IS_CHANGE,
        AuditEntry.action.not_in((SAME_FILE, SNAPSHOT_TAKEN, UPLOAD_DELETED, INSPECTED)),
    )
    return session.scalars(changes.limit(1)).first() is not None


def _has_later_snapshot(session: Session, closing: Closing) -> bool:
    later = select(StoredSnapshot.id).where(
        StoredSnapshot.split == closing.split, StoredSnapshot.as_of >= closing.at
    )
    return session.scalars(later.limit(1)).first() is not None


def _first_received(session: Session) -> Mapping[str, datetime]:
    """Return when the first submission to each split was received."""
    first = select(Submission.split, func.min(Submission.received_at)).group_by(Submission.split)
    rows = session.execute(first)
    return {split: moment for split, moment in rows}  # noqa: C416  # mypy does not accept rows as pairs


def list_snapshots(session: Session, page: Page, split: str | None = None) -> Listed[SnapshotEntry]:
    """List the snapshots of a split, or of all; the latest first."""
    rows, key, report = _ENTRIES, StoredSnapshot.id, partial(read_stored, SnapshotEntry)
    if split is not None:
        # Numbers rise like ids, and the index has them by split.
        rows, key = rows.where(StoredSnapshot.split == split), StoredSnapshot.number
    return list_page(session, rows, key, page, report, newest_first=True)


def snapshot_of(session: Session, split: str, number: int) -> Envelope:
    """Return a signed snapshot. Raises NotFoundError if none has this number."""
    chosen = select(StoredSnapshot.envelope).where(
        StoredSnapshot.split == split, StoredSnapshot.number == number
    )
    envelope = session.scalar(chosen)
    if envelope is None:
        raise NotFoundError(f"there is no snapshot {number} of {split!r}")
    return read_stored(Envelope, envelope)
