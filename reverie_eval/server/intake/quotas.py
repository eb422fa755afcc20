"""Quotas: how many submissions are left, when the next one is possible, and extra grants.

Windows roll: a submission counts for exactly 24 hours, 30 days and 365 days. Both the team's and
the person's submissions are counted, and the smaller remainder applies, so that joining other teams
or adding people gains nothing. Withdrawn submissions count; rejected files do not.
"""

from bisect import bisect_right
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from math import ceil
from typing import Any

from sqlalchemy import Row, bindparam, literal, null, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.organising import GrantReport, NewGrant
from reverie_eval.schemas.service import WINDOWS, QuotaReport, QuotaWindow, WindowName
from reverie_eval.server.accounts.people import team_named
from reverie_eval.server.audit.transactions import Transaction
from reverie_eval.server.errors import BytesSpentError, MalformedError, QuotaSpentError, no_split
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.settings import Limits, Quota
from reverie_eval.server.store.paging import Listed, Page, list_page
from reverie_eval.server.store.tables import Grant, Person, Submission

# For all splits, or SQLite would read everybody's submissions to the requested one. In one
# statement, because each upload runs it twice, and many pages once. Built here, because building it
# takes longer than running it.
_SENT_AND_GRANTED = (
    select(
        Submission.split,
        Submission.received_at.label("at"),
        Submission.team_id,
        Submission.person_id,
        Submission.size,
        Submission.repeat,
        literal(0).label("extra"),
    )
    .where(
        (Submission.team_id == bindparam("team")) | (Submission.person_id == bindparam("person")),
        Submission.received_at > bindparam("since"),
    )
    .union_all(
        select(
            Grant.split,
            Grant.expires_at,
            Grant.team_id,
            null(),
            literal(0),
            literal(""),
            Grant.extra,
        ).where(Grant.team_id == bindparam("team"))
    )
    .order_by("at")
)


def usage_of(session: Session, person: Person, now: datetime) -> "Usage":
    """Return what a person and their team have sent in the last year, and what they were granted.

    Within a transaction, the result stays valid until it ends.
    """
    since = now - max(WINDOWS.values())
    given = {"team": person.team_id, "person": person.id, "since": since}
    rows = session.execute(_SENT_AND_GRANTED, given).all()
    return Usage(
        person.team_id,
        person.id,
        submissions=[row for row in rows if not row.extra],
        grants=[row for row in rows if row.extra],
    )


def check_quota(
    session: Session,
    new: Submission,
    person: Person,
    board: Board,
    limits: Limits,
    *,
    in_the_past: bool,
) -> "QuotaUsage":
    """Return what a person has used of a split's quota, after checking that there is room for more.

    A submission that arrived in the past may have been followed by others.

    Raises
    ------
    QuotaSpentError
        If no submissions are left.
    BytesSpentError
        If the team has sent too many bytes in the last 24 hours.
    """
    now = new.received_at
    usage = usage_of(session, person, now)
    of_split = usage.of_split(board.split, board.settings.effective_quota)
    left = of_split.state(now)
    if not (of_split.had_room(now) if in_the_past else left.remaining):
        raise QuotaSpentError(left)
    usage.check_bytes(new.size, limits.mebibytes_per_day, now)
    return of_split


@dataclass(frozen=True, slots=True)
class Usage:
    """What a person and their team have sent to all splits, and what they were granted."""

    team_id: int
    person_id: int
    submissions: Sequence[Row[*tuple[Any, ...]]]
    """The submissions of the team or the person, the oldest first."""
    grants: Sequence[Row[*tuple[Any, ...]]]

    def of_split(self, split: str, quota: Quota) -> "QuotaUsage":
        """Return what they have used of a split's quota."""
        counted = [row for row in self.submissions if row.split == split and not row.repeat]
        return QuotaUsage(
            quota,
            [
                [row.at for row in counted if row.team_id == self.team_id],
                [row.at for row in counted if row.person_id == self.person_id],
            ],
            [(row.extra, row.at) for row in self.grants if row.split == split],
        )

    def check_bytes(self, size: int, mebibytes: int, now: datetime) -> None:
        """Make sure that the team may send an upload of a size now, given its limit in 24 hours.

        Raises
        ------
        BytesSpentError
            If it may not; says when it may. The limit is on uploads to all splits together.
        """
        day = WINDOWS["day"]
        sent = [
            row
            for row in self.submissions
            if row.team_id == self.team_id and now - day < row.at < now + day
        ]
        used = sum(row.size for row in sent)
        left = excess = used + size - (mebibytes << 20)
        if excess <= 0:
            return
        for row in sent:
            left -= row.size
            if left <= 0:
                seconds = ceil((row.at + day - now).total_seconds())
                raise BytesSpentError(mebibytes, used, size, seconds)
        raise BytesSpentError(mebibytes, used, size, None)


