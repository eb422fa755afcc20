"""``/team``: the page of one's own team, and the quotas of its splits."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from fastapi import APIRouter
from fastapi.responses import Response
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.reporting.history import Timeline
from reverie_eval.reporting.service import known_task
from reverie_eval.schemas.service import QuotaReport, Schedule, ScoredSubmission
from reverie_eval.server.boards.charts import progress_of
from reverie_eval.server.boards.embargo import View
from reverie_eval.server.boards.schedules import Schedules
from reverie_eval.server.http.callers import CallReading, Member
from reverie_eval.server.http.rendering import page
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import count_rows
from reverie_eval.server.store.tables import Person, Submission, Token

router = APIRouter()

MOST_SUBMISSIONS = 200
"""The largest number on the page; the API lists all."""


@dataclass(frozen=True, slots=True)
class TeamView:
    """What people see of their own team."""

    people: Sequence[Person]
    submissions: Sequence[ScoredSubmission]
    """The latest, the newest first."""
    submitted: int
    """The number of all submissions."""
    tokens: Sequence[Token]
    """The tokens of the person who asks, the newest first."""


def team_of(session: Session, person: Person, most: int, view: View) -> TeamView:
    """Return a person's team, with its latest submissions."""
    of_team = Submission.team_id == person.team_id
    latest = select(Submission).where(of_team).order_by(Submission.received_at.desc()).limit(most)
    members = select(Person).where(Person.team_id == person.team_id, Person.deleted_at.is_(None))
    tokens = select(Token).where(Token.person_id == person.id).order_by(Token.id.desc())
    return TeamView(
        people=session.scalars(members.order_by(Person.name)).all(),
        submissions=[view.report(row) for row in session.scalars(latest)],
        submitted=count_rows(session, Submission, of_team),
        tokens=session.scalars(tokens).all(),
    )


def _progress(team: TeamView, server: ServerState, now: datetime) -> Mapping[str, Timeline]:
    """Return the submissions over time, by split, of those with at least two scored ones."""
    of_splits = {
        split: [each for each in team.submissions if each.split == split] for split in server.boards
    }
    drawn = {
        split: progress_of(submissions, server.board(split).primary, now)
        for split, submissions in of_splits.items()
    }
    return {split: timeline for split, timeline in drawn.items() if timeline is not None}


@dataclass(frozen=True, slots=True)
class TaskSubmissions:
    """The team's submissions to the splits of a task, which have the same columns."""

    title: str
    """The title of the task; empty if it is not installed any more."""
    columns: Sequence[Metric]
    primary: str
    submissions: Sequence[ScoredSubmission]


def _by_task(submissions: Sequence[ScoredSubmission]) -> Sequence[TaskSubmissions]:
    """Group submissions by their tasks, in the order of the latest one to each."""
    groups = defaultdict(list)
    for each in submissions:
        groups[known_task(each.report.signature)].append(each)
    return [
        TaskSubmissions("", [*CATALOGUE.values()], "", found)
        if task is None
        else TaskSubmissions(
            task.title, task.headline_metrics(CATALOGUE), task.primary_metric(CATALOGUE).key, found
        )
        for task, found in groups.items()
    ]


@router.get("/team")
def show_team(member: Member) -> Response:
    """Show the team's people, quotas, submissions and tokens."""
    server = member.server
    with member.reading() as reading:
        team = team_of(reading.session, reading.person, MOST_SUBMISSIONS, View.of(reading))
        left = [(each.board.split, each.quota) for each in split_quotas(server, reading)]
        return page(
            reading,
            "team.html",
            team=team,
            person=reading.person,
            left=left,
            signed_in_with=reading.browser and reading.browser.token_id,
            by_task=_by_task(team.submissions),
            progress=_progress(team, server, reading.now),
        )


@dataclass(frozen=True, slots=True)
class SplitQuota:
    """A split, for one person."""

    board: Board
    quota: QuotaReport
    schedule: Schedule


def split_quotas(server: ServerState, reading: CallReading) -> Sequence[SplitQuota]:
    """Return the quota of every split for the visitor."""
    quotas = server.get(Intake).quotas(reading.session, reading.person)
    schedules = server.get(Schedules).in_effect(reading.session)
    return [
        SplitQuota(board, quotas[name], schedules[name]) for name, board in server.boards.items()
    ]
