"""Signing in with a token or an invitation, and signing out."""

from typing import Annotated

from fastapi import APIRouter, Depends, Form
from fastapi.responses import Response

from reverie_eval.server.errors import NotSignedInError
from reverie_eval.server.http.callers import (
    Call,
    Posted,
    Snapshot,
    Visitor,
    drop_cookie,
    own_page,
    set_cookie,
)
from reverie_eval.server.pages.rendering import page, see_other
from reverie_eval.server.service.tokens import accept_invitation

router = APIRouter()


@router.get("/sign-in")
def show_sign_in(visitor: Visitor, back: str = "/team") -> Response:
    """Ask for a token or an invitation."""
    return _form(visitor, own_path(back))


@router.post("/sign-in", dependencies=[Depends(own_page)])
def sign_in(
    visitor: Visitor,
    token: Annotated[str, Form(max_length=200)] = "",
    back: Annotated[str, Form()] = "/team",
) -> Response:
    """Begin a session, or show why the token is refused."""
    server, now = visitor.server, visitor.server.clock()
    try:
        with server.database.writing() as session:
            begun = server.sessions.begin(session, token.strip(), now)
    except NotSignedInError as error:
        return _form(visitor, own_path(back), 401, wrong="token", fault=str(error))
    reply = see_other(own_path(back))
    set_cookie(visitor.request, reply, begun.cookie, begun.session.expires_at - now)
    return reply


@router.post("/sign-in/invitation", dependencies=[Depends(own_page)])
def use_invitation(
    visitor: Visitor,
    invitation: Annotated[str, Form(max_length=200)] = "",
    back: Annotated[str, Form()] = "/team",
) -> Response:
    """Exchange an invitation for a token, show it once, and begin a session with it.

    Only this reply contains the token: it is never in an address, and the browser does not store
    it.
    """
    request, server = visitor.request, visitor.server
    try:
        with server.transactions.begin("") as transaction:
            session, now = transaction.session, transaction.now
            token = accept_invitation(transaction, invitation.strip()).token
            begun = server.sessions.begin(session, token, now)
            own = Snapshot(request, session, now, begun.session, begun.session.token.person)
            reply = page(own, "welcome.html", token=token, back=own_path(back))
    except NotSignedInError as error:
        return _form(visitor, own_path(back), 401, wrong="invitation", fault=str(error))
    set_cookie(request, reply, begun.cookie, begun.session.expires_at - now)
    return reply


@router.post("/sign-out")
def sign_out(visitor: Visitor, _: Posted) -> Response:
    """End the session."""
    with visitor.server.database.writing() as session:
        visitor.server.sessions.end(session, visitor.session_id or "")
    reply = see_other("/")
    drop_cookie(visitor.request, reply)
    return reply


def own_path(path: str) -> str:
    """Return a path if it is on this server, else ``/team``: a link could point to another site."""
    is_own = path.startswith("/") and not path.startswith(("//", "/\\")) and path.isprintable()
    return path if is_own else "/team"


def _form(
    visitor: Call, back: str, status: int = 200, *, wrong: str = "", fault: str | None = None
) -> Response:
    with visitor.snapshot() as snapshot:
        return page(
            snapshot,
            "sign-in.html",
            status=status,
            fault=fault,
            wrong=wrong,
            back=back,
            accepts_requests=visitor.server.settings.accept_requests_to_join,
        )
