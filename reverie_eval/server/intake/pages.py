"""``/submissions/{id}``: a submission for its team, or its published part for others."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import Response
from sqlalchemy.orm import Session

from reverie_eval.receipts import read
from reverie_eval.schemas.service import Method, ProblemDocument, ScoredSubmission, SubmissionChange
from reverie_eval.server.audit.log import history
from reverie_eval.server.boards.embargo import View
from reverie_eval.server.boards.entries import is_anonymous
from reverie_eval.server.boards.leaderboard import Rankings, ranks
from reverie_eval.server.boards.reviews import is_disqualified, standing_reviews
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.http.callers import Call, CallReading, Member, Posted, Visitor
from reverie_eval.server.http.problems import read_model
from reverie_eval.server.http.rendering import page, see_other, show_faults_with
from reverie_eval.server.http.runtime import ScoringTurn
from reverie_eval.server.intake.intake import Intake
from reverie_eval.server.intake.submissions import (
    Publication,
    SubmissionService,
    publication,
    submission_of,
)
from reverie_eval.server.scoring.boards import Board
from reverie_eval.server.state import ServerState

router = APIRouter()

_EMPTY_IS_NONE = frozenset(
    name for name, field in Method.model_fields.items() if field.default is None
)
"""Fields of a method that nobody has to fill in: links, and what it declares."""


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
    best: float
    """The best value of the others, or its own if there are none."""


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
    return LeaderboardStanding(rank, 1 + len(others), next(iter(others), own))


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
