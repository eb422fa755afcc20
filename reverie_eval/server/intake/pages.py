"""A team's own pages, and a submission as everyone sees it.

``/submit``: checking files, and scoring them. ``/team``: people, quotas, submissions and tokens.
``/submissions/{id}``: a submission for its team, or its published part for others.

``/submit`` is one multipart form. With scripts, a chosen file is checked at once: the same form is
sent in the background, and the outcome is inserted into the page. The CSRF token is a form field,
not part of the address, because addresses are stored in browser histories and proxy logs. So the
body is read before the token is checked. Only people who are signed in can cause that: requests
from other sites have no session, which is known before the body is read.
"""

import json
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from types import MappingProxyType
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Response
from fastapi.concurrency import run_in_threadpool
from sqlalchemy import select
from sqlalchemy.orm import Session

from reverie_eval.metrics import CATALOGUE, Metric
from reverie_eval.receipts import read
from reverie_eval.reporting.history import Timeline
from reverie_eval.reporting.service import known_task
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import Method, ProblemDocument, ScoredSubmission, SubmissionChange
from reverie_eval.server.audit.log import history
from reverie_eval.server.boards.charts import progress_of
from reverie_eval.server.boards.entries import is_anonymous
from reverie_eval.server.boards.leaderboard import Rankings, ranks
from reverie_eval.server.boards.reviews import is_disqualified, standing_reviews
from reverie_eval.server.boards.schedules import Schedules, View
from reverie_eval.server.errors import MalformedError, NotFoundError, RejectedFileError
from reverie_eval.server.http.callers import Call, CallReading, Member, Posted, Visitor, exchange_of
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import page, see_other, show_faults_with
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.identity import Sessions
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.intake.submissions import (
    Publication,
    SubmissionService,
    publication,
    submission_of,
)
from reverie_eval.server.intake.uploads import Arriving, ReceivedFile, method_from
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.database import count_rows
from reverie_eval.server.store.tables import Person, Submission, Token
from reverie_eval.tasks import Task

router = APIRouter()

NOTHING = dict.fromkeys(("split", *Method.model_fields), "")
"""The input of an empty form."""
MOST_SUBMISSIONS = 200
"""The largest number on the page; the API lists all."""
_EMPTY_IS_NONE = frozenset(
    name for name, field in Method.model_fields.items() if field.default is None
)
"""Fields of a method that nobody has to fill in: links, and what it declares."""
OK = 200


@router.get("/submit")
def show_submit(
    member: Member,
    split: Annotated[str, Query(max_length=64)] = "",
    human: Literal["", "true"] = "",
) -> Response:
    """Show the form; the query can select the split, and say that people walked."""
    return _draw_form(member, {"split": split, "human": human})


async def posted_file(upload: Arriving, member: Member) -> AsyncIterator[ReceivedFile]:
    """Read the form when a place is free; after a problem, the input is kept."""
    exchange = exchange_of(member.request.scope)
    exchange.uploaded_to = ""

    def check(file: ReceivedFile) -> None:
        is_to_be_scored = file.fields.get("what") == "score"
        exchange.uploaded_to = file.fields.get("split", "") if is_to_be_scored else None
        check_form(member, file, _draw_problem)

    async with upload.take(await run_in_threadpool(member.person), check) as file:
        yield file


PostedFile = Annotated[ReceivedFile, Depends(posted_file, scope="function")]


@router.post("/submit")
def submit(member: Member, file: PostedFile) -> Response:
    """Check a file, or score it and redirect to its page."""
    server, person, typed = member.server, member.person(), file.fields
    board = server.board(typed.get("split", ""))
    if typed.get("what") != "score":
        report = server.get(Intake).validate(person, board.split, file.packed)
        return _draw_form(member, typed, report=report)
    method = method_from({name: typed[name] for name in Method.model_fields if name in typed})
    accepted = server.get(Intake).submit(
        person, board.split, file.packed, method, key=None, arrived=file.arrived
    )
    exchange_of(member.request.scope).note(accepted)
    place = f"/submissions/{accepted.submission.id}"
    if not accepted.is_repeat:
        return see_other(f"{place}?done=scored")
    ignored = "".join(f"&ignored={name}" for name in accepted.ignored)
    return see_other(f"{place}?done=again{ignored}")


def _draw_form(
    member: Call, typed: Mapping[str, str], status: int = OK, **outcome: Any
) -> Response:
    """Show the form with its input and the outcome."""
    server = member.server
    with member.reading() as reading:
        return page(
            reading,
            "submit.html",
            status=status,
            typed={**NOTHING, **typed},
            boards=server.boards.values(),
            left=server.get(Intake).quotas(reading.session, reading.person),
            schedules=server.get(Schedules).in_effect(reading.session),
            required=server.settings.required_metadata,
            limit=server.settings.limits.upload_mebibytes,
            **{"report": None, "other_split": "", **outcome},
        )


