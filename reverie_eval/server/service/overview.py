"""What an organiser looks at first: how much was sent, and what uploads of a day came to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import median

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from reverie_eval.server.service.attempts import attempts_since
from reverie_eval.server.store.tables import Attempt, Person, Submission, Team

HOURS = 24
_WELL = frozenset({"scored", "repeat"})


@dataclass(frozen=True, slots=True)
class SplitCounts:
    """What was sent to a split."""

    submissions: int = 0
    published: int = 0
    latest: datetime | None = None


@dataclass(frozen=True, slots=True)
class Totals:
    """What the server keeps."""

    teams: int
    people: int
    bytes_kept: int
    """Of uploads; the same file of two teams is kept once and counted twice."""


@dataclass(frozen=True, slots=True)
class Hour:
    """The uploads of an hour."""

    begins: datetime
    scored: int
    repeats: int
    refused: int


@dataclass(frozen=True, slots=True)
class Day:
    """The uploads of the last 24 hours."""

    hours: Sequence[Hour]
    """The oldest first; the last one has not ended."""
    uploads: int
    refused: int
    median_milliseconds: int | None
    """None if there were no uploads."""
    slowest_milliseconds: int | None

    @property
    def busiest(self) -> int:
        """The uploads of the busiest hour."""
        return max(hour.scored + hour.repeats + hour.refused for hour in self.hours)


def counts_of_splits(session: Session) -> Mapping[str, SplitCounts]:
    """Count the submissions of each split that has any."""
    is_published = Submission.published_at.is_not(None) & Submission.withdrawn_at.is_(None)
    chosen = select(
        Submission.split,
        func.count(),
        func.count().filter(is_published),
        func.max(Submission.received_at),
    ).group_by(Submission.split)
    return {
        split: SplitCounts(submissions, published, latest)
        for split, submissions, published, latest in session.execute(chosen)
    }


def totals(session: Session) -> Totals:
    """Count what the server keeps."""
    counted = session.execute(
        select(
            select(func.count()).select_from(Team).scalar_subquery(),
            select(func.count()).select_from(Person).scalar_subquery(),
            select(func.coalesce(func.sum(Submission.size), 0)).scalar_subquery(),
        )
    )
    return Totals(*counted.one())


def last_day(session: Session, now: datetime) -> Day:
    """Return what came of the uploads of the last 24 hours, by the hours of the clock."""
    this_hour = now.replace(minute=0, second=0, microsecond=0)
    begins = [this_hour - timedelta(hours=ago) for ago in reversed(range(HOURS))]
    found = attempts_since(session, begins[0])
    times = [each.milliseconds for each in found]
    return Day(
        hours=[_hour(begin, found) for begin in begins],
        uploads=len(found),
        refused=sum(each.outcome not in _WELL for each in found),
        median_milliseconds=round(median(times)) if times else None,
        slowest_milliseconds=max(times, default=None),
    )


def _hour(begins: datetime, attempts: Sequence[Attempt]) -> Hour:
    outcomes = [
        each.outcome for each in attempts if begins <= each.at < begins + timedelta(hours=1)
    ]
    scored, repeats = outcomes.count("scored"), outcomes.count("repeat")
    return Hour(begins, scored, repeats, len(outcomes) - scored - repeats)
