"""The server, the caller, signing in and out, asking to join, and public keys."""

from functools import partial

from fastapi import APIRouter, Depends, Request, Response
from fastapi.responses import PlainTextResponse

from reverie_eval.schemas import service as schemas
from reverie_eval.schemas.people import JoinReply, NewJoinRequest
from reverie_eval.schemas.wire import EXAMPLE_KEY
from reverie_eval.server.accounts.joining import receive_request
from reverie_eval.server.accounts.tokens import accept_invitation
from reverie_eval.server.audit.keys import list_keys
from reverie_eval.server.errors import NotSignedInError
from reverie_eval.server.http.callers import (
    Anybody,
    Caller,
    CallReading,
    Server,
    drop_cookie,
    own_page,
    set_cookie,
)
from reverie_eval.server.http.exchange import API
from reverie_eval.server.http.openapi import file_reply, problems
from reverie_eval.server.http.runtime import Runtime
from reverie_eval.server.identity import Sessions
from reverie_eval.server.messages.notices import Notices
from reverie_eval.server.store.tables import BrowserSession, Person
from reverie_eval.version import __version__

router = APIRouter(prefix=API, tags=["access"])


@router.get("/server")
def show_server(server: Server) -> schemas.ServerReport:
    """Show the server's version, its settings and the organiser's notice."""
    with server.database.reading() as session:
        notice = server.get(Notices).current(session)
    return schemas.ServerReport(
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


@router.get("/me", responses=problems("not-signed-in"))
def show_me(caller: Caller) -> schemas.Me:
    """Show who you are."""
    return _me(caller.person())


@router.post("/tokens", status_code=201, responses=problems("not-signed-in"))
def exchange_invitation(invitation: schemas.Invitation, server: Server) -> schemas.Welcome:
    """Exchange an invitation for a token; this works once."""
    with server.transactions.begin("") as transaction:
        return accept_invitation(transaction, invitation.invitation)


@router.get("/keys")
def show_keys(server: Server) -> list[schemas.KeyReport]:
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
def sign_in(
    shown: schemas.SignIn, request: Request, response: Response, server: Server
) -> schemas.SessionReport:
    """Exchange a token for a browser session: a cookie and a CSRF token."""
    with server.database.writing() as session:
        now = server.clock()
        begun = server.get(Sessions).begin(session, shown.token, now)
        set_cookie(request, response, begun.cookie, begun.session.expires_at - now)
        return _report(begun.session, begun.csrf_token)


@router.get("/session", responses=problems("not-signed-in"))
def show_session(call: Anybody, server: Server) -> schemas.SessionReport:
    """Show who is signed in, and the session's CSRF token."""
    with call.reading() as reading:
        browser = _signed_in(reading)
        return _report(browser, server.get(Sessions).csrf_token(browser.id))


@router.delete("/session", status_code=204, responses=problems("not-signed-in"))
def sign_out(call: Anybody, response: Response, server: Server) -> None:
    """End the session; its cookie is no longer valid."""
    with call.reading() as reading:
        browser = _signed_in(reading)
    with server.database.writing() as session:
        server.get(Sessions).end(session, browser.id)
    drop_cookie(call.request, response)


def _signed_in(reading: CallReading) -> BrowserSession:
    if reading.browser is None:
        raise NotSignedInError("there is no session; sign in with POST /api/v1/session")
    return reading.browser


def _me(person: Person) -> schemas.Me:
    return schemas.Me(
        person=person.name, team=person.team.name, role=person.role, email=person.email
    )


def _report(browser: BrowserSession, csrf_token: str) -> schemas.SessionReport:
    me = _me(browser.token.person)
    return schemas.SessionReport(**dict(me), csrf_token=csrf_token, expires_at=browser.expires_at)


@router.post("/join", status_code=202, responses=problems("not-allowed", "conflict"))
def ask_to_join(
    request: Request, new: NewJoinRequest, server: Server, runtime: Runtime
) -> JoinReply:
    """Ask the organiser for accounts; the reply does not reveal who has an account.

    An address may send five requests a day.
    """
    return receive_request(
        server.transactions,
        new,
        are_accepted=server.settings.accept_requests_to_join,
        count=partial(runtime.joining.count, request.scope),
    )