@dataclass(frozen=True, slots=True)
class QuotaUsage:
    """The limits and the submissions so far, to compute the submissions left at any time."""

    quota: Quota
    received: Sequence[Sequence[datetime]]
    """Times of the team's submissions and of the person's, the oldest first."""
    grants: Sequence[tuple[int, datetime]]
    """Number of extra submissions, and their expiry."""

    def with_one_more(self, now: datetime) -> "QuotaUsage":
        """Return the usage after one more submission now."""
        return replace(self, received=[sorted([*times, now]) for times in self.received])

    def state(self, now: datetime) -> QuotaReport:
        """Return the submissions left now: the smallest remainder of all windows."""
        windows = [
            QuotaWindow(
                name=name,
                limit=self._limit(name, now),
                remaining=self._left(name, now),
                resets_at=self._first_rise([name], now),
            )
            for name in WINDOWS
        ]
        remaining = min(window.remaining for window in windows)
        next_at = None if remaining else self._first_rise(WINDOWS, now)
        return QuotaReport(
            remaining=remaining,
            next_at=next_at,
            seconds_to_next=ceil((next_at - now).total_seconds()) if next_at else 0,
            windows=windows,
        )

    def had_room(self, then: datetime) -> bool:
        """Whether one more submission at a time in the past keeps every window within its limit.

        :meth:`state` counts all later submissions, because clocks may run back. Here, only windows
        that include the time count.
        """
        return all(
            self._count(times, name, end) < self._limit(name, end)
            for name, length in WINDOWS.items()
            for times in self.received
            for end in (then, *(at for at in times if then < at < then + length))
        )

    def _count(self, times: Sequence[datetime], window: WindowName, end: datetime) -> int:
        return bisect_right(times, end) - bisect_right(times, end - WINDOWS[window])

    def _first_rise(self, windows: Collection[WindowName], now: datetime) -> datetime | None:
        """Return when the windows together will allow more submissions than now.

        Only a submission that leaves a window can allow more; grants may expire before that.
        """
        leaving = sorted(
            at + WINDOWS[name]
            for name in windows
            for times in self.received
            for at in times
            if at + WINDOWS[name] > now
        )
        allowed = min(self._left(name, now) for name in windows)
        later = (at for at in leaving if min(self._left(name, at) for name in windows) > allowed)
        return next(later, None)

    def _limit(self, window: WindowName, at: datetime) -> int:
        allowed: int = getattr(self.quota, window)
        return allowed + sum(extra for extra, until in self.grants if until > at)

    def _left(self, window: WindowName, at: datetime) -> int:
        before = at - WINDOWS[window]
        used = max(len(times) - bisect_right(times, before) for times in self.received)
        return max(self._limit(window, at) - used, 0)


def grant(transaction: Transaction, new: NewGrant, splits: Collection[str]) -> GrantReport:
    """Raise every limit of a team on one of the splits, and of each person in it, until a date.

    Raises
    ------
    MalformedError
        If the expiry time is in the past.
    NotFoundError
        If there is no such team or split.
    """
    if new.expires_at <= transaction.now:
        raise MalformedError("the expiry time is in the past; choose a later time")
    if new.split not in splits:
        raise no_split(new.split, splits)
    row = Grant(
        team=team_named(transaction.session, new.team),
        created_at=transaction.now,
        **new.model_dump(exclude={"team"}),
    )
    transaction.record("granted", row, new.team, **new.model_dump(mode="json", exclude={"team"}))
    return grant_report(row)


def list_grants(session: Session, page: Page) -> Listed[GrantReport]:
    """List grants, the latest first."""
    return list_page(session, select(Grant), Grant.id, page, grant_report, newest_first=True)


def grant_report(row: Grant) -> GrantReport:
    """Return a grant as organisers see it."""
    return row.as_report(GrantReport, team=row.team.name)
