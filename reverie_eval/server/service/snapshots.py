"""Snapshots: numbered, signed states of a leaderboard, which never change.

The organiser can take one at any time. When a phase has ended, the server takes one before it
writes anything else, so it shows the leaderboard exactly as it was when the phase ended, even if it
is taken much later. No snapshot is taken for a phase that received nothing, or whose end was set
after it had passed: by then, the leaderboard had changed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

from sqlalchemy import func, select
from sqlalchemy.orm import Session, load_only

from reverie_eval.schemas.organising import NewSnapshot
from reverie_eval.schemas.service import Leaderboard, Snapshot, SnapshotEntry
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.service.announcements import corrections_of
from reverie_eval.server.service.audit import SERVER
from reverie_eval.server.service.boards import Board, board_named
from reverie_eval.server.service.entries import EntriesCache
from reverie_eval.server.service.leaderboard import as_json, leaderboard
from reverie_eval.server.service.paging import Listed, Page, list_page
from reverie_eval.server.service.schedules import Schedules
from reverie_eval.server.service.transactions import Transaction, Transactions
from reverie_eval.server.store.tables import (
    SNAPSHOT_TAKEN,
    SUBMITTED,
    AuditEntry,
    StoredSnapshot,
    Submission,
)

_SECOND = timedelta(seconds=1)
_ENTRIES = select(StoredSnapshot).options(
    load_only(
        StoredSnapshot.split,
        StoredSnapshot.number,
        StoredSnapshot.title,
        StoredSnapshot.as_of,
        raiseload=True,
    )
)
"""Without the content, which is the whole leaderboard."""
_CHANGES_NOTHING = (SUBMITTED, SNAPSHOT_TAKEN)
"""Actions that do not change what leaderboards show."""


@dataclass(frozen=True, slots=True)
class Closing:
    """A phase that has ended."""

    split: str
    phase: str
    at: datetime
    """The first instant after it."""


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

    def take(self, transaction: Transaction, new: NewSnapshot) -> SnapshotEntry:
        """Take a snapshot of a leaderboard as it is now.

        Raises NotFoundError if there is no such split.
        """
        return self._take(transaction, new.split, new.title, transaction.now)

    def take_due(self, transaction: Transaction) -> None:
        """Take the snapshots of all phases that have ended, before anything else is changed."""
        session, actor = transaction.session, transaction.as_actor(SERVER)
        for closing in self.due(session, transaction.now):
            self._take(actor, closing.split, closing.phase, closing.at, closing)

    def take_if_due(self, transactions: Transactions) -> None:
        """Take the snapshots of all phases that have ended, if any are still to be taken."""
        with transactions.database.reading() as session:
            is_due = bool(self.due(session, transactions.clock()))
        if is_due:
            with transactions.begin(SERVER):
                pass  # they are taken first

    def due(self, session: Session, now: datetime) -> Sequence[Closing]:
        """Return the closings whose snapshots are still to be taken, the earliest first."""
        ended = {each for each in self._ended(session, now) if each not in self._done}
        if not ended:
            return []
        due = ended - _taken(session)
        if due:
            changed_at, received = _last_change(session), _first_received(session)
            due = {
                closing
                for closing in due
                if (changed_at is None or changed_at < closing.at)
                and closing.split in received
                and received[closing.split] < closing.at
            }
        self._done.update(ended - due)
        return sorted(due, key=lambda closing: (closing.at, closing.split))

    def _ended(self, session: Session, now: datetime) -> Iterator[Closing]:
        for split, schedule in self.schedules.in_effect(session).items():
            for phase in schedule.phases:
                if phase.closes is not None and phase.closes + _SECOND <= now:
                    end = phase.closes.replace(microsecond=0) + _SECOND
                    yield Closing(split, phase.name, end)

    def _take(
        self,
        transaction: Transaction,
        split: str,
        title: str,
        as_of: datetime,
        closing: Closing | None = None,
    ) -> SnapshotEntry:
        session, board = transaction.session, board_named(self.boards(), split)
        cache = EntriesCache(self.schedules)
        ranking = replace(
            leaderboard(session, cache, board, board.primary.key, as_of),
            counts=cache.submissions_of_teams(session, split),
        )
        corrections = corrections_of(session, [board])[split]
        last = select(func.max(StoredSnapshot.number)).where(StoredSnapshot.split == split)
        snapshot = transaction.audit_log.signer.sign_snapshot(
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
            content=snapshot.model_dump(mode="json"),
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


def _last_change(session: Session) -> datetime | None:
    """Return the time of the last change that leaderboards may show."""
    changes = select(AuditEntry.at).where(AuditEntry.action.not_in(_CHANGES_NOTHING))
    return session.scalar(changes.order_by(AuditEntry.id.desc()).limit(1))


def _first_received(session: Session) -> Mapping[str, datetime]:
    """Return when the first submission to each split was received."""
    first = select(Submission.split, func.min(Submission.received_at)).group_by(Submission.split)
    rows = session.execute(first)
    return {split: moment for split, moment in rows}  # noqa: C416  # mypy does not accept rows as pairs


def list_snapshots(session: Session, page: Page, split: str | None = None) -> Listed[SnapshotEntry]:
    """List the snapshots of a split, or of all; the latest first."""
    rows, key = _ENTRIES, StoredSnapshot.id
    if split is not None:
        # Numbers rise like ids, and the index has them by split.
        rows, key = rows.where(StoredSnapshot.split == split), StoredSnapshot.number
    return list_page(session, rows, key, page, SnapshotEntry.model_validate, newest_first=True)


def snapshot_of(session: Session, split: str, number: int) -> Snapshot:
    """Return a snapshot. Raises NotFoundError if none has this number."""
    chosen = select(StoredSnapshot.content).where(
        StoredSnapshot.split == split, StoredSnapshot.number == number
    )
    content = session.scalar(chosen)
    if content is None:
        raise NotFoundError(f"there is no snapshot {number} of {split!r}")
    return Snapshot.model_validate(content)