def _draw_problem(member: Call, typed: Mapping[str, str], problem: ProblemDocument) -> Response:
    """Show the form with a problem; problems found by a check have status 200."""
    is_answer = typed.get("what") == "check" and problem.code == RejectedFileError.code
    status = OK if is_answer else problem.status
    splits = [each.split for each in problem.problems if each.split in member.server.boards]
    return _draw_form(member, typed, status, problem=problem, other_split=next(iter(splits), ""))


def check_form(
    call: Call,
    file: ReceivedFile,
    draw_problem: Callable[[Call, Mapping[str, str], ProblemDocument], Response],
) -> None:
    """Check that one of this server's pages sent a form, with a file; it shows further problems.

    Raises
    ------
    ForgedError
        If it has no valid CSRF token.
    MalformedError
        If no file was chosen.
    """
    # First, so that a form of an earlier session keeps what was typed: no other site can send a
    # request of this session.
    show_faults_with(call.request, partial(draw_problem, call, file.fields))
    call.server.get(Sessions).check_csrf_token(
        call.session_id or "", file.fields.get("csrf_token", "")
    )
    if not file.filename:
        raise MalformedError("choose a file first")


@router.get("/team")
def show_team(member: Member) -> Response:
    """Show the team's people, quotas and latest submissions, and one's own tokens."""
    server = member.server
    with member.reading() as reading:
        session, person, view = reading.session, reading.person, View.of(reading)
        of_team = Submission.team_id == person.team_id
        latest = select(Submission).where(of_team).order_by(Submission.received_at.desc())
        rows = session.scalars(latest.limit(MOST_SUBMISSIONS))
        submissions = [view.report(row) for row in rows]
        people = select(Person).where(Person.team_id == person.team_id, Person.deleted_at.is_(None))
        tokens = select(Token).where(Token.person_id == person.id).order_by(Token.id.desc())
        return page(
            reading,
            "team.html",
            person=person,
            people=session.scalars(people.order_by(Person.name)).all(),
            submissions=submissions,
            submitted=count_rows(session, Submission, of_team),
            tokens=session.scalars(tokens).all(),
            signed_in_with=reading.browser and reading.browser.token_id,
            left=server.get(Intake).quotas(session, person),
            by_task=_by_task(submissions),
            progress=_progress(submissions, server, reading.now),
        )


