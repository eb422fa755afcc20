"""Who looks at a page, and whether a form was ours.

A page knows people by their browsers' sessions alone; a token in a header is for the API.
"""

from dataclasses import replace
from typing import Annotated, Any

from fastapi import Depends, Request
from starlette.datastructures import FormData

from reverie_eval.server.errors import ForgedError, NotSignedInError
from reverie_eval.server.http.callers import COOKIE, Call, session_id_of
from reverie_eval.server.state import state_of


async def visitor(request: Request) -> Call:
    """Return the visit of anybody."""
    cookie = request.cookies.get(COOKIE)
    return Call(request, state_of(request), None, session_id_of(request, cookie))


async def member(visit: Annotated[Call, Depends(visitor)]) -> Call:
    """Return the visit of somebody who is signed in."""
    return replace(visit, required="participant")


async def desk(visit: Annotated[Call, Depends(visitor)]) -> Call:
    """Return the visit of an organiser."""
    return replace(visit, required="organiser")


async def posted(visit: Annotated[Call, Depends(visitor)]) -> FormData:
    """Return the fields of a form that one of our own pages sent.

    Raises
    ------
    NotSignedInError
        If nobody is signed in, before any of the form is read.
    ForgedError
        If it does not carry the session's CSRF token.
    """
    if visit.session_id is None:
        raise NotSignedInError("sign in to see this page")
    form = await visit.request.form()
    shown: Any = form.get("csrf_token", "")
    if not isinstance(shown, str):
        raise ForgedError("csrf_token is no file")
    visit.server.sessions.demand_csrf_token(visit.session_id, shown)
    return form


Visitor = Annotated[Call, Depends(visitor)]
Member = Annotated[Call, Depends(member)]
Desk = Annotated[Call, Depends(desk)]
Posted = Annotated[FormData, Depends(posted)]
