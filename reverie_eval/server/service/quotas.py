"""Quotas: how many scored submissions are left, and when the next one is.

A window rolls: what was submitted a moment more than 24 hours ago does not count any more. The
smaller remainder of the team's and the person's counts, so that nobody gains by joining teams or
by filling them. Withdrawn submissions count; files that were rejected were never submissions.
"""

from bisect import bisect_right
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from heapq import merge

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session

from reverie_eval.server.settings import Quota
from reverie_eval.server.store.tables import Grant, Person, Submission

WINDOWS = {"day": timedelta(hours=24), "month": timedelta(days=30), "year": timedelta(days=365)}


@dataclass(frozen=True, slots=True)
class Window:
    """What is left in one rolling window."""

    name: str
    limit: int
    """What was granted in addition included."""
    remaining: int
    resets_at: datetime | None
    """When there will be more than now; None if there will not."""


@dataclass(frozen=True, slots=True)
class QuotaState:
    """What is left for somebody on a split."""

    windows: Sequence[Window]
    next_at: datetime | None
    """When the next submission will be possible; None if one is now, or none ever."""

    @property
    def remaining(self) -> int:
        """How many submissions all windows allow now."""
        return min(window.remaining for window in self.windows)


def quota_usage(
    session: Session, quota: Quota, split: str, person: Person, now: datetime
) -> "QuotaUsage":
    """Look up what somebody and their team have used of a quota.

    Inside :meth:`Database.writing` the answer holds until the transaction ends.
    """
    received = [
        _received(session, split, Submission.team_id == person.team_id, now),
        _received(session, split, Submission.person_id == person.id, now),
    ]
    return QuotaUsage(quota, received, _grants(session, split, person.team_id))


@dataclass(frozen=True, slots=True)
class QuotaUsage:
    """What was allowed and what was used: enough to tell what is left, now and later."""

    quota: Quota
    received: Sequence[Sequence[datetime]]
    """When the team's and when the person's submissions came, the oldest first."""
    grants: Sequence[tuple[int, datetime]]
    """How many more, until when."""

    def with_one_more(self, now: datetime) -> "QuotaUsage":
        """Count one that comes now."""
        return replace(self, received=[sorted([*times, now]) for times in self.received])

    def state(self, now: datetime) -> QuotaState:
        """Say what is left now."""
        windows = [self._window(name, now) for name in WINDOWS]
        is_spent = not all(window.remaining for window in windows)
        return QuotaState(windows, self._first_rise(WINDOWS, now) if is_spent else None)

    def _window(self, name: str, now: datetime) -> Window:
        limit, left = self._limit(name, now), self._left(name, now)
        return Window(name, limit, left, self._first_rise([name], now))

    def _first_rise(self, windows: Collection[str], now: datetime) -> datetime | None:
        """Return when the windows together will allow more than now.

        Only what leaves a window can bring that about; until then grants may expire.
        """
        allowed = min(self._left(name, now) for name in windows)
        leaving = merge(*(each for name in windows for each in self._leaving(name, now)))
        later = (at for at in leaving if min(self._left(name, at) for name in windows) > allowed)
        return next(later, None)

    def _limit(self, window: str, at: datetime) -> int:
        allowed: int = getattr(self.quota, window)
        return allowed + sum(extra for extra, until in self.grants if until > at)

    def _left(self, window: str, at: datetime) -> int:
        before = at - WINDOWS[window]
        used = max(len(times) - bisect_right(times, before) for times in self.received)
        return max(self._limit(window, at) - used, 0)

    def _leaving(self, window: str, now: datetime) -> Iterator[Iterator[datetime]]:
        """Return when the team's and when the person's leave the window, the earliest first."""
        for times in self.received:
            counted = bisect_right(times, now - WINDOWS[window])
            yield (at + WINDOWS[window] for at in times[counted:])


def _received(
    session: Session, split: str, whose: ColumnElement[bool], now: datetime
) -> Sequence[datetime]:
    """Return when submissions of the longest window came, the oldest first."""
    since = now - max(WINDOWS.values())
    chosen = select(Submission.received_at).where(
        whose, Submission.split == split, Submission.received_at > since
    )
    return session.scalars(chosen.order_by(Submission.received_at)).all()


def _grants(session: Session, split: str, team_id: int) -> Sequence[tuple[int, datetime]]:
    chosen = select(Grant.extra, Grant.expires_at).where(
        Grant.team_id == team_id, Grant.split == split
    )
    return [(extra, until) for extra, until in session.execute(chosen)]
