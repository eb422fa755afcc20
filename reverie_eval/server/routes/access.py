"""The server itself, the caller, signing in and out, and the public keys."""

from fastapi import APIRouter, Depends, Request, Response
from fastapi.responses import PlainTextResponse

from reverie_eval.schemas.service import (
    Invitation,
    KeyReport,
    Me,
    NewsReport,
    ServerReport,
    SessionReport,
    SignIn,
    Welcome,
)
from reverie_eval.schemas.wire import EXAMPLE_KEY
from reverie_eval.server.errors import NotSignedInError
from reverie_eval.server.http.callers import (
    Anybody,
    Caller,
    Server,
    Snapshot,
    drop_cookie,
    own_page,
    set_cookie,
)
from reverie_eval.server.http.exchange import API
from reverie_eval.server.http.openapi import file_reply, problems
from reverie_eval.server.http.paging import Paging
from reverie_eval.server.service.keys import list_keys
from reverie_eval.server.service.news import list_news
from reverie_eval.server.service.tokens import accept_invitation
from reverie_eval.server.store.tables import BrowserSession, Person
from reverie_eval.version import __version__

router = APIRouter(prefix=API, tags=["access"])


@router.get("/server")
def show_server(server: Server) -> ServerReport:
    """Show the server's version, its settings and the organiser's notice."""
    with server.database.reading() as session:
        notice = server.notices.current(session)
    return ServerReport(
        title=server.settings.title,
        version=__version__,
        banner=notice.banner,
        paused=notice.paused,
        key_id=server.signer.key_id,
        required_metadata=list(server.settings.required_metadata),
        organiser=server.settings.organiser,
        contact=server.settings.contact,
        links={text: str(url) for text, url in server.settings.links.items()},
    )


@router.get("/news")
def show_news(server: Server, paging: Paging) -> list[NewsReport]:
    """List the organiser's news, the latest first."""
    with server.database.reading() as session:
        return paging.reply(list_news(session, paging.page))


@router.get("/me", responses=problems("not-signed-in"))
def show_me(caller: Caller) -> Me:
    """Show who you are."""
    return _me(caller.person())


@router.post("/tokens", status_code=201, responses=problems("not-signed-in"))
def exchange_invitation(invitation: Invitation, server: Server) -> Welcome:
    """Exchange an invitation for a token; this works once."""
    with server.transactions.begin("") as transaction:
        return accept_invitation(transaction, invitation.invitation)


@router.get("/keys")
def show_keys(server: Server) -> list[KeyReport]:
    """List all keys that verify receipts, the earliest first; the last is in use."""
    with server.database.reading() as session:
        return list_keys(session)


@router.get(
    "/key",
    response_class=PlainTextResponse,
    responses=file_reply("text/plain", example=EXAMPLE_KEY),
)
def show_key(server: Server) -> str:
    """Return the public key in use, in PEM form."""
    return server.signer.public_pem


@router.post(
    "/session",
    status_code=201,
    dependencies=[Depends(own_page)],
    responses=problems("not-signed-in", "not-allowed"),
)
def sign_in(shown: SignIn, request: Request, response: Response, server: Server) -> SessionReport:
    """Exchange a token for a browser session: a cookie and a CSRF token."""
    with server.database.writing() as session:
        now = server.clock()
        begun = server.sessions.begin(session, shown.token, now)
        set_cookie(request, response, begun.cookie, begun.session.expires_at - now)
        return _report(begun.session, begun.csrf_token)


@router.get("/session", responses=problems("not-signed-in"))
def show_session(call: Anybody, server: Server) -> SessionReport:
    """Show who is signed in, and the session's CSRF token."""
    with call.snapshot() as snapshot:
        browser = _signed_in(snapshot)
        return _report(browser, server.sessions.csrf_token(browser.id))


@router.delete("/session", status_code=204, responses=problems("not-signed-in"))
def sign_out(call: Anybody, response: Response, server: Server) -> None:
    """End the session; its cookie is no longer valid."""
    with call.snapshot() as snapshot:
        browser = _signed_in(snapshot)
    with server.database.writing() as session:
        server.sessions.end(session, browser.id)
    drop_cookie(call.request, response)


def _signed_in(snapshot: Snapshot) -> BrowserSession:
    if snapshot.browser is None:
        raise NotSignedInError("there is no session; sign in with POST /api/v1/session")
    return snapshot.browser


def _me(person: Person) -> Me:
    return Me(person=person.name, team=person.team.name, role=person.role, email=person.email)


def _report(browser: BrowserSession, csrf_token: str) -> SessionReport:
    me = _me(browser.token.person)
    return SessionReport(**dict(me), csrf_token=csrf_token, expires_at=browser.expires_at)
