"""``/submissions/{id}``: all of it for its team, what was published for everybody else."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import RedirectResponse, Response
from pydantic import ValidationError

from reverie_eval.metrics import PRIMARY_METRIC
from reverie_eval.schemas.report import ScoreReport
from reverie_eval.schemas.service import Method, ProblemDocument, SubmissionChange
from reverie_eval.server.errors import NotFoundError
from reverie_eval.server.http.callers import Server
from reverie_eval.server.http.dependencies import Turn
from reverie_eval.server.pages.faults import show_faults_with
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.visitors import Member, Posted, Visitor
from reverie_eval.server.service.boards import Board
from reverie_eval.server.service.history import history
from reverie_eval.server.service.publications import publication
from reverie_eval.server.service.reviews import standing_reviews
from reverie_eval.server.state import ServerState
from reverie_eval.server.store.tables import BrowserSession

router = APIRouter()
SEE_OTHER = 303

_EMPTY_IS_NONE = frozenset({"paper", "code"})


@dataclass(frozen=True)
class OwnPage:
    """A submission's page for its team, and for the organiser."""

    request: Request
    server: ServerState
    member: BrowserSession
    submission_id: str

    def draw(
        self,
        done: str = "",
        typed: Mapping[str, Any] | None = None,
        problem: ProblemDocument | None = None,
    ) -> Response:
        """Show it, with what was typed into its forms, if that came to nothing.

        Raises
        ------
        NotFoundError
            If it is another team's, or there is none.
        """
        person = self.member.token.person
        shown = self.server.submissions.one(person, self.submission_id)
        board = self.server.boards.get(shown.split)
        is_mine = board is not None and shown.team == person.team.name
        with self.server.database.reading() as session:
            events = history(session, shown.id)
            reviews = standing_reviews(session, shown.id)
        return page(
            self.request,
            "submission.html",
            self.member,
            problem.status if problem else 200,
            shown=shown,
            quota=self.server.intake.quota(person, shown.split) if is_mine else None,
            has_episodes=_has_episodes(board, shown.report),
            events=events,
            reviews=reviews,
            now=self.server.clock(),
            typed={**_texts(shown.method), **(typed or {})},
            said=Method.model_fields,
            primary=PRIMARY_METRIC,
            required=self.server.settings.required_metadata,
            done=done,
            problem=problem,
        )


@router.get("/submissions/{submission_id}")
def show_submission(
    submission_id: str,
    request: Request,
    server: Server,
    visitor: Visitor,
    done: Annotated[str, Query(max_length=20)] = "",
) -> Response:
    """Show a submission: to its team, or to whoever reads the board."""
    if visitor is not None:
        try:
            return OwnPage(request, server, visitor, submission_id).draw(done)
        except NotFoundError:
            pass  # it may be published
    with server.database.reading() as session:
        published = publication(session, submission_id, server.clock())
    return page(
        request,
        "publication.html",
        visitor,
        shown=published,
        said=Method.model_fields,
        primary=PRIMARY_METRIC,
    )


@router.post("/submissions/{submission_id}")
def change_submission(
    submission_id: str, request: Request, server: Server, member: Member, form: Posted, _: Turn
) -> Response:
    """Change what one of the page's small forms is about: each sends its own fields only."""
    typed = {name: value for name, value in form.items() if isinstance(value, str)}
    server.submissions.one(member.token.person, submission_id)
    own = OwnPage(request, server, member, submission_id)
    is_of_method = "name" in typed
    show_faults_with(
        request, lambda problem: own.draw(typed=typed if is_of_method else None, problem=problem)
    )
    server.submissions.change(member.token.person, submission_id, change_of(typed))
    return RedirectResponse(f"/submissions/{submission_id}?done=changed", SEE_OTHER)


def change_of(typed: Mapping[str, str]) -> SubmissionChange:
    """Return what a form asks for; what it has no field of stays.

    Raises
    ------
    RequestValidationError
        Naming each field that is wrong.
    """
    change: dict[str, Any] = {
        name: typed[name] for name in ("published", "withdrawn") if name in typed
    }
    if "anonymous_until" in typed:
        date = typed["anonymous_until"]
        change["anonymous_until"] = f"{date}T00:00:00Z" if date else None
    method = {
        name: None if name in _EMPTY_IS_NONE and not typed[name] else typed[name]
        for name in Method.model_fields
        if name in typed
    }
    try:
        return SubmissionChange.model_validate(change | ({"method": method} if method else {}))
    except ValidationError as error:
        raise RequestValidationError(error.errors()) from None


def _has_episodes(board: Board | None, report: ScoreReport) -> bool:
    """Whether the values of single episodes may be seen, and still are what was scored."""
    return board is not None and not board.is_private and board.measures_as(report)


def _texts(method: Method) -> Mapping[str, str]:
    """Return what is said of a method as its form has it."""
    said = method.model_dump(mode="json")
    return {
        name: str(value).lower() if isinstance(value, bool) else value or ""
        for name, value in said.items()
    }
