"""Who looks at a page, and whether a form was ours."""

from typing import Annotated, Any

from fastapi import Depends, Request
from starlette.datastructures import FormData

from reverie_eval.server.errors import ForgedError, NotAllowedError, NotSignedInError
from reverie_eval.server.http.callers import Server, session_if_any
from reverie_eval.server.store.tables import BrowserSession

Visitor = Annotated[BrowserSession | None, Depends(session_if_any)]
"""The browser session of whoever looks, or None."""


def member(found: Visitor) -> BrowserSession:
    """Return the session of somebody who is signed in."""
    if found is None:
        raise NotSignedInError("sign in to see this page")
    return found


Member = Annotated[BrowserSession, Depends(member)]


def desk(found: Member) -> BrowserSession:
    """Return the session of an organiser."""
    if found.token.person.role != "organiser":
        raise NotAllowedError("only the organiser may see this page")
    return found


Desk = Annotated[BrowserSession, Depends(desk)]


async def posted(request: Request, found: Member, server: Server) -> FormData:
    """Return the fields of a form that one of our own pages sent.

    Raises
    ------
    ForgedError
        If it does not carry the session's CSRF token.
    """
    form = await request.form()
    shown: Any = form.get("csrf_token", "")
    if not isinstance(shown, str):
        raise ForgedError("csrf_token is no file")
    server.sessions.demand_csrf_token(found, shown)
    return form


Posted = Annotated[FormData, Depends(posted)]
