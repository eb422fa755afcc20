"""What watching over itself adds to the server.

``/desk`` shows its state, and the uploads of the last day; ``/healthz``, ``/readyz`` and
``/metrics`` are for monitoring.
"""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import median
from typing import Annotated

from fastapi import APIRouter, Depends, status
from fastapi.responses import Response
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from reverie_eval.schemas.service import HealthReport
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.corrections.snapshots import Snapshots
from reverie_eval.server.http.api import TEXT, file_reply
from reverie_eval.server.http.callers import Desk, Organiser
from reverie_eval.server.http.rendering import page
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.http.telemetry import MEDIA_TYPE
from reverie_eval.server.intake.attempts import list_attempts
from reverie_eval.server.jobs import SECOND, Job
from reverie_eval.server.operations.doctor import LITTLE_SPACE
from reverie_eval.server.operations.health import Examined
from reverie_eval.server.rooms import Room, Tab
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.paging import Page
from reverie_eval.server.store.tables import (
    IS_CHANGE,
    IS_SHOWN,
    SAME_FILE,
    Attempt,
    AuditEntry,
    JoinRequest,
    Person,
    Submission,
    Team,
)

router = APIRouter()
monitoring = APIRouter(tags=["operations"])

A_FEW = 8
HOURS = 24
RECENTLY = timedelta(days=30)
"""How long the overview says that several teams sent the same file."""
_SUCCESSES = frozenset({"scored", "repeat"})
_METRICS = "# TYPE reverie_eval_requests_total counter\n..."


@dataclass(frozen=True, slots=True)
class SplitCounts:
    """The submissions to a split."""

    submissions: int = 0
    published: int = 0
    latest: datetime | None = None


@dataclass(frozen=True, slots=True)
class Totals:
    """How much the server stores."""

    teams: int
    people: int
    upload_bytes: int
    """The size of all uploads; a file that two teams sent is stored once and counted twice."""
    open_requests: int
    """Requests to join that wait for an answer."""
    same_files: int
    """How often a team has recently submitted the file of another team."""
    same_file_on: str | None
    """The split of the last time, at any time."""


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


async def examined(health: Examined) -> HealthReport:
    """Return the report of ``/healthz``."""
    return await health.report()


@router.get("/desk")
def show_desk(desk: Desk, health: Annotated[HealthReport, Depends(examined)]) -> Response:
    """Show the state of the server, and the uploads of the last day."""
    server = desk.server
    with desk.reading() as reading:
        session = reading.session
        return page(
            reading,
            "desk/overview.html",
            health=health,
            boards=server.boards.values(),
            attempts=list_attempts(session, Page(A_FEW)).rows,
            counts=counts_of_splits(session),
            totals=totals(session, reading.now),
            recently=RECENTLY.days,
            day=last_day(session, reading.now),
            missed=server.get(Snapshots).missed(session, reading.now),
            schedules=server.get(Schedules).in_effect(session),
            disk=shutil.disk_usage(server.settings.folder),
            little_space=LITTLE_SPACE,
        )


def counts_of_splits(session: Session) -> Mapping[str, SplitCounts]:
    """Count the submissions of each split that has any."""
    # Two statements, as each has an index.
    published = select(Submission.split, func.count()).where(IS_SHOWN)
    shown = dict(session.execute(published.group_by(Submission.split)).all())
    every = select(Submission.split, func.count())
    counted = every.group_by(Submission.split).subquery()
    # The latest of a split is at an end of the index; with the count, each row would be compared.
    latest = select(func.max(Submission.received_at)).where(Submission.split == counted.c.split)
    rows = session.execute(select(counted, latest.scalar_subquery()))
    return {split: SplitCounts(number, shown.get(split, 0), last) for split, number, last in rows}


def totals(session: Session, now: datetime) -> Totals:
    """Count teams and people, and add up the sizes of uploads."""
    same_files = IS_CHANGE, AuditEntry.action == SAME_FILE
    last = select(AuditEntry.subject).where(*same_files).order_by(AuditEntry.id.desc()).limit(1)
    counted = session.execute(
        select(
            select(func.count()).where(Team.merged_at.is_(None)).scalar_subquery(),
            select(func.count()).where(Person.deleted_at.is_(None)).scalar_subquery(),
            select(func.coalesce(func.sum(Submission.size), 0)).scalar_subquery(),
            select(func.count())
            .select_from(JoinRequest)
            .where(JoinRequest.decision.is_(None))
            .scalar_subquery(),
            select(func.count())
            .where(*same_files, AuditEntry.at > now - RECENTLY)
            .scalar_subquery(),
            last.scalar_subquery(),
        )
    )
    return Totals(*counted.one())


def last_day(session: Session, now: datetime) -> Day:
    """Count the outcomes of the uploads of the last 24 hours, by full hours."""
    this_hour = now.replace(minute=0, second=0, microsecond=0)
    begins = [this_hour - timedelta(hours=ago) for ago in reversed(range(HOURS))]
    attempts = session.scalars(select(Attempt).where(Attempt.at >= begins[0])).all()
    times = [each.milliseconds for each in attempts]
    return Day(
        hours=[_hour(begin, attempts) for begin in begins],
        uploads=len(attempts),
        refused=sum(each.outcome not in _SUCCESSES for each in attempts),
        median_milliseconds=round(median(times)) if times else None,
        slowest_milliseconds=max(times, default=None),
    )


def _hour(begins: datetime, attempts: Sequence[Attempt]) -> Hour:
    outcomes = [
        each.outcome for each in attempts if begins <= each.at < begins + timedelta(hours=1)
    ]
    scored, repeats = outcomes.count("scored"), outcomes.count("repeat")
    return Hour(begins, scored, repeats, len(outcomes) - scored - repeats)


@monitoring.get("/healthz", responses={503: {"model": HealthReport}})
async def show_health(health: Examined, response: Response) -> HealthReport:
    """Check whether the server can score and store submissions, and does its jobs; for monitors."""
    return _with_status(await health.report(), response)


@monitoring.get("/readyz", responses={503: {"model": HealthReport}})
async def show_readiness(health: Examined, response: Response) -> HealthReport:
    """Check whether the server can score and store submissions; for load balancers.

    A job that fails, such as mail, fails on all servers alike, and is no reason to send requests to
    none of them.
    """
    return _with_status((await health.report()).readiness(), response)


def _with_status(report: HealthReport, response: Response) -> HealthReport:
    if report.failed:
        response.status_code = status.HTTP_503_SERVICE_UNAVAILABLE
    return report


@monitoring.get(
    "/metrics",
    response_class=Response,
    responses=file_reply(
        "text/plain", "not-signed-in", "not-allowed", schema=TEXT, example=_METRICS
    ),
)
def show_metrics(organiser: Organiser, runtime: Runtime) -> Response:
    """Return metrics for Prometheus."""
    organiser.person()
    return Response(runtime.metrics.text(), media_type=MEDIA_TYPE)


def jobs(server: ServerState) -> Iterable[Job]:
    """Yield the job that follows corrected ground truth."""

    def follow_rules() -> None:  # uploads and leaderboards do not wait for this
        with server.database.reading() as session:
            server.rules.follow(session)

    yield Job("ground-truth", follow_rules, SECOND)


ROOM = Room(
    pages=[router],
    jobs=jobs,
    desk=[Tab("Today", 1, "Overview", "/desk")],
)
