"""Pages for errors: they show the problem document as HTML."""

from collections.abc import Callable
from urllib.parse import quote, urlsplit

from fastapi import Request
from fastapi.responses import RedirectResponse, Response

from reverie_eval.schemas.service import ProblemDocument
from reverie_eval.server.errors import MalformedError, NotSignedInError
from reverie_eval.server.http.callers import COOKIE, Call, Snapshot, session_id_of
from reverie_eval.server.http.exchange import exchange_of
from reverie_eval.server.http.labels import API
from reverie_eval.server.pages.rendering import STATIC, Place, page
from reverie_eval.server.state import state_of

_NOT_PAGES = (f"{API}/", f"{STATIC}/", "/healthz", "/metrics")


def show_faults_with(request: Request, draw: Callable[[ProblemDocument], Response]) -> None:
    """Let a page with a form show further problems itself, so that the input is not lost."""
    request.state.draw_fault = draw


def fault_page(request: Request, problem: ProblemDocument) -> Response | None:
    """Show a problem, or redirect to the sign-in page if signing in is needed.

    Returns
    -------
    Response or None
        None if the request is not for a page.
    """
    if request.url.path.startswith(_NOT_PAGES):
        return None
    if problem.code == NotSignedInError.code:
        return RedirectResponse(f"/sign-in?back={quote(_came_from(request))}", 303)
    if not exchange_of(request.scope).asks_database:
        return _fault(request, None, problem)
    if hasattr(request.state, "draw_fault"):
        drawn: Response = request.state.draw_fault(problem)
        return drawn
    cookie = request.cookies.get(COOKIE)
    visit = Call(request, state_of(request), None, session_id_of(request, cookie))
    with visit.snapshot() as snapshot:
        return _fault(request, snapshot, problem)


def _fault(request: Request, snapshot: Snapshot | None, problem: ProblemDocument) -> Response:
    way_on = _way_on(request, problem)
    return page(request, "fault.html", snapshot, problem.status, problem=problem, way_on=way_on)


def _way_on(request: Request, problem: ProblemDocument) -> Place:
    """Return the link of the error page: to the same leaderboard if only its query was invalid."""
    if problem.code == MalformedError.code and request.url.path.startswith("/boards/"):
        split = request.path_params["split"]
        return Place(f"To the whole {split} leaderboard", f"/boards/{quote(split)}")
    return Place("To the leaderboard", "/")


def _came_from(request: Request) -> str:
    """Return the address to return to after signing in; for a form, the page that it is on."""
    if request.method == "GET":
        return f"{request.url.path}?{request.url.query}".removesuffix("?")
    return urlsplit(request.headers.get("referer", "")).path or "/"
