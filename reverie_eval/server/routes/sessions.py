"""``/session``: signing in with a browser, and out."""

from fastapi import APIRouter, Depends, Request, Response

from reverie_eval.schemas.service import SessionReport, SignIn
from reverie_eval.server.errors import NotSignedInError
from reverie_eval.server.http.callers import (
    Anybody,
    Server,
    Snapshot,
    drop_cookie,
    own_page,
    set_cookie,
)
from reverie_eval.server.http.openapi import problems
from reverie_eval.server.store.tables import BrowserSession

router = APIRouter(prefix="/session", tags=["access"])


@router.post(
    "",
    status_code=201,
    dependencies=[Depends(own_page)],
    responses=problems("not-signed-in", "not-allowed"),
)
def sign_in(shown: SignIn, request: Request, response: Response, server: Server) -> SessionReport:
    """Exchange a token for a session: a cookie, and the token that goes with what it changes."""
    with server.database.writing() as session:
        now = server.clock()
        begun = server.sessions.begin(session, shown.token, now)
        set_cookie(request, response, begun.cookie, begun.session.expires_at - now)
        return _report(begun.session, begun.csrf_token)


@router.get("", responses=problems("not-signed-in"))
def show_session(call: Anybody, server: Server) -> SessionReport:
    """Say who is signed in, and the session's CSRF token."""
    with call.snapshot() as snapshot:
        browser = _signed_in(snapshot)
        return _report(browser, server.sessions.csrf_token(browser.id))


@router.delete("", status_code=204, responses=problems("not-signed-in"))
def sign_out(call: Anybody, response: Response, server: Server) -> None:
    """End the session, for everybody who has its cookie."""
    with call.snapshot() as snapshot:
        browser = _signed_in(snapshot)
    with server.database.writing() as session:
        server.sessions.end(session, browser.id)
    drop_cookie(response)


def _signed_in(snapshot: Snapshot) -> BrowserSession:
    if snapshot.browser is None:
        raise NotSignedInError("there is no session; sign in with POST /api/v1/session")
    return snapshot.browser


def _report(browser: BrowserSession, csrf_token: str) -> SessionReport:
    person = browser.token.person
    return SessionReport(
        person=person.name,
        team=person.team.name,
        role=person.role,
        csrf_token=csrf_token,
        expires_at=browser.expires_at,
    )