def _progress(
    team: Sequence[ScoredSubmission], server: ServerState, now: datetime
) -> Mapping[str, Timeline]:
    """Return the submissions over time, by split, of those with at least two scored ones."""
    drawn = {
        split: progress_of([each for each in team if each.split == split], board.primary, now)
        for split, board in server.boards.items()
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
    return [_of_task(task, found) for task, found in groups.items()]


def _of_task(task: Task | None, submissions: Sequence[ScoredSubmission]) -> TaskSubmissions:
    """Return the submissions to a task's splits, with columns of what any of them has."""
    reports = [report for each in submissions for report in _reports(each)]
    scored = {key for report in reports for key in report.scores}
    if task is None:
        columns = [metric for key, metric in CATALOGUE.items() if key in scored]
        return TaskSubmissions("", columns, "", submissions)
    primary = task.primary_metric(CATALOGUE).key
    return TaskSubmissions(task.title, task.headline_metrics(scored), primary, submissions)


def _reports(submission: ScoredSubmission) -> Sequence[ScoreReport]:
    """Return the reports on all leaderboards of the submission's split."""
    return [submission.report, *(each.report for each in submission.boards.values())]


@router.get("/submissions/{submission_id}")
def show_submission(
    submission_id: str,
    visitor: Visitor,
    done: Annotated[str, Query(max_length=20)] = "",
    ignored: Annotated[list[str], Query(max_length=len(Method.model_fields))] = [],  # noqa: B006
) -> Response:
    """Show a submission to its team, or its published part to others."""
    with visitor.reading() as reading:
        if reading.caller is not None:
            try:
                return _own_page(visitor, reading, submission_id, done, ignored)
            except NotFoundError:
                pass  # it may be published
        shown = publication(reading.session, submission_id, View.of(reading))
        return page(
            reading,
            "publication.html",
            shown=shown,
            boards=_other_boards(visitor, shown.split),
            has_episodes=_has_episodes(visitor, shown),
        )


@router.post("/submissions/{submission_id}")
def change_submission(submission_id: str, member: Member, form: Posted, _: ScoringTurn) -> Response:
    """Apply one of the forms on the page; each sends only its own fields."""
    typed = {name: value for name, value in form.items() if isinstance(value, str)}
    with member.reading() as reading:
        submission_of(reading.session, reading.person, submission_id, View.of(reading))

    def draw(problem: ProblemDocument) -> Response:
        with member.reading() as reading:
            method = typed if "name" in typed else {}  # of the form about the method alone
            return _own_page(member, reading, submission_id, typed=method, problem=problem)

    show_faults_with(member.request, draw)
    member.server.get(SubmissionService).change(member.person(), submission_id, change_of(typed))
    return see_other(f"/submissions/{submission_id}?done=changed")


def _own_page(
    visit: Call,
    reading: CallReading,
    submission_id: str,
    done: str = "",
    ignored: Sequence[str] = (),
    *,
    typed: Mapping[str, Any] = MappingProxyType({}),
    problem: ProblemDocument | None = None,
) -> Response:
    """Show a submission to its team alone; after a problem, with the input of the form."""
    server, session, person = visit.server, reading.session, reading.person
    shown = submission_of(session, person, submission_id, View.of(reading))
    board = server.boards.get(shown.split)
    is_mine = board is not None and shown.team == person.team.name
    reviews = standing_reviews(session, shown.id)
    return page(
        reading,
        "submission.html",
        problem,
        shown=shown,
        signed=json.dumps(read(shown.receipt).fields, indent=2, ensure_ascii=False),
        standing=board and _standing(server, session, board, shown),
        quota=server.get(Intake).quotas(session, person, shown.split)[shown.split]
        if is_mine
        else None,
        has_episodes=_has_episodes(visit, shown),
        one_per_team=board is not None and board.settings.one_per_team,
        events=history(session, shown.id, server.settings.organiser),
        reviews=reviews,
        is_disqualified=is_disqualified(reviews),
        is_anonymous=is_anonymous(shown, reading.now),
        typed={**_texts(shown.method), **typed},
        boards=_other_boards(visit, shown.split),
        required=server.settings.required_metadata,
        done=done,
        ignored=[name for name in Method.model_fields if name in ignored],
    )


def _other_boards(visit: Call, split: str) -> Mapping[str, Board]:
    """Return the other leaderboards that a split has now."""
    board = visit.server.boards.get(split)
    return {} if board is None else board.others


def _has_episodes(visit: Call, shown: ScoredSubmission | Publication) -> bool:
    """Whether episodes may be shown to somebody, and would be scored in the same way now."""
    board = visit.server.boards.get(shown.split)
    return board is not None and not board.is_private and board.measures_as(shown.report)


@dataclass(frozen=True, slots=True)
class LeaderboardStanding:
    """Where a result would be on its leaderboard."""

    rank: int
    count: int
    """All results with a rank, itself included."""
    best: float | None
    """The best value of the others; None if there are none."""


def _standing(
    server: ServerState, session: Session, board: Board, shown: ScoredSubmission
) -> LeaderboardStanding | None:
    """Compare a result that is not published with those that are; None if it cannot be ranked.

    While scores are held back, a result has none, and nothing is said of its rank.
    """
    own = shown.report.scores.get(board.primary.key)
    if own is None or shown.status != "unpublished" or not board.measures_as(shown.report):
        return None
    key = board.primary.key
    rows = server.get(Rankings).ranking(session, board, key).rows
    others = [row.entry.scores[key] for row in rows if row.rank is not None]
    rank = ranks([own, *others], board.primary)[0] or 1
    # The first of the others has the best value.
    return LeaderboardStanding(rank, 1 + len(others), next(iter(others), None))


def change_of(typed: Mapping[str, str]) -> SubmissionChange:
    """Return the change that a form requests; it keeps everything without a field in the form.

    Raises
    ------
    RequestValidationError
        Naming each field that is wrong.
    """
    change: dict[str, Any] = {
        name: typed[name] for name in ("published", "withdrawn", "shows_episodes") if name in typed
    }
    if "anonymous_until" in typed:
        date = typed["anonymous_until"]
        change["anonymous_until"] = f"{date}T00:00:00Z" if date else None
    method = {
        name: None if name in _EMPTY_IS_NONE and not typed[name] else typed[name]
        for name in Method.model_fields
        if name in typed
    }
    return read_model(SubmissionChange, change | ({"method": method} if method else {}))


def _texts(method: Method) -> Mapping[str, str]:
    """Return the description of a method as values of form fields."""
    return {
        name: str(value).lower() if isinstance(value, bool) else value or ""
        for name, value in method.model_dump(mode="json").items()
    }
