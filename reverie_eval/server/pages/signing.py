"""Signing in with a token, or with an invitation that becomes one; and out."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from fastapi.responses import RedirectResponse, Response

from reverie_eval.server.errors import NotSignedInError
from reverie_eval.server.http.callers import Server, drop_cookie, own_page, set_cookie
from reverie_eval.server.pages.rendering import page
from reverie_eval.server.pages.visitors import Member, Posted, Visitor
from reverie_eval.server.service.people import exchange
from reverie_eval.server.service.sessions import Begun

router = APIRouter()
SEE_OTHER = 303


@router.get("/sign-in")
def show_sign_in(request: Request, visitor: Visitor, back: str = "/team") -> Response:
    """Ask for a token, or an invitation."""
    return page(request, "sign-in.html", visitor, fault=None, wrong="", back=own_path(back))


@router.post("/sign-in", dependencies=[Depends(own_page)])
def sign_in(
    request: Request,
    server: Server,
    token: Annotated[str, Form(max_length=200)] = "",
    back: Annotated[str, Form()] = "/team",
) -> Response:
    """Begin a session, or say what is wrong with the token."""
    now = server.clock()
    try:
        with server.database.writing() as session:
            begun = server.sessions.begin(session, token.strip(), now)
    except NotSignedInError as error:
        return _refused(request, "token", error, back)
    reply = RedirectResponse(own_path(back), SEE_OTHER)
    return _with_cookie(request, reply, begun, now)


@router.post("/sign-in/invitation", dependencies=[Depends(own_page)])
def accept_invitation(
    request: Request,
    server: Server,
    invitation: Annotated[str, Form(max_length=200)] = "",
    back: Annotated[str, Form()] = "/team",
) -> Response:
    """Turn an invitation into a token, show it this once, and begin a session with it.

    The token is in this reply and nowhere else: not in an address, and not in what a browser keeps.
    """
    now = server.clock()
    try:
        with server.database.writing() as session:
            minted = exchange(session, invitation.strip(), now)
            begun = server.sessions.begin(session, minted.text, now)
    except NotSignedInError as error:
        return _refused(request, "invitation", error, back)
    reply = page(request, "welcome.html", begun.session, token=minted.text, back=own_path(back))
    return _with_cookie(request, reply, begun, now)


@router.post("/sign-out")
def sign_out(server: Server, member: Member, _: Posted) -> Response:
    """End the session."""
    with server.database.writing() as session:
        server.sessions.end(session, member)
    reply = RedirectResponse("/", SEE_OTHER)
    drop_cookie(reply)
    return reply


def own_path(path: str) -> str:
    """Return a path of this server's; whoever made a link might lead elsewhere."""
    is_own = path.startswith("/") and not path.startswith(("//", "/\\")) and path.isprintable()
    return path if is_own else "/team"


def _refused(request: Request, wrong: str, error: NotSignedInError, back: str) -> Response:
    fault, target = str(error), own_path(back)
    return page(request, "sign-in.html", status=401, fault=fault, wrong=wrong, back=target)


def _with_cookie(request: Request, reply: Response, begun: Begun, now: datetime) -> Response:
    set_cookie(request, reply, begun.cookie, begun.session.expires_at - now)
    return reply
